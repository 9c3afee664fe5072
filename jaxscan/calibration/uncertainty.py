"""Covariance of the joint solve, from the Schur complement, and the contribution of each residual.

With residuals in units of their σ the covariance of all unknowns is (JᵀJ)⁻¹. Its shared part is S⁻¹, S the Schur
complement; a block's part is V⁻¹ + K S⁻¹ Kᵀ and the two are tied by −K S⁻¹, with K = V⁻¹ Wᵀ. The leverage
h = J Σ Jᵀ of a residual is the share of itself that it determines: redundancies 1 − h add up to the degrees of
freedom, and give each kind of observation its own σ (F. R. Helmert's variance components).
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.block_arrow import Arrow, Jacobian, NormalEquations, linearise
from jaxscan.calibration.bundle import Factor, Prior, as_arrow
from jaxscan.calibration.field_sparsity import field_sparsity
from jaxscan.calibration.residuals import Noise
from jaxscan.elimination import solve_blocks
from jaxscan.rig import System

# An eigenvalue of the Schur complement, scaled to a unit diagonal, below this is rounding: a direction not determined.
UNDETERMINED = 1e-11


class Precision(eqx.Module):
    """How well a solve determines its unknowns.

    Attributes:
        covariance: of the shared parameters, in their units; a held one stands there with 1 and tied to none.
        eigenvalues: of the Schur complement scaled to a unit diagonal, smallest first.
        directions: its eigenvectors, in columns, in units of each parameter's σ if it were the only one.
        blocks: for each group (blocks, shared + size, shared + size): covariance of shared parameters and the block's.
        leverage: for each group (blocks, residuals): h of each residual.
    """

    covariance: Float[Array, "shared shared"]
    eigenvalues: Float[Array, "shared"]
    directions: Float[Array, "shared shared"]
    blocks: tuple[Float[Array, "_ _ _"], ...]
    leverage: tuple[Float[Array, "_ _"], ...]


@eqx.filter_jit
def precision(
    system: System,
    free: Bool[Array, "shared"],
    groups: tuple[Factor, ...],
    noise: Noise,
    prior: Prior | None = None,
) -> Precision:
    """The covariance at a solution, for least squares (whatever robustness `noise` carries)."""
    noise = replace(noise, robustness=jnp.zeros_like(noise.robustness))
    y, _, residual = as_arrow(system, free, groups, noise, prior)
    sparsity = None if noise.field is None else field_sparsity(system, groups)
    return arrow_precision(*linearise(residual, y, sparsity))


@eqx.filter_jit
def arrow_precision(value: Arrow, jacobian: Jacobian) -> Precision:
    """The covariance of any arrow-shaped problem whose residuals are in units of their σ."""
    normal = NormalEquations.create(value, jacobian)
    S = normal.schur_complement()
    diagonal = jnp.diagonal(normal.U)
    scale = jnp.where(diagonal > 0, 1 / jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0)), 1.0)
    # One matrix, no batch: see `block_arrow`.
    eigenvalues, vectors = jnp.linalg.eigh(scale[:, None] * S * scale[None])  # noqa: TID251
    directions = scale[:, None] * vectors
    covariance = (directions / jnp.maximum(eigenvalues, jnp.finfo(eigenvalues.dtype).eps)[None]) @ directions.T
    n = covariance.shape[0]
    blocks, leverage = [], []
    for J, group in zip(jacobian.blocks, normal.groups, strict=True):
        size = group.V.shape[-1]
        right = jnp.concatenate(
            [jnp.broadcast_to(jnp.eye(size, dtype=J.dtype)[None], group.V.shape), jnp.swapaxes(group.W, -1, -2)],
            axis=-1,
        )
        solved = solve_blocks(group.V, right)
        inverse, K = solved[..., :size], solved[..., size:]
        cross = -jnp.einsum("bis,st->bit", K, covariance)
        own = inverse - cross @ jnp.swapaxes(K, -1, -2)
        top = jnp.concatenate(
            [jnp.broadcast_to(covariance[None], (len(K), n, n)), jnp.swapaxes(cross, -1, -2)], axis=-1
        )
        joint = jnp.concatenate([top, jnp.concatenate([cross, own], axis=-1)], axis=-2)
        blocks.append(joint)
        leverage.append(jnp.einsum("bmi,bij,bmj->bm", J, joint, J))
    return Precision(covariance, eigenvalues, directions, tuple(blocks), tuple(leverage))
