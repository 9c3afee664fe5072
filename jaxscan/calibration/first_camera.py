"""The camera from which a solve starts, with the nominal lens of its kind."""

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration import initial
from jaxscan.calibration.observations import Observations
from jaxscan.rig import LENSES, Camera
from jaxscan.rig.projection import pixel_rays, project_points

# In widths of the image: of a lens that is no pinhole even nominally.
_FOCAL_GRID = np.geomspace(0.15, 10.0, 64)


def first_camera(observations: Observations, lens: str) -> Camera:
    """A camera for the corners of the views, with the principal point at the image centre.

    Inside a `float64` block.

    Args:
        observations: three views or more.
        lens: a kind of lens.
    """
    seen = np.stack([view.corners for view in observations.views])
    used = np.stack([view.used() for view in observations.views])
    points, size = observations.board.points()[:, :2], observations.image_size
    middle = (np.asarray(size) - 1) / 2
    if LENSES[lens].pinhole:
        return Camera.create(size, initial.focal_length(points, seen, used, size), middle, lens)
    # The closed form is a pinhole's.
    tried = [Camera.create(size, (f, f), middle, lens) for f in size[0] * _FOCAL_GRID]
    return min(tried, key=lambda camera: _reprojection(camera, points, seen, used))


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
