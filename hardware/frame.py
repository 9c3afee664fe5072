"""One photograph of a scan with what has to be known of it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Frame:
    """A photograph and the state of the scanner when it was taken.

    Attributes:
        image: (rows, columns) grey or (rows, columns, 3) in the order red, green, blue; uint8 or uint16.
        step_count: motor steps at which the stage stood, as it reported them.
        time_s: when the exposure began, seconds since the epoch.
        exposure_s: how long it was.
    """

    image: np.ndarray
    step_count: int
    time_s: float
    exposure_s: float

    def __post_init__(self) -> None:
        """Refuse what no camera takes."""
        image = self.image
        if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or image.size == 0:
            raise ValueError(f"a frame's image is uint8 or uint16 with 2 or 3 axes, not {image.dtype} {image.shape}")
        if image.ndim == 3 and image.shape[2] != 3:
            raise ValueError(f"a frame's image has one channel or three, not {image.shape[2]}")
        if not self.exposure_s > 0:
            raise ValueError(f"a frame's exposure is positive, not {self.exposure_s} s")
