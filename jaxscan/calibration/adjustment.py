"""The bundle adjustment that a calibration ended with, as a function of its data, and `refit`, which solves it again.

What is differentiated is y*(θ): θ are the observations, the board, the weights, the two σ and what parameters are held
at; which observations are outliers is fixed, and so are weights and σ unless they are differentiated themselves.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.bundle import Factor, solve
from jaxscan.calibration.residuals import Blocks, Noise
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import A
from jaxscan.precision import as_float64, as_jax
from jaxscan.rig import Motion, Positions, System


class Adjustment(eqx.Module):
    """A least-squares problem at fixed inliers, and where its minimum was found. Every number in it is a leaf.

    Attributes:
        start: where it ended: there `refit` starts, and from there it reads the parameters that are held.
        free: which leaves of `start.shared` are refined, in their order.
        groups: observations, weights, board points and masks: of the views, one block each; then, where there are any,
            of the sequences along the axes. Blocks beyond `counts` are padding.
        noise: σ of a corner and of a stripe point as the solve had them, pixels; only their ratio moves the minimum.
        counts: how many views and how many sequences there are.
        factors: what else was known.
    """

    start: System
    free: Bool[Array, "shared"]
    groups: tuple[Blocks, ...]
    noise: Noise
    counts: tuple[int, int] = eqx.field(static=True)
    factors: tuple[Factor, ...] = ()

    def with_board(self, points: Float[Array | np.ndarray, "points 3"]) -> "Adjustment":
        """The same photographs of another board.

        Args:
            points: in the order of `Board.points`, mm.
        """

        def moved(group: Blocks) -> Blocks:
            return replace(group, points=jnp.broadcast_to(jnp.asarray(points)[None], group.points.shape))

        return replace(self, groups=tuple(moved(group) for group in self.groups))

    def finished(self, system: System) -> System:
        """A system without padding, its rig `normal`, its moved boards where they stand with all axes at 0."""
        views, sequences = self.counts
        poses = (system.poses[0][:views],)
        if sequences:
            moved = self.groups[1]
            at_0 = pose_at_0(system.rig.motion, system.poses[1][:, :6], moved.reference)
            poses = (*poses, jnp.concatenate([at_0, system.poses[1][:, 6:]], axis=1)[:sequences])
        return System(system.rig.normal(), as_jax(poses), system.shape)


def pose_at_0(motion: Motion, pose: Float[A, "*stack 6"], reference: Positions) -> Float[A, "*stack 6"]:
    """The pose with all axes at 0 of a board that stands at a pose at positions of reference, or of a stack of them."""
    return (motion.pose(reference).inverse() @ Pose.from_vector(pose)).as_vector()


def refit(adjustment: Adjustment) -> System:
    """The minimum of an adjustment: a pure function, to be compiled and differentiated in forward and reverse mode.

    Derivatives are those of the minimum itself (implicit function theorem, full Hessian), at fixed inliers:

        height = lambda a: refit(a).rig.triangulate(pixel, {"stage": steps})[2]
        gradient = eqx.filter_grad(height)(calibration.adjustment)
        gradient.groups[0].corners      # how far a height moves for each pixel that a corner moves

    Raises:
        InputError: JAX's x64 is not enabled.
        RuntimeError: no minimum was reached (at run time, also where this is compiled).
    """
    if jnp.zeros(()).dtype != jnp.float64:
        raise InputError(
            "an adjustment is solved and differentiated in float64: put "
            'jax.config.update("jax_enable_x64", True) before anything else'
        )
    numbers, rest = eqx.partition(adjustment, eqx.is_inexact_array)
    adjustment = eqx.combine(as_float64(numbers), rest)
    groups = (*adjustment.groups, *adjustment.factors)
    outcome = solve(adjustment.start, adjustment.free, groups, adjustment.noise)
    failed = outcome.result != optx.RESULTS.successful
    system = eqx.error_if(outcome.system, failed, "the adjustment did not reach a minimum")
    return eqx.filter_jit(adjustment.finished)(system)
