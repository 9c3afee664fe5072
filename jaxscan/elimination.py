"""Many small systems of equations at once, without LAPACK.

XLA's CPU splits a batch of LAPACK calls into tasks for its own pool of threads, and the thread that asked waits for
them. Two batches at once can each hold the threads that the other's tasks need; neither ever ends. (One matrix is not
split, so it is safe.) Whatever has a batch is therefore solved here in plain arithmetic, and ruff refuses the functions
of `jax.numpy.linalg` elsewhere.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def solve_blocks(
    V: Float[Array, "blocks size size"], right: Float[Array, "blocks size columns"]
) -> Float[Array, "blocks size columns"]:
    """V_b⁻¹ times a right-hand side, for each symmetric positive definite block.

    Gauss-Jordan elimination, which needs no pivoting on a positive definite matrix, in units in which the diagonal is
    one; over the few columns of a block and over all blocks at once. An unknown on which no residual depends (a row of
    zeros, a padded block) stays where it is.

    Args:
        V: the blocks.
        right: the right-hand sides; the identity gives the inverse.
    """
    size = V.shape[-1]
    if not size:
        return right
    diagonal = jnp.diagonal(V, axis1=-2, axis2=-1)
    unused = diagonal <= 0
    scale = jax.lax.rsqrt(jnp.where(unused, 1.0, diagonal))
    unit = scale[..., :, None] * V * scale[..., None, :]
    gaps = jnp.where(unused, 1.0, 0.0).astype(V.dtype)[..., None] * jnp.eye(size, dtype=V.dtype)[None]
    augmented = jnp.concatenate([unit + gaps, scale[..., None] * right], -1)

    def eliminate(j: Array, M: Float[Array, "size columns blocks"]) -> Float[Array, "size columns blocks"]:
        row = jax.lax.dynamic_index_in_dim(M, j, 0, keepdims=False)
        pivot = jax.lax.dynamic_index_in_dim(row, j, 0)
        # Rounding in place of a pivot: a direction without data, which stays where it is (a generalised inverse).
        determined = pivot > 1e3 * jnp.finfo(M.dtype).eps
        row = jnp.where(determined, row / jnp.where(determined, pivot, 1.0), 0.0)
        M = M - jax.lax.dynamic_index_in_dim(M, j, 1) * row[None]
        return jax.lax.dynamic_update_index_in_dim(M, row, j, 0)

    # Blocks last: the long axis is then the one that vectorises.
    M = jax.lax.fori_loop(0, size, eliminate, jnp.transpose(augmented, (1, 2, 0)))
    return scale[..., None] * jnp.transpose(M[:, size:], (2, 0, 1))
