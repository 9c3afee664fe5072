"""What detectors and rules are called, in words for a person; without JAX, so that help is quick."""

from typing import Final, Literal

from jaxscan.errors import InputError

# A name of `DETECTORS`.
Detector = str
Choice = Literal["likeliest", "strongest", "first", "last", "continuous", "coherent"]

DETECTORS: Final[dict[Detector, str]] = {
    "likelihood": "fit of the profile, burnt-out cores too; the most accurate",
    "gravity": "centre of gravity",
    "derivative": "zero crossing of the smoothed derivative; the fastest",
    "ridge": "Steger's ridge, in each line",
    "gaussian": "Gaussian through the greatest three",
    "parabola": "parabola through the greatest three",
    "threshold": "mean of what reaches a threshold, whole rows: the method of 2003, to compare with",
}
CHOICES: Final[dict[Choice, str]] = {
    "likeliest": "the run of points that is most like a stripe: longer than thick, as wide as usual, no one's ghost",
    "strongest": "the one that stands out most",
    "first": "the topmost (leftmost)",
    "last": "the lowest (rightmost)",
    "continuous": "those that go on from line to line, strong ones first",
    "coherent": "those that go on from line to line and from frame to frame",
}
DEFAULT: Final[Detector] = "likelihood"
DEFAULT_CHOICE: Final[Choice] = "likeliest"


def check_detector(name: Detector) -> None:
    """Refuse a detector that there is not.

    Raises:
        InputError: with the names of those that there are.
    """
    if name not in DETECTORS:
        raise InputError(f'there is no detector "{name}": use one of {", ".join(DETECTORS)}')
