"""Symmetric matrices of which some directions are not determined, many at once, in NumPy's arrays."""

import numpy as np
from jaxtyping import Float, Int

# Eigenvalues of normal equations below this, the diagonal scaled to 1, are rounding.
_ROUNDING = 1e-11


def inverse_where_determined(
    M: Float[np.ndarray, "*each n n"], least: float = _ROUNDING, scale: Float[np.ndarray, "*each n"] | None = None
) -> tuple[Float[np.ndarray, "*each n n"], Int[np.ndarray, "*each"]]:
    """The inverse in the directions that there are, and how many.

    Args:
        M: symmetric, not negative.
        least: the least eigenvalue, with the diagonal scaled to 1; below it is rounding.
        scale: in place of the diagonal.
    """
    e, size, V = determined_directions(M, least, scale)
    there = size > 0
    V = e[..., None] * V * np.where(there, 1 / np.sqrt(np.where(there, size, 1.0)), 0.0)[..., None, :]
    return V @ V.mT, np.asarray(there.sum(axis=-1))


def determined_directions(
    M: Float[np.ndarray, "*each n n"], least: float, scale: Float[np.ndarray, "*each n"] | None = None
) -> tuple[Float[np.ndarray, "*each n"], Float[np.ndarray, "*each n"], Float[np.ndarray, "*each n n"]]:
    """What M says, direction by direction, with its diagonal scaled to 1: e M e = V diag(size) Vᵀ.

    Args:
        M: symmetric, not negative.
        least: eigenvalues up to this are rounding, and come as 0.
        scale: in place of the diagonal.

    Returns:
        e, 0 for a number of which M says nothing; the eigenvalues; V.
    """
    diagonal = np.diagonal(M, axis1=-2, axis2=-1) if scale is None else scale
    e = np.sqrt(np.where(diagonal > 0, 1 / np.where(diagonal > 0, diagonal, 1.0), 0.0))
    size, V = np.linalg.eigh(M * e[..., None, :] * e[..., None])
    return e, np.where(size > least, size, 0.0), V
