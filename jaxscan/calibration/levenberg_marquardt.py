"""Levenberg-Marquardt for arrow-shaped least squares, as a solver of optimistix.

What differs from the stock solver: the damping is Marquardt's, λ times the diagonal of JᵀJ, so that the units of the
unknowns do not matter, and the largest diagonal met so far (J. J. Moré, "The Levenberg-Marquardt algorithm", 1978), so
that an unknown whose effect fades on the way does not run off; λ follows H. B. Nielsen's rule ("Damping parameter in
Marquardt's method", IMM-REP-1999-05); the linear algebra is that of `block_arrow`, and what does not depend on λ is
kept when a step is rejected; and the solve ends when the undamped step left is negligible *in units of the estimates'
own standard deviation*. That step is taken still: it costs nothing more, and derivatives through the solution are
those of the minimum.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, PyTree, Scalar

from jaxscan.calibration.block_arrow import Arrow, Group, NormalEquations, jacobian_columns

# λ to begin with, where nothing is known of how near the start is.
FIRST_DAMPING = 1e-4
_SMALLEST_DAMPING = 1e-15
# Beyond this the steps are too short to change anything: no descent is left.
_LARGEST_DAMPING = 1e14
# ‖r‖² would fall by less than this fraction: 1e-7 standard deviations for each degree of freedom.
_CONVERGED = 1e-14
# A minimum that rounding does not let the solver approach further counts as reached within this fraction.
_CONVERGED_WITHIN_ROUNDING = 1e-9


class _DescentState(eqx.Module):
    """The normal equations, the largest diagonal so far, the undamped step and the fall of ‖r‖² that it promises."""

    normal: NormalEquations
    largest: Arrow
    left: Arrow
    fall: Float[Array, ""]


class BlockArrowDescent(optx.AbstractDescent[Arrow, optx.FunctionInfo.ResidualJac, _DescentState]):
    """The damped Gauss-Newton step by the Schur complement; the step size is 1 / λ."""

    def init(self, y: Arrow, f_info_struct: Any) -> _DescentState:
        """A state of the right shapes; its values are not used."""
        del f_info_struct
        n, dtype = y.shared.size, y.shared.dtype
        groups = tuple(
            Group(jnp.zeros((b, d, d), dtype), jnp.zeros((b, n, d), dtype), jnp.zeros((b, d), dtype))
            for b, d in (block.shape for block in y.blocks)
        )
        normal = NormalEquations(jnp.zeros((n, n), dtype), jnp.zeros(n, dtype), groups)
        return _DescentState(normal, normal.diagonal(), normal.diagonal(), jnp.array(jnp.inf, dtype))

    def query(self, y: Arrow, f_info: Any, state: _DescentState) -> _DescentState:
        """The normal equations at a new point."""
        normal = NormalEquations.create(jacobian_columns(f_info.jac.mv, y), f_info.residual)
        largest = jax.tree.map(jnp.maximum, state.largest, normal.diagonal())
        return _DescentState(normal, largest, *normal.determined_step())

    def step(self, step_size: Scalar, state: _DescentState) -> tuple[Arrow, optx.RESULTS]:
        """The step for one λ."""
        return state.normal.damped(1 / step_size, state.largest).step(), optx.RESULTS.successful


class _SearchState(eqx.Module):
    damping: Float[Array, ""]
    growth: Float[Array, ""]


class NielsenSearch(optx.AbstractSearch[Arrow, Any, Any, _SearchState]):
    """Accepts what lowers ‖r‖², and moves λ by how well the linear model foretold it.

    Attributes:
        first: λ to begin with.
    """

    first: float = FIRST_DAMPING

    def init(self, y: Arrow, f_info_struct: Any) -> _SearchState:
        """λ at its first value."""
        del f_info_struct
        dtype = y.shared.dtype
        return _SearchState(jnp.array(self.first, dtype), jnp.array(2.0, dtype))

    def step(
        self,
        first_step: Bool[Array, ""],
        y: Arrow,
        y_eval: Arrow,
        f_info: Any,
        f_eval_info: Any,
        state: _SearchState,
    ) -> tuple[Scalar, Bool[Array, ""], optx.RESULTS, _SearchState]:
        """Judge the step from y to y_eval."""
        taken = eqx.apply_updates(y_eval, _negative(y))
        linear = eqx.apply_updates(f_info.residual, f_info.jac.mv(taken))
        before, after = _sum_squares(f_info.residual), _sum_squares(f_eval_info.residual)
        predicted = before - _sum_squares(linear)
        fell = after < before
        accept = first_step | fell
        ratio = jnp.where(predicted > 0, (before - after) / jnp.where(predicted > 0, predicted, 1.0), 0.0)
        # Nielsen's cubic, with its floor lowered from 1/3 to 1/10: near the minimum λ should vanish quickly.
        shrink = jnp.clip(1 - (2 * ratio - 1) ** 3, 0.1, 2.0)
        damping = jnp.where(
            first_step,
            state.damping,
            jnp.where(fell, jnp.maximum(state.damping * shrink, _SMALLEST_DAMPING), state.damping * state.growth),
        )
        growth = jnp.where(accept, 2.0, 2 * state.growth)
        return 1 / damping, accept, optx.RESULTS.successful, _SearchState(damping, growth)


class BlockArrowLevenbergMarquardt(optx.AbstractGaussNewton[Arrow, Any, Any]):
    """The solver; `optimistix.least_squares` takes it, with unknowns and residuals given as `Arrow`.

    Attributes:
        negligible: a fall of ‖r‖² that is not worth a step. Where residuals are in units of their σ it is the square of
            a distance in standard deviations; the default suits residuals of any unit.
    """

    negligible: float = 0.0

    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable[[PyTree], Scalar] = optx.max_norm
    descent: optx.AbstractDescent[Arrow, Any, Any] = BlockArrowDescent()
    search: optx.AbstractSearch[Arrow, Any, Any, Any] = NielsenSearch()
    verbose: Callable[..., None] = lambda **_: None

    def terminate(
        self, fn: Any, y: Arrow, args: Any, options: Any, state: Any, tags: frozenset[object]
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Stop at the minimum, or where no step lowers the sum any more."""
        total = _sum_squares(state.f_info.residual)
        left = state.descent_state.fall
        stuck = state.search_state.damping > _LARGEST_DAMPING
        reached = (left <= _CONVERGED * total + self.negligible) | (
            stuck & (left <= _CONVERGED_WITHIN_ROUNDING * total)
        )
        failed = optx.RESULTS.where(stuck & ~reached, optx.RESULTS.nonlinear_divergence, state.result)
        return reached | stuck, failed

    def postprocess(
        self,
        fn: Any,
        y: Arrow,
        aux: Any,
        args: Any,
        options: Any,
        state: Any,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Arrow, Any, dict[str, Any]]:
        """At the minimum, take the step left: it is solved for already, and too short for ‖r‖² to tell its fall."""
        at_minimum = result == optx.RESULTS.successful
        y = jax.tree.map(lambda y, left: y + jnp.where(at_minimum, left, 0.0), y, state.descent_state.left)
        return y, aux, {}


def _negative(tree: Arrow) -> Arrow:
    return Arrow(-tree.shared, tuple(-block for block in tree.blocks))


def _sum_squares(tree: Arrow) -> Float[Array, ""]:
    return (tree.shared**2).sum() + sum((block**2).sum() for block in tree.blocks)
