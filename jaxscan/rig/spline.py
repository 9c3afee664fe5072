"""Uniform cubic B-splines: a smooth function over a rectangle, from coefficients on a grid.

With t a coordinate in cells, the coefficient c_i stands at t = i − 1, and

    f(t) = Σ c_i β(t − i + 1),    β(d) = (max(0, 2 − |d|)³ − 4 max(0, 1 − |d|)³) / 6

(I. J. Schoenberg 1946). In two dimensions the weights are products. Beyond its rectangle the function keeps the
value at the border.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf

# The number of coefficients minus the number of cells.
MORE_THAN_CELLS = 3
_DEGREE = 3


def weights(t: Float[A, "*any"], cells: int, order: int = 0) -> Float[A, "*any coefficients"]:
    """A derivative of β, of all coefficients along one axis.

    Args:
        t: 0 to `cells`.
        cells: how many there are.
        order: of the derivative.
    """
    xp = namespace(t)
    d = t[..., None] - xp.reshape(xp.arange(cells + MORE_THAN_CELLS, dtype=t.dtype) - 1, (1,) * t.ndim + (-1,))
    if order > _DEGREE:
        return xp.zeros_like(d)
    outer, inner = xp.maximum(2 - xp.abs(d), 0), xp.maximum(1 - xp.abs(d), 0)
    sign = xp.sign(d) if order % 2 else 1.0
    if order == _DEGREE:
        return -sign * ((outer > 0) - 4.0 * (inner > 0))
    falling = math.perm(_DEGREE, order) * (-1) ** order
    return falling * sign * (outer ** (_DEGREE - order) - 4 * inner ** (_DEGREE - order)) / 6


def shift(
    coefficients: Sequence[Sequence[Leaf]], extent: Sequence[Leaf], cells: tuple[int, int], x: Float[Array, "2"]
) -> Float[Array, "functions"]:
    """Some functions at one place.

    Args:
        coefficients: of each, row by row.
        extent: least x and y, largest x and y.
        cells: along x and along y.
        x: the place.
    """
    both = jnp.stack([jnp.stack(list(each)) for each in coefficients])
    t = [jnp.clip((x[i] - extent[i]) / (extent[i + 2] - extent[i]) * cells[i], 0, cells[i]) for i in (0, 1)]
    return _sum(both, *t, cells, (0, 0))


@partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def _sum(
    both: Float[Array, "functions coefficients"],
    t: Float[Array, ""],
    u: Float[Array, ""],
    cells: tuple[int, int],
    orders: tuple[int, int],
) -> Float[Array, "functions"]:
    """A derivative of the functions at (t, u), by the coordinates."""
    return _products(both, t, u, cells, orders)


# By weights of their own: along each of the many directions of a derivative these would be as many arrays.
@partial(_sum.defjvp, symbolic_zeros=True)
def _sum_jvp(cells: tuple[int, int], orders: tuple[int, int], primals: Any, tangents: Any) -> Any:
    both, t, u = primals
    value = _sum(both, t, u, cells, orders)
    moved = jnp.zeros_like(value)
    for i, by in enumerate(tangents[1:]):
        if not isinstance(by, SymbolicZero):
            moved = moved + _sum(both, t, u, cells, (orders[0] + (i == 0), orders[1] + (i == 1))) * by
    if not isinstance(tangents[0], SymbolicZero):
        moved = moved + _products(tangents[0], t, u, cells, orders)
    return value, moved


def _products(
    both: Float[Array, "functions coefficients"],
    t: Float[Array, ""],
    u: Float[Array, ""],
    cells: tuple[int, int],
    orders: tuple[int, int],
) -> Float[Array, "functions"]:
    # One product of matrices, of all places by all directions of a derivative.
    along, across = weights(t, cells[0], orders[0]), weights(u, cells[1], orders[1])
    return both @ (across[:, None] * along[None]).ravel()


def basis(
    extent: Float[np.ndarray, "4"], cells: tuple[int, int], x: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points coefficients"]:
    """The weights of all coefficients, row by row, at each place."""
    t = (np.clip((x[:, i] - extent[i]) / (extent[i + 2] - extent[i]) * cells[i], 0, cells[i]) for i in (0, 1))
    along, across = (weights(each, count) for each, count in zip(t, cells, strict=True))
    return (across[:, :, None] * along[:, None]).reshape(len(x), -1)
