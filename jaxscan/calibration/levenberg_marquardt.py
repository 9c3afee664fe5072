"""Levenberg-Marquardt for arrow-shaped least squares, as a solver of optimistix.

What differs from the stock solver: the damping is Marquardt's, λ times the diagonal of JᵀJ, so that the units of the
unknowns do not matter, and the largest diagonal met so far (J. J. Moré, "The Levenberg-Marquardt algorithm", 1978), so
that an unknown whose effect fades on the way does not run off; λ follows H. B. Nielsen's rule ("Damping parameter in
Marquardt's method", IMM-REP-1999-05); the linear algebra is that of `block_arrow`, and what does not depend on λ is
kept when a step is rejected; only the normal equations, never the Jacobian, are carried from step to step, since a
large problem is as fast as its memory traffic; and the solve ends when the undamped step left is negligible *in units
of the estimates' own standard deviation*. That step is taken still: it costs nothing more, and derivatives through the
solution are those of the minimum.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, PyTree, Scalar

from jaxscan.calibration.block_arrow import Arrow, Jacobian, NormalEquations, Sparsity, linearise_with

# λ to begin with, where nothing is known of how near the start is.
FIRST_DAMPING = 1e-4
_SMALLEST_DAMPING = 1e-15
# Beyond this the steps are too short to change anything: no descent is left.
_LARGEST_DAMPING = 1e14
# ‖r‖² would fall by less than this fraction: 1e-7 standard deviations for each degree of freedom.
_CONVERGED = 1e-14
# A minimum that rounding does not let the solver approach further counts as reached within this fraction.
_CONVERGED_WITHIN_ROUNDING = 1e-9


class LevenbergMarquardtState(eqx.Module):
    """Where the solve stands.

    Attributes:
        normal: the normal equations, and ‖r‖², at the present unknowns.
        largest: the largest diagonal of JᵀJ so far.
        left: the undamped step from there.
        fall: by how much the linear model lets ‖r‖² fall along it.
        proposed: the damped step, to be tried next.
        predicted: by how much the linear model lets ‖r‖² fall along that.
        damping: λ.
        growth: what λ is multiplied by if that step is rejected.
        last: residual and Jacobian where they were last evaluated. The solver only writes them; at the end they are
            those of the minimum, but for a step that is negligible, and whoever wants a covariance need not evaluate
            (and compile) them again.
        aux: what else `fn` gives at the present unknowns.
    """

    normal: NormalEquations
    largest: Arrow
    left: Arrow
    fall: Float[Array, ""]
    proposed: Arrow
    predicted: Float[Array, ""]
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    last: tuple[Arrow, Jacobian]
    aux: Any


class BlockArrowLevenbergMarquardt(optx.AbstractLeastSquaresSolver[Arrow, Arrow, Any, LevenbergMarquardtState]):
    """The solver; `optimistix.least_squares` takes it, with unknowns and residuals given as `Arrow`.

    Attributes:
        negligible: a fall of ‖r‖² that is not worth a step. Where residuals are in units of their σ it is the square of
            a distance in standard deviations; the default suits residuals of any unit.
        first_damping: λ to begin with.
        sparsity: which residuals depend on which shared unknowns; None where all may on all.
    """

    negligible: float = 0.0
    first_damping: float = FIRST_DAMPING
    sparsity: Sparsity | None = None

    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable[[PyTree], Scalar] = optx.max_norm

    def init(
        self, fn: Any, y: Arrow, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: frozenset[object]
    ) -> LevenbergMarquardtState:
        """A state whose first proposal is to stay, where anything is better than what is known."""
        nothing, infinite = jax.tree.map(jnp.zeros_like, y), jnp.array(jnp.inf, y.shared.dtype)
        shapes = jax.eval_shape(lambda y: linearise_with(lambda y: fn(y, args), y, self.sparsity)[:2], y)
        return LevenbergMarquardtState(
            normal=NormalEquations.unknown(y),
            largest=nothing,
            left=nothing,
            fall=infinite,
            proposed=nothing,
            predicted=infinite,
            damping=jnp.array(self.first_damping, y.shared.dtype),
            growth=jnp.array(2.0, y.shared.dtype),
            last=jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), shapes),
            aux=jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), aux_struct),
        )

    def step(
        self, fn: Any, y: Arrow, args: Any, options: dict[str, Any], state: LevenbergMarquardtState, tags: Any
    ) -> tuple[Arrow, LevenbergMarquardtState, Any]:
        """Try the proposed step, take it if ‖r‖² falls, and propose the next."""
        tried = eqx.apply_updates(y, state.proposed)
        value, jacobian, aux = linearise_with(lambda y: fn(y, args), tried, self.sparsity)
        last, normal = (value, jacobian), NormalEquations.create(value, jacobian)
        first, fell = jnp.isinf(state.normal.total), normal.total < state.normal.total
        ratio = (state.normal.total - normal.total) / state.predicted
        # Nielsen's cubic, with its floor lowered from 1/3 to 1/10: near the minimum λ should vanish quickly.
        shrink = jnp.where(first, 1.0, jnp.clip(1 - (2 * ratio - 1) ** 3, 0.1, 2.0))
        damping = jnp.where(fell, jnp.maximum(state.damping * shrink, _SMALLEST_DAMPING), state.damping * state.growth)
        growth = jnp.where(fell, 2.0, 2 * state.growth)

        def taken() -> tuple[Arrow, NormalEquations, Arrow, Arrow, Array]:
            largest = jax.tree.map(jnp.maximum, state.largest, normal.diagonal())
            left, fall = normal.determined_step()
            return tried, normal, largest, left, fall

        def rejected() -> tuple[Arrow, NormalEquations, Arrow, Arrow, Array]:
            return y, state.normal, state.largest, state.left, state.fall

        # The first place stays where its sum is no number.
        there = fell | jnp.isinf(state.predicted)
        aux = jax.tree.map(lambda new, old: jnp.where(there, new, old), aux, state.aux)
        y, normal, largest, left, fall = jax.lax.cond(fell, taken, rejected)
        proposed = normal.damped(damping, largest).step()
        predicted = normal.fall(proposed, damping, largest)
        state = LevenbergMarquardtState(normal, largest, left, fall, proposed, predicted, damping, growth, last, aux)
        return y, state, aux

    def terminate(
        self, fn: Any, y: Arrow, args: Any, options: Any, state: LevenbergMarquardtState, tags: frozenset[object]
    ) -> tuple[Array, optx.RESULTS]:
        """Stop at the minimum, or where no step lowers the sum any more."""
        stuck = state.damping > _LARGEST_DAMPING
        reached = (state.fall <= _CONVERGED * state.normal.total + self.negligible) | (
            stuck & (state.fall <= _CONVERGED_WITHIN_ROUNDING * state.normal.total)
        )
        reached &= jnp.isfinite(state.fall)
        failed = optx.RESULTS.where(stuck & ~reached, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return reached | stuck, failed

    def postprocess(
        self,
        fn: Any,
        y: Arrow,
        aux: Any,
        args: Any,
        options: Any,
        state: LevenbergMarquardtState,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Arrow, Any, dict[str, Any]]:
        """At the minimum, take the step left: it is solved for already, and too short to show in ‖r‖²."""
        at_minimum = result == optx.RESULTS.successful
        y = jax.tree.map(lambda y, left: y + jnp.where(at_minimum, left, 0.0), y, state.left)
        return y, aux, {}
