"""Which photographs of the board would make a point known best: the poses, and the σ that they would bring.

Wanted is the least mean variance, along their rays, of the points of the working volumes; of a rig without a laser that
of the pixels at which points before the camera are seen.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxscan.calibration import Calibration
from jaxscan.calibration.next_pose import NextPose, suggest
from jaxscan.reconstruction.point_sigma import jacobian_along
from jaxscan.reconstruction.working_volume import WorkingVolume, volume_rays, working_volumes
from jaxscan.rig import Covariance
from jaxscan.rig.covariance import projection_jacobian
from jaxscan.rig.projection import pixel_rays

# The image is divided into this number of columns and rows of pixels.
_PIXELS = (16, 12)


@dataclass(frozen=True)
class Wanted:
    """What is to be known well.

    Attributes:
        unit: mm of a point along its ray; px, along each axis, of a projected one.
        jacobian: derivative of each quantity by the rig's leaves.
        own: σ of each that no calibration changes: the stripe's in the photograph that is measured.
    """

    unit: Literal["mm", "px"]
    jacobian: Float[np.ndarray, "quantities leaves"]
    own: Float[np.ndarray, "quantities"]

    def median(self, leaves: Float[np.ndarray, "leaves leaves"]) -> float:
        """The median σ of the quantities for a covariance of the rig's leaves."""
        variance = np.einsum("qi,ij,qj->q", self.jacobian, leaves, self.jacobian)
        return float(np.median(np.sqrt(variance + self.own**2)))


@dataclass(frozen=True)
class NextBestViews:
    """What to photograph next.

    Attributes:
        poses: of the board, the one that helps most first; each counts those before it as photographed.
        unit: of the medians, as `Wanted` has it.
        median_now: the median σ of what is wanted.
        medians: with the first pose photographed, with the first two, …
    """

    poses: tuple[NextPose, ...]
    unit: Literal["mm", "px"]
    median_now: float
    medians: tuple[float, ...]


def next_best_views(
    calibration: Calibration, volumes: tuple[WorkingVolume, ...] | None = None, *, count: int = 3, seed: int = 0
) -> NextBestViews:
    """The poses of the board that would lower σ most.

    Args:
        calibration: what `calibrate` returned.
        volumes: where points are to be known, `working_volumes` by default; none for a rig without a laser.
        count: how many poses.
        seed: of the search.

    Raises:
        InputError: `count` is not positive.
    """
    aim = wanted(calibration, working_volumes(calibration) if volumes is None else volumes)
    poses = suggest(calibration, aim.jacobian, count=count, seed=seed)

    def median(covariance: Covariance) -> float:
        return aim.median(covariance.of_leaves(calibration.rig))

    medians = tuple(median(pose.covariance) for pose in poses)
    return NextBestViews(poses, aim.unit, median(calibration.covariance), medians)


def wanted(calibration: Calibration, volumes: tuple[WorkingVolume, ...]) -> Wanted:
    """Points over the working volumes with all axes at 0, or else pixels all over the image."""
    if not volumes:
        return _pixels(calibration)
    jacobians, own = [], []
    for volume in volumes:
        rays = volume_rays(calibration.rig, volume)
        of_rig, of_pixel = jacobian_along(calibration.rig, volume.laser, rays, {}, volume.columns)
        jacobians.append(of_rig)
        own.append(np.abs(of_pixel) * (calibration.stripe_sigma_px or 0.0))
    return Wanted("mm", np.concatenate(jacobians), np.concatenate(own))


def _pixels(calibration: Calibration) -> Wanted:
    rig, boards = calibration.rig, calibration.system.boards
    depth = float(np.median(rig.camera.chart.range_of(np.asarray(boards.translation))))
    each = [np.linspace(-0.5, n - 0.5, count) for n, count in zip(rig.camera.image_size, _PIXELS, strict=True)]
    rays = pixel_rays(rig.camera, np.stack(np.meshgrid(*each), axis=-1).reshape(-1, 2))
    rays = rays[np.isfinite(rays).all(axis=1)]
    of_camera = projection_jacobian(rig, depth * rays)
    jacobian = of_camera.reshape(-1, of_camera.shape[-1])
    return Wanted("px", jacobian, np.zeros(len(jacobian)))
