"""Poses of boards for a camera as it is known: in closed form, block by block."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration import initial
from jaxscan.calibration.residuals import Blocks
from jaxscan.geometry import Pose
from jaxscan.rig import Camera
from jaxscan.rig.projection import pixel_rays


def first_poses(camera: Camera, blocks: Blocks) -> Float[Array, "blocks 6"]:
    """Poses of boards from their corners; those of padding are far away."""
    rays = pixel_rays(camera, np.asarray(blocks.corners))[..., :2]
    used = np.asarray(blocks.corner_used) & np.all(np.isfinite(rays), axis=-1)
    real = np.any(used, axis=1)
    R = np.broadcast_to(np.eye(3), (len(used), 3, 3)).copy()
    t = np.zeros((len(used), 3))
    points = np.asarray(blocks.points)[0, :, :2]
    R[real], t[real] = initial.board_poses(points, rays[real], used[real])
    return jnp.where(real[:, None], jnp.asarray(Pose.from_matrix(R, t).as_vector()), far_away(len(used)))


def far_away(blocks: int) -> Float[Array, "blocks 6"]:
    """Poses for boards that nothing is known of yet: in front of the camera, one metre away."""
    return jnp.tile(jnp.array([0.0, 0.0, 0.0, 0.0, 0.0, 1000.0]), (blocks, 1))
