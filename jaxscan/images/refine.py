"""From roughly found corners to exact ones, each with its σ, and the check that none ran away.

`cornerSubPix` brings a corner to within a few hundredths of a pixel from anywhere near it (it looks for the point
where the gradients about it are orthogonal to their offsets: W. Förstner and E. Gülch 1987); the fit of `saddle` does
the rest. The photograph's noise is the median over its corners of the residual of these fits; a corner's σ is that of
its fit, at no less than this noise.
"""

import warnings
from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt

from jaxscan.images.board_map import FEWEST, BoardMap, largest_degree, map_board, polynomials
from jaxscan.images.decode import Image, to_grey
from jaxscan.images.saddle import Saddles, fit_saddles

# Half the window of the first step, as a part of the distance to the nearest neighbour.
_FIRST_WINDOW = 0.2
_SMALLEST_WINDOW = 2
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-3)
# Half the side of the second step's window, in squares: what is nearer to the next corner belongs to that corner. Above
# this number of pixels, a larger window adds more of the surroundings than of the corner.
_REACH = 0.45
_LARGEST_PX = 15.0
# What the blur of other marks reaches into a window that they border, px.
_SMEAR_PX = 1.5
# A corner may stand off the place that its neighbours predict by this part of a square. Strong perspective and a
# wide-angle lens together come to a tenth.
_FARTHEST = 0.25
# Where it was first found may be wrong by more, where squares are small.
_FARTHEST_FROM_START = 0.5
# Left out: a corner of less than this part of the photograph's median contrast, of a window of which less than this
# part was fitted, whose residual is this part of its contrast, or that is known no better than this (px).
_LEAST_CONTRAST = 0.3
_LEAST_SHARE = 0.35
_MOST_RESIDUAL = 0.12
_MOST_SIGMA_PX = 0.3
# Left out too: where more than this part of the window is burnt out and its squares are not, as under a stripe, or more
# than this part is burnt out on one side of the corner alone, a corner for which less than this part of its window's
# information was kept. What hides one of its two edges leaves the glow beside it, which looks like that edge. It hides
# a whole row in the same way, so that no neighbour shows it.
_HIDDEN = 0.05
_LOPSIDED = 0.13
_LEAST_TOLD = 0.7
# What no patch knows of its own errors: aliasing, a point spread that is not symmetric (px).
_SYSTEMATIC_PX = 0.002
# What the correlation of residuals comes to where they are white, because the fit has used up what they had in common.
_WHITE_CORRELATION = 0.65
# A corner is off the board if its error exceeds this multiple of the median, and this number of pixels.
_SHAPE_DEGREE = 3
_MOST_APART = 8.0
_LEAST_APART_PX = 0.2

Grid = Float[np.ndarray, "grid_rows grid_columns 2"]
GridScalars = Float[np.ndarray, "grid_rows grid_columns"]


def refine_corners(image: Image, grid: Grid, clear: float = 1.0) -> tuple[Grid, GridScalars]:
    """Move each corner of a grid to its exact place.

    Args:
        image: the photograph in its full size, grey or RGB.
        grid: corners to within a fraction of a square.
        clear: how far from an edge there is no other mark, as a part of a square.

    Returns:
        The corners, and for each its σ along an axis, px; both NaN where there was no corner, where one ran away, and
        where a stripe, a highlight, the border or something before the board leaves too little of it to be sure.
    """
    near = _near(to_grey(image), grid, min(clear, _FIRST_WINDOW))
    spacing = neighbour_distance(near)
    refined, sigma, seen = _fit(image, near, spacing, clear)
    strayed = distance_from_prediction(refined) > _FARTHEST * spacing
    refined[strayed] = np.nan
    if seen is not None:
        strayed |= _off_the_board(refined, sigma, seen)
    strayed |= np.linalg.norm(refined - grid, axis=-1) > _FARTHEST_FROM_START * spacing
    outside = (refined < -0.5).any(axis=-1) | (refined > np.array(image.shape[1::-1]) - 0.5).any(axis=-1)
    lost = strayed | outside | ~np.isfinite(sigma)
    refined[lost], sigma[lost] = np.nan, np.nan
    return refined, sigma


def _near(grey: UInt[np.ndarray, "rows columns"], grid: Grid, window: float) -> Grid:
    """Each corner to within a few hundredths of a pixel, by the gradients about it."""
    levels = grey if grey.dtype == np.uint8 else grey.astype(np.float32)
    spacing = neighbour_distance(grid)
    near = np.full_like(grid, np.nan)
    rows, columns = grey.shape
    inside = (grid >= 0).all(axis=-1) & (grid[..., 0] <= columns - 1) & (grid[..., 1] <= rows - 1)
    for row, column in np.argwhere(inside & np.isfinite(spacing)):
        half = max(_SMALLEST_WINDOW, round(float(window * spacing[row, column])))
        start = grid[row, column].astype(np.float32).reshape(1, 1, 2)
        near[row, column] = cv2.cornerSubPix(levels, start, (half, half), (-1, -1), _STOP)[0, 0]
    return near


