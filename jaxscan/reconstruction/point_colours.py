"""The colours of points, from a photograph in which they are not lit by the laser.

The rig's motion, at the positions of a photograph's axes, gives the place of a point of the object frame. The camera
sees it there, unless something else of the scan is in front of it: a map of the least depth in each pixel shows this.
"""

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import map_coordinates, minimum_filter

from jaxscan.geometry import Pose
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
    rows, width = photograph.shape[:2]
    inside = np.all((pixels > -0.5) & (pixels < [width - 0.5, rows - 0.5]), axis=1)
    at = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(int)
    nearest = np.full((rows, width), np.inf)
    np.minimum.at(nearest, (at[inside, 1], at[inside, 0]), seen[inside, 2])
    shown = inside & (seen[:, 2] < minimum_filter(nearest, 3)[at[:, 1], at[:, 0]] + _BEHIND_MM)
    if stripe is not None:
        line, place = (at[:, 0], pixels[:, 1]) if columns else (at[:, 1], pixels[:, 0])
        with np.errstate(invalid="ignore"):
            shown &= ~(np.abs(place - np.asarray(stripe, np.float64)[line]) < _STRIPE_PX)
    where = pixels[:, ::-1].T
    colours = [map_coordinates(photograph[..., k].astype(np.float32), where, order=1, mode="nearest") for k in range(3)]
    return np.where(shown[:, None], np.stack(colours, axis=-1).astype(np.float64), np.nan)
