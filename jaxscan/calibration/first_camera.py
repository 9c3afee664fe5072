"""The camera from which a solve starts, with the nominal lens of its kind."""

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration import initial
from jaxscan.calibration.observations import Observations
from jaxscan.precision import float64
from jaxscan.rig import LENSES, Camera
from jaxscan.rig.fisheye import Fisheye
from jaxscan.rig.opencv_lens import LADDER
from jaxscan.rig.projection import off_axis, pixel_rays, project_points

# In widths of the image: of a lens that is no pinhole even nominally.
_FOCAL_GRID = np.geomspace(0.15, 10.0, 64)
# A nominal pinhole is off by more than this share of the image width where a lens is wide; a nominal fisheye, where it
# is one, by less than this share of that.
_NO_PINHOLE, _FISHEYE = 0.01, 0.5
# Farther off the axis than this (degrees) no lens of the ladder is sure to be found.
_LADDER_ENDS_DEG = 75.0


def first_camera(observations: Observations, lens: str) -> Camera:
    """A camera for the corners of the views, with the principal point at the image centre.

    Inside a `float64` block.

    Args:
        observations: three views or more.
        lens: a kind of lens.
    """
    points, seen, used = _corners(observations)
    size = observations.image_size
    middle = (np.asarray(size) - 1) / 2
    if LENSES[lens].pinhole:
        return Camera.create(size, initial.focal_length(points, seen, used, size), middle, lens)
    # The closed form is a pinhole's.
    tried = [Camera.create(size, (f, f), middle, lens) for f in size[0] * _FOCAL_GRID]
    return min(tried, key=lambda camera: _reprojection(camera, points, seen, used))


def beyond_the_ladder(observations: Observations) -> float | None:
    """How far off the axis (degrees) corners are that only a fisheye sees; None where others see them as well.

    Told by nominal lenses alone, without a solve: a pinhole's start is off by 1 % of the image or more, a fisheye's by
    less than half of that, and a corner is 75° off the axis.

    Args:
        observations: three views or more, each with corners enough for a pose.
    """
    points, seen, used = _corners(observations)
    with float64():
        pinhole = _reprojection(first_camera(observations, next(iter(LADDER))), points, seen, used)
        if not pinhole > _NO_PINHOLE * observations.image_size[0]:
            return None
        fisheye = first_camera(observations, Fisheye.kind)
        if not _reprojection(fisheye, points, seen, used) < _FISHEYE * pinhole:
            return None
        angle = float(np.degrees(off_axis(pixel_rays(fisheye, seen[used]))).max())
    return angle if angle > _LADDER_ENDS_DEG else None


def _corners(
    observations: Observations,
) -> tuple[Float[np.ndarray, "corners 2"], Float[np.ndarray, "views corners 2"], Bool[np.ndarray, "views corners"]]:
    """Points of the board, where each view has them, and whether it has."""
    seen = np.stack([view.corners for view in observations.views])
    return observations.board.points()[:, :2], seen, np.stack([view.used() for view in observations.views])


def _reprojection(
    camera: Camera,
    points: Float[np.ndarray, "corners 2"],
    seen: Float[np.ndarray, "views corners 2"],
    used: Bool[np.ndarray, "views corners"],
) -> float:
    """RMS distance in pixels with poses from the homographies; infinite where a corner has no ray."""
    rays = pixel_rays(camera, seen)
    if not np.isfinite(rays[used]).all():
        return np.inf
    R, t = initial.board_poses(points, rays, used)
    X = np.einsum("vij,nj->vni", R[:, :, :2], points) + t[:, None]
    error = (project_points(camera, X.reshape(-1, 3)).pixels.reshape(seen.shape) - seen)[used]
    return float(np.sqrt((error**2).sum(axis=-1).mean())) if np.isfinite(error).all() else np.inf