def _fit(image: Image, grid: Grid, spacing: GridScalars, clear: float) -> tuple[Grid, GridScalars, BoardMap | None]:
    """Fit the saddles of all corners that have a neighbour along both lines of the grid.

    What all corners of a board share, the bends, must not carry the error of a rough start: a hundredth of a pixel
    there would move whole rows by thousandths. So the bends are read again from what was fitted.
    """
    rows, columns = image.shape[:2]
    along_x, along_y = _directions(grid), _directions(grid.transpose(1, 0, 2)).transpose(1, 0, 2)
    known = np.isfinite(grid[..., 0]) & np.isfinite(along_x[..., 0]) & np.isfinite(along_y[..., 0])
    refined, sigma = np.full_like(grid, np.nan), np.full_like(spacing, np.nan)
    if not known.any():
        return refined, sigma, None
    rough = map_board(grid, (columns, rows))
    bends = np.zeros_like(grid) if rough is None else rough.bends
    saddles = fit_saddles(
        image,
        grid[known],
        (along_x[known], along_y[known]),
        bends[known],
        _REACH,
        np.maximum(clear * spacing[known] - _SMEAR_PX, _SMEAR_PX),
        _LARGEST_PX,
    )
    refined[known], sigma[known] = saddles.pixels, _sigma(saddles)
    trusted = np.where(np.isfinite(sigma)[..., None], refined, np.nan)
    exact = None if rough is None else map_board(trusted, (columns, rows), rough.parameters)
    if exact is not None:
        refined[known] += np.einsum("nij,nj->ni", saddles.by_bends, (exact.bends - bends)[known])
    return refined, sigma, exact


def _sigma(saddles: Saddles) -> Float[np.ndarray, "corners"]:
    """σ along an axis, px; NaN for a corner that is not to be trusted."""
    settled = np.isfinite(saddles.pixels[:, 0])
    if not settled.any():
        return np.full(len(settled), np.nan)
    noise = float(np.median(saddles.residual[settled]))
    contrast = np.abs(saddles.contrast)
    residual = np.maximum(saddles.residual, noise)
    tau = np.maximum(np.median(saddles.correlation[settled]) / _WHITE_CORRELATION, saddles.correlation).clip(1)
    sigma = np.sqrt(saddles.variance.mean(axis=1) * residual**2 * tau + saddles.unrest**2 + _SYSTEMATIC_PX**2)
    trusted = settled & (contrast > _LEAST_CONTRAST * np.median(contrast[settled]))
    trusted &= (saddles.share > _LEAST_SHARE) & (saddles.residual < np.maximum(_MOST_RESIDUAL * contrast, 2 * noise))
    clear = (saddles.hidden < _HIDDEN) & (saddles.lopsided < _LOPSIDED)
    trusted &= clear | (saddles.told > _LEAST_TOLD)
    return np.where(trusted & (sigma < _MOST_SIGMA_PX), sigma, np.nan)


def _directions(grid: Grid) -> Grid:
    """Direction of the line of corners through each corner along a row, px per square."""
    gaps = np.pad(np.diff(grid, axis=1), ((0, 0), (1, 1), (0, 0)), constant_values=np.nan)
    return quiet_nan(np.nanmean, np.stack([gaps[:, :-1], gaps[:, 1:]]))


def _off_the_board(grid: Grid, sigma: GridScalars, board: BoardMap) -> Bool[np.ndarray, "grid_rows grid_columns"]:
    """Which corners are off what all the others say of the board.

    That is a homography with a lens and, for a bent board, a polynomial over the grid on top of it. Each corner is
    compared with the fit of the others; the worst is left out first, so that it does not accuse its neighbours.
    """
    off = np.zeros(sigma.shape, bool)
    seen = np.isfinite(grid[..., 0]) & np.isfinite(sigma)
    if seen.sum() < FEWEST:
        return off
    at = np.argwhere(seen)[:, ::-1].astype(np.float64)
    pixels, weights = grid[seen], 1 / np.hypot(sigma[seen], np.median(sigma[seen]))
    basis = polynomials(2 * at / np.maximum(at.max(axis=0), 1) - 1, largest_degree(len(at), _SHAPE_DEGREE))
    kept = np.ones(len(at), bool)
    while kept.sum() > 1.5 * basis.shape[1]:
        Q = np.linalg.qr(basis[kept] * weights[kept, None])[0]
        difference = (pixels - board.pixels[seen])[kept] * weights[kept, None]
        left = 1 - np.minimum((Q**2).sum(axis=1), 1 - 1e-9)
        apart = np.linalg.norm(difference - Q @ (Q.T @ difference), axis=1) / left / weights[kept]
        # The leverage of a corner of the board makes its prediction uncertain.
        usual = np.median(apart * np.sqrt(left))
        excess = apart * np.sqrt(left) / np.maximum(_MOST_APART * usual, _LEAST_APART_PX * np.sqrt(left))
        worst = int(np.argmax(excess))
        if excess[worst] <= 1:
            break
        kept[np.flatnonzero(kept)[worst]] = False
    off[seen] = ~kept
    return off


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
