"""Grids of circles: dark on light or light on dark.

What is found is the centre of gravity of a circle's image. That is not the image of the circle's centre (J. Heikkilä,
PAMI 2000): the joint solve compares it with the centre of gravity of a projected circle, and for that it needs to know
how large the circles are.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt, UInt8

from jaxscan.images.refine import neighbour_distance

_SMALLEST_AREA = 12.0
# Radius of a circle's window, in pitches of the grid as it lies in the photograph: what is free of its neighbours.
_WINDOW = 0.5
# Where a circle was first found may be wrong by this part of the distance to the nearest one.
_FARTHEST = 0.25
# Levels within this part of the contrast from dark or light count as wholly so: noise far from the edge has no weight.
_QUIET = 0.2
_ROUNDS = 8


def find_circles(counts: tuple[int, int], image: UInt8[np.ndarray, "rows columns"]) -> np.ndarray | None:
    """Roughly where the circles are, row by row from whichever end; None when the whole grid is not found."""
    for blob_level in (0, 255):
        detector = cv2.SimpleBlobDetector.create(_blob_parameters(image.shape, counts, blob_level))
        for flags in (cv2.CALIB_CB_SYMMETRIC_GRID, cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING):
            found, centres = cv2.findCirclesGrid(image, counts, flags=flags, blobDetector=detector)
            if found:
                return centres.reshape(-1, 2)
    return None


def refine_circles(
    grey: UInt[np.ndarray, "rows columns"], grid: Float[np.ndarray, "grid_rows grid_columns 2"]
) -> Float[np.ndarray, "grid_rows grid_columns 3"]:
    """Each circle's centre of gravity, by how much of every pixel about it the circle covers, and its area (px²)."""
    along, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    refined = np.full((*grid.shape[:2], 3), np.nan)
    for at in np.ndindex(*grid.shape[:2]):
        found = grid[at]
        # Once more about the new centre, so that the window is even about it.
        for _ in range(2):
            found = _centre_of_gravity(grey, found[:2], np.stack([along[at], down[at]], axis=1))
        refined[at] = found
    refined[np.linalg.norm(refined[..., :2] - grid, axis=-1) > _FARTHEST * neighbour_distance(grid)] = np.nan
    return refined


def radius_in_pitches(circles: Float[np.ndarray, "grid_rows grid_columns 3"]) -> float:
    """The circles' radius as a part of their pitch, by the area of each image beside that of its mesh of the grid."""
    along, down = np.gradient(circles[..., :2], axis=1), np.gradient(circles[..., :2], axis=0)
    mesh = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    parts = circles[..., 2] / mesh
    known = np.isfinite(parts)
    return float(np.sqrt(np.median(parts[known]) / np.pi)) if known.any() else np.nan


def _centre_of_gravity(
    grey: UInt[np.ndarray, "rows columns"], centre: Float[np.ndarray, "2"], pitches: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "3"]:
    """With the area; NaN where the window leaves the photograph, for a circle that is cut has another centre.

    Args:
        grey: the photograph.
        centre: where the circle is, px.
        pitches: from there to the next ones along the grid's rows and columns, px, as columns.
    """
    if not np.isfinite(centre).all() or abs(np.linalg.det(pitches)) < _SMALLEST_AREA:
        return np.full(3, np.nan)
    reach = _WINDOW * np.linalg.norm(pitches, axis=1)
    if (centre - reach < -0.5).any() or (centre + reach > np.array(grey.shape)[::-1] - 0.5).any():
        return np.full(3, np.nan)
    # The mesh of the grid about the circle: in it there is always some of what is around the circle.
    mesh = _WINDOW * np.abs(pitches).sum(axis=1)
    left, top = np.maximum(np.floor(centre - mesh).astype(int), 0)
    right, bottom = np.ceil(centre + mesh).astype(int) + 1
    window = grey[top:bottom, left:right].astype(np.float64)
    v, u = np.indices(window.shape) + np.array([top, left])[:, None, None]
    a, b = np.tensordot(np.linalg.inv(pitches), np.stack([u - centre[0], v - centre[1]]), axes=1)
    disc = a**2 + b**2 < _WINDOW**2
    dark, light = _two_levels(window[(np.abs(a) < _WINDOW) & (np.abs(b) < _WINDOW)])
    at_centre = grey[round(centre[1]), round(centre[0])]
    inner, outer = (dark, light) if at_centre < (dark + light) / 2 else (light, dark)
    if inner == outer:
        return np.full(3, np.nan)
    cover = (((window - outer) / (inner - outer) - _QUIET) / (1 - 2 * _QUIET)).clip(0, 1) * disc
    area = cover.sum()
    return np.array([np.sum(cover * u) / area, np.sum(cover * v) / area, area])


def _two_levels(levels: Float[np.ndarray, "pixels"]) -> tuple[float, float]:
    """The levels of dark and light, however few pixels either has: medians of what is below and above their middle.

    (T. Ridler and S. Calvard, Picture thresholding using an iterative selection method, 1978.)
    """
    dark, light = float(levels.min()), float(levels.max())
    for _ in range(_ROUNDS):
        above = levels > (dark + light) / 2
        if above.all() or not above.any():
            break
        dark, light = float(np.median(levels[~above])), float(np.median(levels[above]))
    return dark, light


def _blob_parameters(shape: tuple[int, int], counts: tuple[int, int], blob_level: int) -> cv2.SimpleBlobDetector.Params:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.blobColor = blob_level
    parameters.minArea = _SMALLEST_AREA
    # A circle is narrower than the part of the image that is left to it.
    parameters.maxArea = max(np.pi / 4 * (max(shape) / max(counts)) ** 2, _SMALLEST_AREA)
    parameters.minDistBetweenBlobs = 2.0
    # Tilted circles are ellipses; these are bounds of what a blob must be, not of a good circle.
    parameters.minInertiaRatio = 0.15
    parameters.minConvexity = 0.85
    return parameters
