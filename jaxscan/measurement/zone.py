"""The points that stand for a shape, its outliers among them: what a test of form is of.

A fit leaves out what is far from its shape. A figure of form must not: points in the air are what a bad scanner makes.
So a point counts by where it is in the grid, not by how far off it is: where most of its neighbours are of the shape.
What stands beside the shape, and the border that the fit has left out, have neighbours of another kind.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import uniform_filter

# Neighbours are those of a square of this side; more than this part of them must be of the shape.
_SIDE, _MOST = 7, 0.5
# Sums of ones and zeros are whole numbers, but for rounding.
_ROUNDING: Final = 1e-3


def zone(
    fitted: Bool[np.ndarray, "frames columns"], valid: Bool[np.ndarray, "frames columns"]
) -> Bool[np.ndarray, "frames columns"]:
    """The points that stand for a shape.

    Args:
        fitted: those that were fitted.
        valid: all points of the scan.

    Returns:
        Those fitted, and those of the others most of whose neighbours were.
    """
    # A point is none of its own neighbours.
    of_shape, of_all = (
        uniform_filter(each.astype(np.float64), _SIDE, mode="constant") * _SIDE**2 - each for each in (fitted, valid)
    )
    return fitted | (valid & (of_shape > _MOST * of_all + _ROUNDING))
