"""The colours of points, from a photograph in which they are not lit by the laser.

The rig's motion, at the positions of a photograph's axes, gives the place of a point of the object frame. The camera
sees it there, unless something else of the scan is in front of it: a map of the least depth in each pixel shows this.
"""

import numpy as np
from jaxtyping import Bool, Float, Shaped

from jaxscan.geometry import Pose
from jaxscan.images.sampled import sampled
from jaxscan.rig import Camera
from jaxscan.rig.projection import project_points

# A point so much deeper than what is seen in its pixel, or beside it, is hidden, mm.
_BEHIND_MM = 2.0
# Pixels so near to the stripe have light of the laser.
_STRIPE_PX = 12.0


def point_colours(
    camera: Camera,
    pose: Pose,
    points: Float[np.ndarray, "points 3"],
    photograph: Shaped[np.ndarray, "rows columns 3"],
    stripe: Float[np.ndarray, "lines"] | None = None,
    *,
    columns: bool = True,
) -> Float[np.ndarray, "points 3"]:
    """Red, green and blue of points in one photograph; NaN for a point that it does not show, or shows in the stripe.

    Args:
        camera: that took it.
        pose: T_camera_object at the positions of the photograph.
        points: object frame, mm.
        photograph: RGB, 8 or 16 bits.
        stripe: where the stripe is in it: the row of each column, NaN for none; None without a laser.
        columns: whether `stripe` has a row for each column; false: a column for each row.

    Returns:
        Numbers of the photograph, float64.
    """
    seen = pose.apply(np.asarray(points, np.float64))
    pixels = project_points(camera, seen).pixels
    ranges = camera.chart.range_of(seen)
    shown = visible(least_depths(pixels, ranges, photograph.shape[:2]), pixels, ranges)
    if stripe is not None:
        shown &= ~in_stripe(pixels, stripe, _STRIPE_PX, columns=columns)
    return np.where(shown[:, None], sampled(photograph, pixels), np.nan)


def least_depths(
    pixels: Float[np.ndarray, "points 2"], depths: Float[np.ndarray, "points"], shape: tuple[int, ...]
) -> Float[np.ndarray, "rows columns"]:
    """The least depth of points in each pixel of a photograph and its eight neighbours, mm; infinite without one.

    Args:
        pixels: (u, v) of points; NaN for a point that the camera does not see.
        depths: along the optical axis, mm.
        shape: rows and columns.
    """
    from scipy.ndimage import minimum_filter

    at, inside = _nearest_pixels(pixels, shape)
    nearest = np.full(shape, np.inf, np.float32)
    np.minimum.at(nearest, (at[inside, 1], at[inside, 0]), depths[inside].astype(np.float32))
    return minimum_filter(nearest, 3)


def visible(
    nearest: Float[np.ndarray, "rows columns"],
    pixels: Float[np.ndarray, "points 2"],
    depths: Float[np.ndarray, "points"],
    behind_mm: float = _BEHIND_MM,
) -> Bool[np.ndarray, "points"]:
    """Whether points are on the photograph, with nothing before them.

    Args:
        nearest: as `least_depths` gives it.
        pixels: (u, v); NaN for a point that the camera does not see.
        depths: along the optical axis, mm.
        behind_mm: how much nearer what hides a point is, at least.
    """
    at, inside = _nearest_pixels(pixels, nearest.shape)
    with np.errstate(invalid="ignore"):
        return inside & (depths < nearest[at[:, 1], at[:, 0]] + behind_mm)


def in_stripe(
    pixels: Float[np.ndarray, "points 2"], stripe: Float[np.ndarray, "lines"], within_px: float, *, columns: bool
) -> Bool[np.ndarray, "points"]:
    """Whether pixels are so near to the stripe of their column (or row); false where that has none."""
    line, place = (pixels[:, 0], pixels[:, 1]) if columns else (pixels[:, 1], pixels[:, 0])
    with np.errstate(invalid="ignore"):
        at = np.rint(np.clip(np.nan_to_num(line), 0, len(stripe) - 1)).astype(int)
        return np.abs(place - np.asarray(stripe, np.float64)[at]) < within_px


def _nearest_pixels(
    pixels: Float[np.ndarray, "points 2"], shape: tuple[int, ...]
) -> tuple[Shaped[np.ndarray, "points 2"], Bool[np.ndarray, "points"]]:
    """The pixel that each point is in, and whether it is one of the photograph's; (0, 0) where it is not."""
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels > -0.5) & (pixels < [shape[1] - 0.5, shape[0] - 0.5]), axis=1)
    return np.rint(np.where(inside[:, None], pixels, 0.0)).astype(int), inside
