"""Covariance of the joint solve, from the Schur complement, and the contribution of each residual.

With residuals in units of their σ the covariance of all unknowns is (JᵀJ)⁻¹. Its shared part is S⁻¹, S the Schur
complement; a block's part is V⁻¹ + K S⁻¹ Kᵀ and the two are tied by −K S⁻¹, with K = V⁻¹ Wᵀ. The leverage
h = J Σ Jᵀ of a residual is the share of itself that it determines: redundancies 1 − h add up to the degrees of
freedom, and give each kind of observation its own σ (F. R. Helmert's variance components).
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.block_arrow import Jacobian, linearise
from jaxscan.calibration.bundle import Factor, Prior, as_arrow
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.field_sparsity import field_sparsity
from jaxscan.calibration.residuals import Noise
from jaxscan.kept_programs import compiled
from jaxscan.rig import System

# An eigenvalue of the Schur complement, scaled to a unit diagonal, below this is rounding: a direction not determined.
UNDETERMINED = 1e-11
# Likewise of a block's own normal equations.
_LEAST_PIVOT = 1e3 * float(np.finfo(float).eps)


class Precision(eqx.Module):
    """How well a solve determines its unknowns.

    Attributes:
        covariance: of the shared parameters, in their units; a held one stands there with 1 and tied to none.
        eigenvalues: of the Schur complement scaled to a unit diagonal, smallest first.
        directions: its eigenvectors, in columns, in units of each parameter's σ if it were the only one.
        blocks: for each group (blocks, shared + size, shared + size): covariance of shared parameters and the block's.
        leverage: for each group (blocks, residuals): h of each residual.
    """

    covariance: Float[np.ndarray, "shared shared"]
    eigenvalues: Float[np.ndarray, "shared"]
    directions: Float[np.ndarray, "shared shared"]
    blocks: tuple[Float[np.ndarray, "_ _ _"], ...]
    leverage: tuple[Float[np.ndarray, "_ _"], ...]


def precision(
    system: System,
    free: Bool[Array, "shared"],
    groups: tuple[Factor, ...],
    noise: Noise,
    prior: Prior | None = None,
) -> Precision:
    """The covariance at a solution, for least squares (whatever robustness `noise` carries)."""
    noise = replace(noise, robustness=jnp.zeros_like(noise.robustness))
    return arrow_precision(_jacobian(system, free, groups, noise, prior))


@compiled(filtered=True)
def _jacobian(
    system: System, free: Bool[Array, "shared"], groups: tuple[Factor, ...], noise: Noise, prior: Prior | None
) -> Jacobian:
    y, _, residual = as_arrow(system, free, groups, noise, prior)
    sparsity = None if noise.field is None else field_sparsity(system, groups)
    return linearise(residual, y, sparsity)[1]


def arrow_precision(jacobian: Jacobian) -> Precision:
    """The covariance of any arrow-shaped problem by the Jacobian of its residuals, which are in units of their σ.

    All of it is NaN where a derivative is no number. By NumPy, whose arrays come out: JAX would compile it for each
    count of blocks.
    """
    shared, n = np.asarray(jacobian.shared), jacobian.shared.shape[1]
    if not all(np.isfinite(each).all() for each in (shared, *map(np.asarray, jacobian.blocks))):
        return _unknown(jacobian)
    U, eliminated, parts = shared.T @ shared, np.zeros((n, n)), []
    for J in map(np.asarray, jacobian.blocks):
        N = J.mT @ J
        V, W = N[:, n:, n:], N[:, :n, n:]
        inverse = inverse_where_determined(V, _LEAST_PIVOT)[0]
        # What no residual depends on stands there with 1, as do shared numbers that are held.
        inverse = inverse + np.where(np.diagonal(V, axis1=1, axis2=2) > 0, 0.0, 1.0)[:, None] * np.eye(V.shape[-1])
        K = inverse @ W.mT
        U, eliminated = U + N[:, :n, :n].sum(axis=0), eliminated + np.tensordot(W, K, axes=((0, 2), (0, 1)))
        parts.append((J, inverse, K))
    there = np.diagonal(U) > 0
    S = U + np.diag(np.where(there, 0.0, 1.0)) - eliminated
    scale = np.where(there, 1 / np.sqrt(np.where(there, np.diagonal(U), 1.0)), 1.0)
    eigenvalues, vectors = np.linalg.eigh(scale[:, None] * S * scale)
    directions = scale[:, None] * vectors
    covariance = (directions / np.maximum(eigenvalues, np.finfo(eigenvalues.dtype).eps)) @ directions.T
    blocks, leverage = [], []
    for J, inverse, K in parts:
        cross = -K @ covariance
        joint = np.block([[np.broadcast_to(covariance, (len(K), n, n)), cross.mT], [cross, inverse - cross @ K.mT]])
        blocks.append(joint)
        leverage.append(((J @ joint) * J).sum(axis=-1))
    return Precision(covariance, eigenvalues, directions, tuple(blocks), tuple(leverage))


def _unknown(jacobian: Jacobian) -> Precision:
    n = jacobian.shared.shape[1]
    blocks = tuple(np.full((len(J), J.shape[2], J.shape[2]), np.nan) for J in jacobian.blocks)
    leverage = tuple(np.full(J.shape[:2], np.nan) for J in jacobian.blocks)
    square = np.full((n, n), np.nan)
    return Precision(square, square[0], square, blocks, leverage)
