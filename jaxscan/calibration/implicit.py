"""Derivatives through a solution, by the implicit function theorem.

At the minimum y*(θ) of ½‖r(y, θ)‖² the gradient g(y, θ) = (∂r/∂y)ᵀ r vanishes, so

    dy*/dθ = −H⁻¹ ∂g/∂θ        H = ∂g/∂y, the whole Hessian, second derivatives of r included

whatever the iterations did. H has the shape of an arrow, like JᵀJ: its blocks come from n_shared + 6 Hessian-vector
products, and the same elimination solves it. optimistix states the theorem (`ImplicitAdjoint`) and hands H over as an
operator; what it wants is a linear solver.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import lineax as lx

from jaxscan.calibration.block_arrow import Arrow, Group, NormalEquations, jacobian_columns


class BlockArrowSolver(lx.AbstractLinearSolver[NormalEquations]):
    """H⁻¹ b for a symmetric, positive definite operator on `Arrow`; an unknown that H does not touch gets b itself."""

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> NormalEquations:
        """The operator's blocks; the right-hand side is not known yet."""
        del options
        like: Arrow = operator.in_structure()
        n = like.shared.size
        columns = jacobian_columns(lx.linearise(operator).mv, like)
        # A shared unknown's column shows in every block what the block's own columns add up to in the shared rows.
        groups = tuple(
            Group(V=block[..., n:], W=block[..., :n].mT, g=jnp.zeros(block.shape[:2], block.dtype))
            for block in columns.blocks
        )
        nothing = jnp.zeros(n, columns.shared.dtype)
        return NormalEquations(columns.shared, nothing, groups, nothing.sum())

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
