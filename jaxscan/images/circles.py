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
# Half the window of a circle, as a part of the distance to the nearest one: as much as is free of its neighbours.
_WINDOW = 0.5
# Levels within this part of the contrast from dark or light count as wholly so: noise far from the edge has no weight.
_QUIET = 0.2


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
    spacing = neighbour_distance(grid)
    refined = np.full((*spacing.shape, 3), np.nan)
    for at in np.ndindex(*spacing.shape):
        found = grid[at]
        # Once more about the new centre, so that the window is even about it.
        for _ in range(2):
            found = _centre_of_gravity(grey, found[:2], float(_WINDOW * spacing[at]))
        refined[at] = found
    refined[np.linalg.norm(refined[..., :2] - grid, axis=-1) > _WINDOW / 2 * spacing] = np.nan
    return refined


def radius_in_pitches(circles: Float[np.ndarray, "grid_rows grid_columns 3"]) -> float:
    """The circles' radius as a part of their pitch, by the area of each image beside that of its mesh of the grid."""
    along, down = np.gradient(circles[..., :2], axis=1), np.gradient(circles[..., :2], axis=0)
    mesh = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    parts = circles[..., 2] / mesh
    known = np.isfinite(parts)
    return float(np.sqrt(np.median(parts[known]) / np.pi)) if known.any() else np.nan


def _centre_of_gravity(
    grey: UInt[np.ndarray, "rows columns"], centre: Float[np.ndarray, "2"], radius: float
) -> Float[np.ndarray, "3"]:
    """With the area; NaN where the window leaves the photograph, for a circle that is cut has another centre."""
    if not np.isfinite(centre).all():
        return np.full(3, np.nan)
    (left, top), (right, bottom) = np.floor(centre - radius).astype(int), np.ceil(centre + radius).astype(int)
    if left < 0 or top < 0 or right >= grey.shape[1] or bottom >= grey.shape[0]:
        return np.full(3, np.nan)
    window = grey[top : bottom + 1, left : right + 1].astype(np.float64)
    v, u = np.indices(window.shape) + np.array([top, left])[:, None, None]
    disc = (u - centre[0]) ** 2 + (v - centre[1]) ** 2 < radius**2
    at_centre = grey[round(centre[1]), round(centre[0])]
    low, high = np.percentile(window[disc], (5, 95))
    inner, outer = (low, high) if at_centre < (low + high) / 2 else (high, low)
    if inner == outer:
        return np.full(3, np.nan)
    cover = (((window - outer) / (inner - outer) - _QUIET) / (1 - 2 * _QUIET)).clip(0, 1) * disc
    area = cover.sum()
    return np.array([np.sum(cover * u) / area, np.sum(cover * v) / area, area])


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
