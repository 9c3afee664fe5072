"""What moved slowly from the first photograph to the last, in numbers and in words."""

from dataclasses import dataclass
from typing import Final

from jaxscan.phrases import of_laser

# What drifts, how its amount is said, and what to do.
_WORDS: Final = {
    "focus": (
        "The focal length drifts through the photographs, by {:+.2g} % from the first to the last",
        "Let camera and lens warm up for half an hour before the first photograph, and do not let the lens refocus",
    ),
    "image": (
        "The image drifts on the sensor through the photographs, by {:.2g} px from the first to the last",
        "Clamp lens and camera, and let them warm up for half an hour before the first photograph",
    ),
    "light": (
        "The sheet of light drifts through the photographs, by {:.2g} mm from the first to the last",
        "Clamp the laser, and let it warm up for half an hour before the first photograph",
    ),
}


@dataclass(frozen=True)
class Drift:
    """Something that goes on from photograph to photograph.

    Attributes:
        kind: "focus", "image" or "light".
        by: from the first photograph to the last: per cent of the focal length, pixels of the principal point, or mm of
            the sheet where its stripes lie.
        laser: whose light it is, "" for the only one.
        p: how often chance would show as much.
        parameter: what of the rig it moves most, in σ.
        shift_in_sigma: by how much.
    """

    kind: str
    by: float
    laser: str
    p: float
    parameter: str
    shift_in_sigma: float

    @property
    def statement(self) -> tuple[str, str]:
        """What is the case and what to do."""
        what, fix = _WORDS[self.kind]
        moved = f"; it moves {self.parameter} by {self.shift_in_sigma:.1f} of its σ, which is widened by that"
        return f"{what.format(self.by)}{of_laser(self.laser)}{moved}", f"{fix}; then photograph again."
