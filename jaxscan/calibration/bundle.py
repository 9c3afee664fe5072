"""The joint solve: camera, lens, light planes, stage and every board pose from all residuals at once."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from jaxscan.calibration.block_arrow import Arrow, Jacobian
from jaxscan.calibration.field_sparsity import field_sparsity
from jaxscan.calibration.implicit import UncheckedAdjoint
from jaxscan.calibration.levenberg_marquardt import FIRST_DAMPING, BlockArrowLevenbergMarquardt
from jaxscan.calibration.residuals import Blocks, Errors, Noise
from jaxscan.kept_programs import compiled
from jaxscan.rig import System
from jaxscan.rig.splined import Splined

MAX_STEPS = 200
# A step that would move the estimate by less than 1e-6 of its standard deviation is not taken.
_NEGLIGIBLE = 1e-12
# Of a field's hundreds of coefficients rounding leaves 3e-12.
_NEGLIGIBLE_OF_FIELD = 1e-8
# Smooth shifts of many coefficients together move only once λ is small against those of each by itself.
_FIRST_DAMPING_OF_FIELD = 1e-8


@runtime_checkable
class Factor(Protocol):
    """Observations of one group of like blocks: boards, gauges, or anything else that observes a system. A pytree."""

    def residuals(
        self, system: System, poses: Float[Array, "blocks size"], noise: Noise
    ) -> Float[Array, "blocks residuals"]:
        """The residuals of each block, in units of their σ, by the system's shared part and the poses of these blocks.

        `noise` has the σ of corners and stripe points, for who has none of his own.
        """
        ...

    def start(self, system: System) -> Float[Array, "blocks size"]:
        """Where the unknowns of its blocks begin, given where the system does; of size 0 for one that has none."""
        ...


class Outcome(eqx.Module):
    """Where a solve ended.

    Attributes:
        system: the refined parameters.
        cost: ½‖r‖² there, dimensionless.
        steps: number of evaluations.
        result: why it stopped.
        value: the residual where it was last evaluated: at the system, but for a step of 1e-6 σ.
        jacobian: the Jacobian there.
        errors: of each group of boards at the system, but for such a step: corner (blocks, photographs, corners, 2)
            and stripe (blocks, photographs, stripe) errors in pixels.
    """

    system: System
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    result: optx.RESULTS
    value: Arrow
    jacobian: Jacobian
    errors: tuple[Errors, ...]


class Prior(eqx.Module):
    """What is known of the shared parameters beforehand: normal, of a mean and a precision root rootᵀ.

    Attributes:
        mean: of the leaves of `System.shared` in their order.
        root: (rows, shared) with rootᵀ root the inverse of the covariance; a parameter of which nothing is known has
            a column of zeros.
    """

    mean: Float[Array, "shared"]
    root: Float[Array, "rows shared"]


def as_arrow(
    system: System,
    free: Bool[Array, "shared"],
    groups: tuple[Factor, ...],
    noise: Noise,
    prior: Prior | None = None,
) -> tuple[Arrow, Callable[[Arrow], System], Callable[[Arrow], Arrow]]:
    """The problem in the shape of an arrow.

    A held parameter is read from where the system had it, so that its column of the Jacobian is zero. Which ones are
    held is data, not structure: another choice does not compile again.

    Returns:
        The unknowns, the way back to a system, and the residual as a function of the unknowns.
    """
    y0, back, residual = _with_errors(system, free, groups, noise, prior, _boards(groups))
    return y0, back, lambda y: residual(y)[0]


def _boards(groups: tuple[Factor, ...]) -> tuple[Blocks, ...]:
    return tuple(group for group in groups if isinstance(group, Blocks))


def _with_errors(
    system: System,
    free: Bool[Array, "shared"],
    groups: tuple[Factor, ...],
    noise: Noise,
    prior: Prior | None,
    judged: tuple[Blocks, ...],
) -> tuple[Arrow, Callable[[Arrow], System], Callable[[Arrow], tuple[Arrow, tuple[Errors, ...]]]]:
    """As `as_arrow`; the residual comes with the errors of boards in pixels, of all that is in `judged`."""
    start, unravel = ravel_pytree(system.shared)
    boards = _boards(groups)
    others = groups[len(boards) :]

    def back(y: Arrow) -> System:
        rig, shape, earlier = unravel(jnp.where(free, y.shared, start))
        return System(rig, y.blocks, shape, earlier)

    def residual(y: Arrow) -> tuple[Arrow, tuple[Errors, ...]]:
        now = back(y)
        found = [
            board.residuals_and_errors(now, poses, noise, all_of_it)
            for poses, board, all_of_it in zip(now.poses, boards, judged, strict=False)
        ]
        more = [
            other.residuals(now, poses, noise) for other, poses in zip(others, now.poses[len(boards) :], strict=True)
        ]
        known = [jnp.zeros(0, y.shared.dtype)]
        if prior is not None:
            known.append(prior.root @ (jnp.where(free, y.shared, start) - prior.mean))
        if noise.field is not None:
            lens = now.rig.camera.lens
            assert isinstance(lens, Splined)
            known.append(noise.field.residuals(lens))
        blocks = (*(residuals for residuals, _ in found), *more)
        return Arrow(jnp.concatenate(known), blocks), tuple(errors for _, errors in found)

    return Arrow(start, system.poses), back, residual


def solve(
    system: System,
    free: Bool[Array | np.ndarray, "shared"],
    groups: tuple[Factor, ...],
    noise: Noise,
    prior: Prior | None = None,
    first_damping: float = FIRST_DAMPING,
    judged: tuple[Blocks, ...] | None = None,
) -> Outcome:
    """Refine the free parameters and all poses by Levenberg-Marquardt.

    The system can be differentiated with respect to everything else that is given; what else comes back cannot.

    Args:
        system: where to start.
        free: which leaves of `system.shared` are refined, in their order.
        groups: the observations.
        noise: σ and robustness.
        prior: what is known of the shared parameters beforehand.
        first_damping: λ to begin with: small where the start is near and the problem is ill-conditioned, for until λ
            has come down to them nothing moves along its long valleys.
        judged: the boards among the groups, which stand first, with masks of all whose errors are wanted; without it
            these are of what takes part.
    """
    judged = _boards(groups) if judged is None else judged
    return _solve(system, jnp.asarray(free), groups, noise, prior, first_damping, judged)


@compiled(filtered=True)
def _solve(
    system: System,
    free: Bool[Array, "shared"],
    groups: tuple[Factor, ...],
    noise: Noise,
    prior: Prior | None,
    first_damping: float,
    judged: tuple[Blocks, ...],
) -> Outcome:
    y0, back, residual = _with_errors(system, free, groups, noise, prior, judged)
    sparsity, negligible = None, _NEGLIGIBLE
    if noise.field is not None:
        sparsity, negligible = field_sparsity(system, groups), _NEGLIGIBLE_OF_FIELD
        first_damping = min(first_damping, _FIRST_DAMPING_OF_FIELD)
    solution = optx.least_squares(
        lambda y, _: residual(y),
        BlockArrowLevenbergMarquardt(negligible, first_damping, sparsity=sparsity),
        y0,
        max_steps=MAX_STEPS,
        has_aux=True,
        adjoint=UncheckedAdjoint(),
        throw=False,
    )
    cost = 0.5 * solution.state.normal.total
    (value, jacobian), steps = solution.state.last, solution.stats["num_steps"]
    return Outcome(back(solution.value), cost, steps, solution.result, value, jacobian, solution.aux)
