"""Derivatives through a solution, by the implicit function theorem.

At the minimum y*(θ) of ½‖r(y, θ)‖² the gradient g(y, θ) = (∂r/∂y)ᵀ r vanishes, so

    dy*/dθ = −H⁻¹ ∂g/∂θ        H = ∂g/∂y, the whole Hessian, second derivatives of r included

whatever the iterations did. H has the shape of an arrow, like JᵀJ: its blocks come from n_shared + 6 Hessian-vector
products, and the same elimination solves it. optimistix states the theorem (`ImplicitAdjoint`) and hands H over as an
operator; what it wants is a linear solver. `UncheckedAdjoint` is the same theorem for whoever wants what is compiled to
be kept: lineax looks at each solution and may raise an error, and JAX keeps no program that may.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx

from jaxscan.calibration.block_arrow import Arrow, Group, NormalEquations, jacobian_columns


class BlockArrowSolver(lx.AbstractLinearSolver[NormalEquations]):
    """H⁻¹ b for a symmetric, positive definite operator on `Arrow`; an unknown that H does not touch gets b itself."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> NormalEquations:
        """The operator's blocks; the right-hand side is not known yet."""
        del options
        return _blocks(lx.linearise(operator).mv, operator.in_structure())

    def compute(
        self, state: NormalEquations, vector: Arrow, options: dict[str, Any]
    ) -> tuple[Arrow, lx.RESULTS, dict[str, Any]]:
        """H⁻¹ b: the step where −b is the gradient."""
        del options
        groups = tuple(Group(group.V, group.W, -b) for group, b in zip(state.groups, vector.blocks, strict=True))
        return replace(state, g=-vector.shared, groups=groups).step(), lx.RESULTS.successful, {}

    def transpose(self, state: NormalEquations, options: dict[str, Any]) -> tuple[NormalEquations, dict[str, Any]]:
        """H is symmetric."""
        return state, options

    def conj(self, state: NormalEquations, options: dict[str, Any]) -> tuple[NormalEquations, dict[str, Any]]:
        """H is real."""
        return state, options

    def assume_full_rank(self) -> bool:
        """At a minimum that the data determine H is positive definite."""
        return True


class UncheckedAdjoint(optx.AbstractAdjoint):
    """The derivative of a minimum by `BlockArrowSolver`; NaN, and no error, where H is singular."""

    def apply(self, primal_fn: Any, rewrite_fn: Any, inputs: Any, tags: Any) -> Any:
        """What `primal_fn` gives, as (minimum, rest), the minimum differentiable, by the gradient `rewrite_fn`."""
        del tags
        root, rest = _minimum(primal_fn, rewrite_fn, (*inputs, partial(eqxi.while_loop, kind="lax")))
        return root, jax.tree.map(eqxi.nondifferentiable_backward, rest)


@eqx.filter_custom_jvp
def _minimum(primal_fn: Any, rewrite_fn: Any, inputs: Any) -> Any:
    del rewrite_fn
    return jax.tree.map(jnp.asarray, primal_fn(inputs))


@_minimum.def_jvp
def _minimum_jvp(primals: Any, tangents: Any) -> Any:
    primal_fn, rewrite_fn, inputs = primals
    *_, along = tangents
    held = jax.tree.map(_is_none, along, is_leaf=_is_none)
    fixed, data = eqx.partition(inputs, held, is_leaf=_is_none)
    root, rest = _minimum(primal_fn, rewrite_fn, inputs)
    _, by_data = jax.jvp(lambda data: rewrite_fn(root, rest, eqx.combine(data, fixed)), (data,), (along,))
    _, hessian = jax.linearize(lambda y: rewrite_fn(y, rest, inputs), root)

    def solved(product: Callable[[Arrow], Arrow], b: Arrow) -> Arrow:
        return BlockArrowSolver().compute(_blocks(product, b), b, {})[0]

    follows = jax.lax.custom_linear_solve(hessian, by_data, solved, symmetric=True)
    return (root, rest), (jax.tree.map(jnp.negative, follows), jax.tree.map(lambda _: None, rest))


def _is_none(leaf: Any) -> bool:
    return leaf is None


def _blocks(product: Callable[[Arrow], Arrow], like: Arrow) -> NormalEquations:
    """The blocks of a symmetric operator of the shape of an arrow, without a right-hand side."""
    n = like.shared.size
    columns = jacobian_columns(product, like)
    # A shared unknown's column shows in every block what the block's own columns add up to in the shared rows.
    groups = tuple(
        Group(V=block[..., n:], W=block[..., :n].mT, g=jnp.zeros(block.shape[:2], block.dtype))
        for block in columns.blocks
    )
    nothing = jnp.zeros(n, columns.shared.dtype)
    return NormalEquations(columns.shared, nothing, groups, nothing.sum())
