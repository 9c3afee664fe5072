"""The bundle adjustment that a calibration ended with, as a function of its data, and `refit`, which solves it again.

What is differentiated is y*(θ): θ are the observations, the board, the weights, the two σ and what parameters are held
at; which observations are outliers is fixed, and so are weights and σ unless they are differentiated themselves.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.bundle import Estimate, solve
from jaxscan.calibration.residuals import Blocks, Noise
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64
from jaxscan.rig import System


class Adjustment(eqx.Module):
    """A least-squares problem at fixed inliers, and where its minimum was found. Every number in it is a leaf.

    Attributes:
        estimate: where it ended: there `refit` starts, and from there it reads the parameters that are held.
        free: which leaves of `estimate.shared` are refined, in their order.
        groups: observations, weights, board points and masks: of the views, one block each; then, where there is a
            stage or a turntable, of their sequences. Blocks beyond `counts` are padding.
        noise: σ of a corner and of a stripe point as the solve had them, pixels; only their ratio moves the minimum.
        reference: the stage's step count at which each sequence's pose stands.
        counts: how many views and how many sequences there are.
        turned: the turntable's; None where no sequence was turned.
    """

    estimate: Estimate
    free: Bool[Array, "shared"]
    groups: tuple[Blocks, ...]
    noise: Noise
    reference: Float[Array, "sequences"]
    counts: tuple[int, int] = eqx.field(static=True)
    turned: Float[Array, "sequences"] | None = None

    def with_board(self, points: Float[Array | np.ndarray, "points 3"]) -> "Adjustment":
        """The same photographs of another board.

        Args:
            points: in the order of `Board.points`, mm.
        """

        def moved(group: Blocks) -> Blocks:
            blocks, corners, _ = group.points.shape
            tiled = jnp.tile(jnp.asarray(points), (corners // len(points), 1))
            return replace(group, points=jnp.broadcast_to(tiled[None], (blocks, corners, 3)))

        return replace(self, groups=tuple(moved(group) for group in self.groups))

    def system(self, estimate: Estimate) -> System:
        """An estimate's rig and poses, without padding; those of the sequences at motor step 0.

        The centre of its turntable is the point of the axis that is nearest to the origin.
        """
        rig, warp = estimate.shared
        views, sequences = self.counts
        boards = Pose.from_vector(estimate.poses[0][:views])
        if not sequences:
            return System(rig, boards, Pose(jnp.zeros((0, 3)), jnp.zeros((0, 3))), warp)
        stages = Pose.from_vector(estimate.poses[1][:sequences])
        if rig.stage is not None:
            back = rig.stage.displacement(jnp.asarray(self.reference))
            stages = Pose(stages.rotation, stages.translation - back)
        if rig.turntable is not None and self.turned is not None:
            turntable = rig.turntable
            stages = jax.vmap(lambda n, pose: turntable.turned(-n) @ pose)(jnp.asarray(self.turned), stages)
            rig = replace(rig, turntable=turntable.nearest())
        return System(rig, boards, stages, warp)


def refit(adjustment: Adjustment) -> System:
    """The minimum of an adjustment: a pure function, to be compiled and differentiated in forward and reverse mode.

    Derivatives are those of the minimum itself (implicit function theorem, full Hessian), at fixed inliers:

        gradient = eqx.filter_grad(lambda a: refit(a).rig.triangulate(pixel, steps)[2])(calibration.adjustment)
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
    outcome = solve(adjustment.estimate, adjustment.free, adjustment.groups, adjustment.noise)
    failed = outcome.result != optx.RESULTS.successful
    return adjustment.system(eqx.error_if(outcome.estimate, failed, "the adjustment did not reach a minimum"))
