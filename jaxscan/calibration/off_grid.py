"""How far the points of a board are from where its shape has them, in numbers and in words."""

from dataclasses import dataclass

# Less than this share of the σ of the rig is not worth a word.
_WORTH = 1.2


@dataclass(frozen=True)
class OffGrid:
    """Errors of the board's points that all photographs share.

    Attributes:
        in_plane_mm: RMS over the points, along columns and rows together; 0 where none shows.
        height_mm: RMS over the points, out of the shape that the board was taken to have; 0 where none shows.
        ratio: by how much σ of the rig's parameter that they affect most is larger for them.
        parameter: which that is.
        p: how often noise alone would show as much.
        said: whether a term of the model is named that may explain it.
    """

    in_plane_mm: float
    height_mm: float
    ratio: float
    parameter: str
    p: float
    said: bool = False

    @property
    def statements(self) -> tuple[tuple[str, str], ...]:
        """What is the case and what to do, where it matters and is not said yet."""
        if self.ratio < _WORTH or self.said:
            return ()
        off = [
            f"{mm:.2g} mm {where}"
            for mm, where in ((self.in_plane_mm, "in its plane"), (self.height_mm, "out of it"))
            if mm > 0
        ]
        what = (
            f"The board's points are not where they should be: off by {' and '.join(off)} (RMS), the same in all "
            "photographs, in a way that no shape of the board describes. σ is widened for it, that of "
            f"{self.parameter} by the factor {self.ratio:.2g}"
        )
        fix = (
            "Print the pattern on something stiff, glue it down without folds, and measure its squares along both "
            "directions: a print that is stretched by 0.2 % does this."
        )
        return ((what, fix),)
