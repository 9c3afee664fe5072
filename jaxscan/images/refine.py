"""From roughly found corners to exact ones, and the check that none ran away.

`cornerSubPix` brings a corner to within a few hundredths of a pixel from anywhere near it (it looks for the point where
the gradients about it are orthogonal to their offsets: W. Förstner and E. Gülch 1987); the fit of `saddle` does the
rest. The windows grow with the squares, up to a size beyond which more pixels bring more of the world than of the
corner.
"""

import warnings
from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Float, UInt

from jaxscan.images.saddle import fit_saddles

# Half the window of the first step, and the radius of the second, as parts of the distance to the nearest neighbour.
_FIRST_WINDOW = 0.2
_RADIUS = 0.22
_RADIUS_RANGE_PX = (5.0, 12.0)
# More than this part of a square would reach the next edge.
_WIDEST = 0.4
# Edges sharper than this alias: a pixel's share of dark is no longer that of its centre's neighbourhood.
_LEAST_BLUR_PX = 0.5
_SMALLEST_WINDOW = 2
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-3)
# A corner may stand off the place that its neighbours predict by this part of a square. Strong perspective and a
# wide-angle lens together come to a tenth.
_FARTHEST = 0.25
# Where it was first found may be wrong by more, where squares are small.
_FARTHEST_FROM_START = 0.5

Grid = Float[np.ndarray, "grid_rows grid_columns 2"]
GridScalars = Float[np.ndarray, "grid_rows grid_columns"]


def refine_corners(grey: UInt[np.ndarray, "rows columns"], grid: Grid, widest: float = _WIDEST) -> Grid:
    """Move each corner of a grid to its exact place; NaN stays NaN, and a corner that ran away becomes NaN.

    Args:
        grey: the photograph in its full size.
        grid: corners to within a fraction of a square.
        widest: the radius about a corner that is free of other edges, as a part of the distance to the next corner.
    """
    image = grey if grey.dtype == np.uint8 else grey.astype(np.float32)
    spacing = neighbour_distance(grid)
    near = np.full_like(grid, np.nan)
    for row, column in np.argwhere(np.isfinite(grid[..., 0]) & np.isfinite(spacing)):
        half = max(_SMALLEST_WINDOW, round(float(min(widest, _FIRST_WINDOW) * spacing[row, column])))
        start = grid[row, column].astype(np.float32).reshape(1, 1, 2)
        near[row, column] = cv2.cornerSubPix(image, start, (half, half), (-1, -1), _STOP)[0, 0]
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _LEAST_BLUR_PX)
    spacing = neighbour_distance(near)
    refined = _fit(smooth, near, spacing, widest)
    strayed = distance_from_prediction(refined) > _FARTHEST * spacing
    strayed |= np.linalg.norm(refined - grid, axis=-1) > _FARTHEST_FROM_START * spacing
    outside = (refined < -0.5).any(axis=-1) | (refined > np.array(grey.shape)[::-1] - 0.5).any(axis=-1)
    refined[strayed | outside] = np.nan
    return refined


def _fit(grey: Float[np.ndarray, "rows columns"], grid: Grid, spacing: GridScalars, widest: float) -> Grid:
    """Fit the saddles of all corners that have a neighbour along both lines of the grid."""
    (along_x, bend_x), (along_y, bend_y) = _lines(grid), _lines(grid.transpose(1, 0, 2))
    along_y, bend_y = along_y.transpose(1, 0, 2), bend_y.T
    known = np.isfinite(grid[..., 0]) & np.isfinite(along_x[..., 0]) & np.isfinite(along_y[..., 0])
    fitted = np.full_like(grid, np.nan)
    if known.any():
        radii = np.minimum((_RADIUS * spacing[known]).clip(*_RADIUS_RANGE_PX), widest * spacing[known])
        fitted[known] = fit_saddles(
            grey, grid[known], (along_x[known], along_y[known]), (bend_x[known], bend_y[known]), radii
        )
    return fitted


def _lines(grid: Grid) -> tuple[Grid, GridScalars]:
    """Of the line of corners through each corner: its direction, px a square, and its bend, 1/px.

    The bend is the part of the second difference that stands across the line; perspective alone gives none. At the
    ends of a line it is the neighbour's.
    """
    gaps = np.pad(np.diff(grid, axis=1), ((0, 0), (1, 1), (0, 0)), constant_values=np.nan)
    direction = quiet_nan(np.nanmean, np.stack([gaps[:, :-1], gaps[:, 1:]]))
    second = gaps[:, 1:] - gaps[:, :-1]
    across = direction[..., 0] * second[..., 1] - direction[..., 1] * second[..., 0]
    bend = across / np.linalg.norm(direction, axis=-1) ** 3
    if bend.shape[1] > 2:
        bend[:, 0], bend[:, -1] = bend[:, 1], bend[:, -2]
    return direction, np.nan_to_num(bend)


def neighbour_distance(grid: Grid) -> GridScalars:
    """Distance from each point to the nearest of its four neighbours, px; NaN where none is known."""
    across = np.pad(np.linalg.norm(np.diff(grid, axis=1), axis=-1), ((0, 0), (1, 1)), constant_values=np.nan)
    down = np.pad(np.linalg.norm(np.diff(grid, axis=0), axis=-1), ((1, 1), (0, 0)), constant_values=np.nan)
    return quiet_nan(np.nanmin, np.stack([across[:, :-1], across[:, 1:], down[:-1], down[1:]]))


def distance_from_prediction(grid: Grid) -> GridScalars:
    """How far each point stands from where its neighbours predict it, px; NaN where nothing predicts it.

    The prediction is the median of up to six: the middle of two neighbours, or two in a row carried on. A single bad
    neighbour does not move it.
    """
    padded = np.pad(grid, ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
    rows, columns = grid.shape[:2]

    def shifted(down: int, right: int) -> Grid:
        return padded[2 + down : 2 + down + rows, 2 + right : 2 + right + columns]

    steps = [(0, 1), (1, 0), (0, -1), (-1, 0)]
    carried = [2 * shifted(j, i) - shifted(2 * j, 2 * i) for j, i in steps]
    middles = [(shifted(j, i) + shifted(-j, -i)) / 2 for j, i in steps[:2]]
    return np.linalg.norm(grid - quiet_nan(np.nanmedian, np.stack(carried + middles)), axis=-1)


def quiet_nan(reduce: Callable[..., np.ndarray], stack: np.ndarray) -> np.ndarray:
    """A NaN-skipping reduction over the first axis, which says nothing of points where all is NaN."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return reduce(stack, axis=0)
