"""Poses of boards tried again once the camera is known.

A board whose start was poor, because the camera was not yet known or many of its corners are astray, may stay where
most of its corners count as outliers. And far away or small, a tilted board looks almost like the one tilted the
opposite way: the sum of squares over its pose has a minimum at each (D. Oberkampf, D. DeMenthon, L. Davis 1996;
G. Schweighofer and A. Pinz 2006).

So a board of which many corners were left out starts again: mirrored, and from its corners in closed form with the
camera as it is now known. The camera is held, and each board keeps the pose of the least cost, which is that of the
rounds of `rounds`: squares, up to the limit beyond which a corner is left out.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.bundle import solve
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.residuals import Blocks, Errors
from jaxscan.calibration.rounds import CORNER_LIMIT, Refined
from jaxscan.geometry import Pose
from jaxscan.kept_programs import compiled
from jaxscan.rig import System

# In doubt is a view of whose corners less than this part is within the limit.
_FEW_KEPT = 0.75
# Costs are sums over unit normal squares: what is better by less is so by chance.
_BETTER = 1.0


def resolve_pose_ambiguity(refined: Refined, groups: tuple[Blocks, ...]) -> System | None:
    """The same camera with some views elsewhere, or None where no other pose fits better.

    Args:
        refined: where rounds ended.
        groups: what they judged: the views; then what else there is, which stays.
    """
    system, noise = refined.system, refined.noise
    views, poses = groups[0], system.poses[0]
    used = np.asarray(views.corner_used)[:, 0]

    def with_poses(poses: Float[Array, "views 6"]) -> System:
        return replace(system, poses=(poses, *system.poses[1:]))

    def squares(errors: tuple[Errors, ...]) -> Float[np.ndarray, "views corners"]:
        corner = np.asarray(errors[0][0])
        square = ((corner**2).sum(-1) * (np.asarray(views.weights) / float(noise.corner)) ** 2)[:, 0]
        return np.where(used, np.minimum(square, CORNER_LIMIT**2), 0.0)

    now = squares(refined.errors)
    within = (used & (now < CORNER_LIMIT**2)).sum(1)
    doubtful = within < _FEW_KEPT * used.sum(1)
    if not doubtful.any():
        return None
    closed = first_poses(system.rig.camera, views)
    bends = poses[:, 6:]
    held = jnp.zeros(len(jax.tree.leaves(system.shared)), bool)
    cost, best = now.sum(1), np.asarray(poses)
    for start in (closed, _mirrored(closed, views), _mirrored(poses[:, :6], views)):
        moved = jnp.concatenate([start, jnp.zeros_like(bends)], axis=1)
        tried = solve(with_poses(jnp.where(doubtful[:, None], moved, poses)), held, groups, noise.robust())
        tried_cost = squares(tried.errors).sum(1)
        better = doubtful & (tried_cost < cost - _BETTER)
        cost = np.where(better, tried_cost, cost)
        best = np.where(better[:, None], tried.system.poses[0], best)
    return with_poses(jnp.asarray(best)) if (best != np.asarray(poses)).any() else None


@compiled(filtered=True)
def _mirrored(poses: Float[Array, "views 6"], views: Blocks) -> Float[Array, "views 6"]:
    """Boards tilted the opposite way, about the line of sight through the middle of what is seen of them."""

    def each(pose: Float[Array, "6"], points: Float[Array, "corners 3"], used: Bool[Array, "corners"]) -> Array:
        T = Pose.from_vector(pose)
        middle = jnp.where(used[:, None], points, 0.0).sum(0) / jnp.maximum(used.sum(), 1)
        centre = T.apply(middle)
        sight = centre / jnp.linalg.norm(centre)
        # Depths along the line of sight change their sign; a third axis that does too keeps the frame right-handed.
        R = (jnp.eye(3) - 2 * jnp.outer(sight, sight)) @ T.matrix() @ jnp.diag(jnp.array([1.0, 1.0, -1.0]))
        return Pose.from_matrix(R, centre - R @ middle).as_vector()

    return jax.vmap(each)(poses, views.points, views.corner_used[:, 0])
