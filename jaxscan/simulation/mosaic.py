"""A sensor with a mosaic of colour filters: each pixel sees one colour, the others are interpolated."""

import cv2
import numpy as np
from jaxtyping import UInt

Photograph = UInt[np.ndarray, "rows columns 3"]


def mosaic(photograph: Photograph) -> UInt[np.ndarray, "rows columns"]:
    """What B. E. Bayer's pattern sees: red in even rows and columns, blue in odd ones, green in the others.

    Args:
        photograph: all three colours in each pixel, red first.
    """
    seen = photograph[..., 1].copy()
    seen[::2, ::2], seen[1::2, 1::2] = photograph[::2, ::2, 0], photograph[1::2, 1::2, 2]
    return seen


def through_mosaic(photograph: Photograph) -> Photograph:
    """The photograph with the colours that a mosaic leaves out as means of the nearest pixels that have them."""
    return cv2.cvtColor(mosaic(photograph), cv2.COLOR_BayerBG2RGB)
