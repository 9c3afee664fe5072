"""Rotation vectors and matrices, with derivatives that hold at angle 0 and at angle π; NumPy's arrays or JAX's.

A rotation vector is axis times angle (radians): R = I + a [w]× + b [w]×², a = sin θ / θ, b = (1 − cos θ) / θ²
(O. Rodrigues, 1840). Both factors are analytic in θ² and are evaluated as such near zero.
"""

from types import ModuleType
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# What goes in as NumPy's comes out as NumPy's.
A = TypeVar("A", Array, np.ndarray)

# Below these (θ², |v|²) the series, cut after their last term, err by less than float64 can show.
_SERIES_ANGLE = 1e-3
_SERIES_QUATERNION = 1e-4


# ε with [w]×_ij = Σ ε_ijk w_k.
_SKEW = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]], float
)


def namespace(*arrays: Array | np.ndarray | float) -> ModuleType:
    """`jax.numpy` where one of the arrays is JAX's, else `numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np


def skew(w: Float[A, "*stack 3"]) -> Float[A, "*stack 3 3"]:
    """The matrix [w]× with [w]× x = w × x."""
    # A sum and no stack, here and below: XLA compiles one small loop in place of nine expressions.
    return (_for_each(_SKEW, w) * w[..., None, None, :]).sum(-1)


def vector_to_matrix(w: Float[A, "*stack 3"]) -> Float[A, "*stack 3 3"]:
    """Rotation vector (radians) to matrix; smooth everywhere, exact derivative at w = 0."""
    return _differentiable(w) if isinstance(w, jax.Array) else _rodrigues(w)


def _rodrigues(w: Float[A, "*stack 3"]) -> Float[A, "*stack 3 3"]:
    xp, (a, b, _) = namespace(w), _factors(w)
    # [w]×² = w wᵀ − θ² I.
    c = 1 - b * xp.vecdot(w, w)
    R = a[..., None, None] * skew(w) + b[..., None, None] * w[..., :, None] * w[..., None, :]
    return R + c[..., None, None] * _for_each(np.eye(3), w)


def _for_each(constant: np.ndarray, w: Float[A, "*stack 3"]) -> np.ndarray:
    """With axes in front for a stack of vectors, and of their type."""
    return np.expand_dims(constant, tuple(range(w.ndim - 1))).astype(w.dtype)


def _factors(w: Float[A, "*stack 3"]) -> tuple[Float[A, "*stack"], Float[A, "*stack"], Float[A, "*stack"]]:
    """Sin θ / θ, (1 − cos θ) / θ² and (θ − sin θ) / θ³."""
    xp = namespace(w)
    t = xp.vecdot(w, w)
    near = t < _SERIES_ANGLE
    safe = xp.where(near, 1.0, t)
    angle = xp.sqrt(safe)
    a = xp.where(near, 1 - t / 6 * (1 - t / 20 * (1 - t / 42)), xp.sin(angle) / angle)
    # 2 sin²(θ/2) = 1 − cos θ, without its cancellation.
    b = xp.where(near, 0.5 - t / 24 * (1 - t / 30 * (1 - t / 56)), 2 * xp.sin(angle / 2) ** 2 / safe)
    c = xp.where(near, 1 / 6 - t / 120 * (1 - t / 42 * (1 - t / 72)), (1 - a) / safe)
    return a, b, c


@jax.custom_jvp
def _differentiable(w: Float[Array, "*stack 3"]) -> Float[Array, "*stack 3 3"]:
    return _rodrigues(w)


@_differentiable.defjvp
def _turned(
    at: tuple[Float[Array, "*stack 3"]], along: tuple[Float[Array, "*stack 3"]]
) -> tuple[Float[Array, "*stack 3 3"], Float[Array, "*stack 3 3"]]:
    """Ṙ = ω × R, column by column, with the turn ω = ẇ + b w × ẇ + c w × (w × ẇ), c = (θ − sin θ) / θ³.

    Derived from the nine numbers one by one, each would bring sines and cosines of its own to be compiled.
    """
    (w,), (w_dot,) = at, along
    R, (_, b, c) = _differentiable(w), _factors(w)
    across = skew(w)
    aside = (across * w_dot[..., None, :]).sum(-1)
    turn = w_dot + b[..., None] * aside + c[..., None] * (across * aside[..., None, :]).sum(-1)
    return R, (skew(turn)[..., :, :, None] * R[..., None, :, :]).sum(-2)


def matrix_to_vector(R: Float[A, "*stack 3 3"]) -> Float[A, "*stack 3"]:
    """Matrix to rotation vector (radians), of length at most π.

    Through the quaternion whose largest component is found first (S. W. Shepperd, J. Guidance and Control 1978),
    so that neither θ = 0 nor θ = π divides by a small number.
    """
    xp = namespace(R)
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    x, y, z = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    xy, zx, yz = R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0], R[..., 2, 1] + R[..., 1, 2]
    # Each row is 4 q_i q for one component i; the row of the largest |q_i| is the accurate one.
    diagonal = xp.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], axis=-1)
    w, u, v, t = (diagonal[..., i] for i in range(4))
    rows = xp.stack([w, x, y, z, x, u, xy, zx, y, xy, v, yz, z, zx, yz, t], axis=-1).reshape(*diagonal.shape, 4)
    largest = xp.argmax(diagonal, axis=-1)[..., None, None]
    row = xp.take_along_axis(rows, largest, axis=-2)[..., 0, :]
    q = row / xp.sqrt(xp.vecdot(row, row))[..., None]
    q = xp.where(q[..., :1] < 0, -q, q)
    w, v = q[..., :1], q[..., 1:]
    s = xp.vecdot(v, v)[..., None]
    near = s < _SERIES_QUATERNION
    length = xp.sqrt(xp.where(near, 1.0, s))
    # 2 asin(|v|) / |v| as a series: with |q| = 1, half the angle is asin |v| when w ≥ 0.
    series = 2 * (1 + s / 6 * (1 + s * 9 / 20 * (1 + s * 25 / 42)))
    return v * xp.where(near, series, 2 * xp.arctan2(length, w) / length)
