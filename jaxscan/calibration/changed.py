"""A change between two photographs of a session, in numbers and in words."""

from dataclasses import dataclass

from jaxscan.phrases import of_laser


@dataclass(frozen=True)
class Change:
    """Something that all photographs were taken to share, and that is another before and behind a photograph.

    Attributes:
        kind: "focus", the focal lengths together; "image", the principal point; "light", a sheet; "place", the board
            on an axis, or all else.
        by: how much. Focus: the share by which they grew, and 0. Image: px to the right and down. Light: degrees, and
            mm where its stripes lie. Place: degrees and mm.
        before: the last photograph that goes with the first ones.
        after: the first that goes with the last ones.
        parameter: what of the rig it moves most, in σ.
        shift_in_sigma: by how much.
        laser: whose sheet it is, of several.
    """

    kind: str
    by: tuple[float, float]
    before: str
    after: str
    parameter: str
    shift_in_sigma: float
    laser: str = ""

    @property
    def statement(self) -> tuple[str, str]:
        """What is the case, and what to do."""
        what = f"Between {self.before} and {self.after} {self._what}. Taken as one, {self.parameter} moves by "
        return f"{what}{self.shift_in_sigma:.1f} of its σ", self._mend

    @property
    def _what(self) -> str:
        first, second = self.by
        if self.kind == "focus":
            return f"the focal length changed by {100 * first:+.2g} %: the lens was refocused, or zoomed"
        if self.kind == "image":
            return (
                f"the image moved in the camera by {first:+.2g} px to the right and {second:+.2g} px down: the lens "
                "was pushed in its mount, or the photographs are cut or stabilised otherwise"
            )
        if self.kind == "light":
            return (
                f"the sheet of light{of_laser(self.laser)} turned by {first:.2g}° and moved by {second:.2g} mm, seen "
                "from the camera: laser or camera was pushed"
            )
        return (
            f"the board turned by {first:.2g}° and moved by {second:.2g} mm beside its axis: it, or the camera, was "
            "pushed"
        )

    @property
    def _mend(self) -> str:
        if self.kind == "place":
            return (
                f"--split {self.after} gives the board another place from there on, on an axis that both parts share. "
                "Fasten board and camera."
            )
        return (
            f"--split {self.after} solves both parts with what they share, for the rig as it is now and as it was "
            f"before. --since {self.after} leaves out the photographs before."
        )
