"""Colours at places of a photograph, or of another picture, that are no whole pixels."""

import numpy as np
from jaxtyping import Float, Shaped

from jaxscan.images.decode import NUMBERS_PER_LEVEL


def sampled(
    photograph: Shaped[np.ndarray, "rows columns *rgb"], pixels: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points 3"]:
    """Red, green and blue at pixels, linear between the four around each; those of the border beyond it.

    A grey photograph has three equal ones. A pixel that is NaN is (0, 0).
    """
    rows, width = photograph.shape[:2]
    u, v = np.clip(np.nan_to_num(pixels), 0, [width - 1, rows - 1]).T
    left, top = np.minimum(u.astype(int), max(width - 2, 0)), np.minimum(v.astype(int), max(rows - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, rows - 1)
    a, b = (u - left)[:, None], (v - top)[:, None]
    # One number or three.
    corner = photograph.reshape(rows, width, -1)
    upper = (1 - a) * corner[top, left] + a * corner[top, right]
    lower = (1 - a) * corner[below, left] + a * corner[below, right]
    return np.broadcast_to((1 - b) * upper + b * lower, (len(u), 3)).astype(np.float64)


def levels_at(
    photograph: Shaped[np.ndarray, "rows columns *rgb"], pixels: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points 3"]:
    """As `sampled`, in grey levels of 8 bits, whether the photograph has 8 bits or 16."""
    return sampled(photograph, pixels) / (NUMBERS_PER_LEVEL if photograph.dtype == np.uint16 else 1)
