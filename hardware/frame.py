"""One photograph of a scan with what has to be known of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """A photograph and the state of the scanner when it was taken.

    Attributes:
        image: (rows, columns) grey or (rows, columns, 3) in the order red, green, blue; uint8 or uint16.
        positions: where each axis stood, motor steps by the axis's name, as it reported them: {"stage": 20000}. Empty
            where nothing is known of them.
        time_s: when the exposure began, seconds since the epoch.
        exposure_s: how long it was.
    """

    image: np.ndarray
    positions: Mapping[str, int]
    time_s: float
    exposure_s: float

    @property
    def place(self) -> str:
        """The positions in words."""
        return in_words(self.positions)

    def __post_init__(self) -> None:
        """Refuse what no camera takes."""
        if not isinstance(self.positions, Mapping):
            raise ValueError(f'a frame has its positions by axis, as {{"stage": 20000}}, not {self.positions!r}')
        image = self.image
        if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or image.size == 0:
            raise ValueError(f"a frame's image is uint8 or uint16 with 2 or 3 axes, not {image.dtype} {image.shape}")
        if image.ndim == 3 and image.shape[2] != 3:
            raise ValueError(f"a frame's image has one channel or three, not {image.shape[2]}")
        if not self.exposure_s > 0:
            raise ValueError(f"a frame's exposure is positive, not {self.exposure_s} s")


def in_words(positions: Mapping[str, int]) -> str:
    """Positions of axes in words: `step 20000` of a stage alone, otherwise `turntable 400, stage 20000`."""
    if set(positions) == {"stage"}:
        return f"step {positions['stage']}"
    return ", ".join(f"{name} {step}" for name, step in positions.items()) or "an unknown place"
