"""Pixels that are bright in every photograph, whatever moves: hot ones of the sensor, left out of each.

A lens spreads each point of a scene over its neighbours too, so a pixel that stands out alone is the sensor's. It is
given the mean of the two beside it along the stripe, by which no profile across the stripe is smoothed. Only grey
photographs show it: where colours are interpolated, a hot pixel is spread over its neighbours as a point is.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, UInt

# Photographs that are looked at, and the fewest that say something.
HOT_FRAMES: Final = 16
_FEWEST = 8
# A pixel is hot that stands out by this part of the stripe's height, that of this quantile of the lines, and of which
# no neighbour has this part; they are worth a note from this number of them in a million on.
_PART, _LINES, _BESIDE = 1 / 3, 0.75, 0.15
_PER_MILLION, _LEAST = 30.0, 5
# Its neighbours; the ground is the median of a square of this side, px.
_GROUND: Final = 5
_AROUND: Final = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)


class HotPixels:
    """Looks on while photographs are read: the first ones are looked at, all are corrected.

    Args:
        columns: whether each column of a photograph crosses the stripe.
    """

    def __init__(self, columns: bool) -> None:
        self._columns = columns
        self._hot: tuple[np.ndarray, np.ndarray] | None = None
        self._size = 0

    def correct(self, images: UInt[np.ndarray, "frames rows columns *rgb"]) -> None:
        """Give those of the first photographs that came the mean of their neighbours, in place."""
        if images.ndim != 3:
            return
        if self._hot is None:
            hot = hot_pixels(images[:HOT_FRAMES], self._columns)
            row, column = np.nonzero(hot)
            self._hot, self._size = (row, column), hot.size
        row, column = self._hot
        if not len(row):
            return
        along = column if self._columns else row
        last = images.shape[2 if self._columns else 1] - 1
        before, after = np.where(along > 0, along - 1, 1), np.where(along < last, along + 1, last - 1)
        sides = [(row, beside) if self._columns else (beside, column) for beside in (before, after)]
        images[:, row, column] = (images[:, *sides[0]].astype(np.uint32) + images[:, *sides[1]] + 1) // 2

    def notes(self) -> list[str]:
        """What is said of them."""
        count = 0 if self._hot is None else len(self._hot[0])
        share = 1e6 * count / max(self._size, 1)
        if count < _LEAST or share < _PER_MILLION:
            return []
        return [
            f"{count} pixels ({share:.0f} in a million) are bright in every photograph, isolated from each other: hot "
            "pixels of the sensor. They are replaced by the mean of the pixels beside them. Less bright ones remain, "
            "and σ does not include them: switch on the camera's correction of defective pixels, expose for less "
            "time, or "
            "name a photograph with the lens covered as background in scan.toml"
        ]


def hot_pixels(images: UInt[np.ndarray, "frames rows columns"], columns: bool) -> Bool[np.ndarray, "rows columns"]:
    """Which pixels stand out alone in all of these photographs; none of too few photographs."""
    if len(images) < _FEWEST:
        return np.zeros(images.shape[1:], bool)
    least = images.min(axis=0).astype(np.float32)
    tops = np.quantile(images.max(axis=1 if columns else 2), _LINES, axis=1)
    height = float(np.median(tops - np.median(images, axis=(1, 2))))
    ground = cv2.medianBlur(least, _GROUND)
    stands = least - ground
    return (stands > _PART * height) & (cv2.dilate(least, _AROUND) - ground < _BESIDE * stands)
