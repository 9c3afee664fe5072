"""Poses of boards for a camera as it is known: in closed form, block by block."""

from dataclasses import replace

import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration import initial
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.residuals import Blocks, far_away
from jaxscan.geometry import Pose
from jaxscan.precision import as_jax
from jaxscan.rig import Camera
from jaxscan.rig.projection import pixel_rays


def first_poses(camera: Camera, blocks: Blocks) -> Float[Array, "blocks 6"]:
    """Poses of views' boards from their corners; those of padding are far away."""
    rays = pixel_rays(camera, np.asarray(blocks.corners)[:, 0])
    used = np.asarray(blocks.corner_used)[:, 0] & np.all(np.isfinite(rays), axis=-1)
    real = np.any(used, axis=1)
    R = np.broadcast_to(np.eye(3), (len(used), 3, 3)).copy()
    t = np.zeros((len(used), 3))
    points = np.asarray(blocks.points)[0, :, :2]
    R[real], t[real] = initial.board_poses(points, rays[real], used[real])
    return as_jax(np.where(real[:, None], Pose.from_matrix(R, t).as_vector(), far_away(len(used))))


def poses_of_photographs(
    observations: Observations, camera: Camera, views: Float[Array | np.ndarray, "blocks 6"]
) -> Pose[np.ndarray]:
    """T_cam_board of every photograph, in their order: known for the views, in closed form for those along the axes.

    Args:
        observations: the photographs.
        camera: as it is known.
        views: the poses of the views; there may be more.
    """
    known = [np.asarray(views)[: len(observations.views)]]
    for sequence in observations.sequences:
        alone = view_blocks(replace(observations, views=sequence.views, sequences=()))
        known.append(np.asarray(first_poses(camera, alone))[: len(sequence.views)])
    return Pose.from_vector(np.concatenate(known))
