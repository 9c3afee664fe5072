"""Rotation vectors and matrices, with derivatives that hold at angle 0 and at angle π.

A rotation vector is axis times angle (radians): R = I + a [w]× + b [w]×², a = sin θ / θ, b = (1 − cos θ) / θ²
(O. Rodrigues, 1840). Both factors are analytic in θ² and are evaluated as such near zero.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

# Below these (θ², |v|²) the series, cut after their last term, err by less than float64 can show.
_SERIES_ANGLE = 1e-3
_SERIES_QUATERNION = 1e-4


def skew(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The matrix [w]× with [w]× x = w × x."""
    zero = jnp.zeros_like(w[0])
    return jnp.array([[zero, -w[2], w[1]], [w[2], zero, -w[0]], [-w[1], w[0], zero]])


def vector_to_matrix(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation vector (radians) to matrix; smooth everywhere, exact derivative at w = 0."""
    t = w @ w
    near = t < _SERIES_ANGLE
    safe = jnp.where(near, 1.0, t)
    angle = jnp.sqrt(safe)
    a = jnp.where(near, 1 - t / 6 * (1 - t / 20 * (1 - t / 42)), jnp.sin(angle) / angle)
    # 2 sin²(θ/2) = 1 − cos θ, without its cancellation.
    b = jnp.where(near, 0.5 - t / 24 * (1 - t / 30 * (1 - t / 56)), 2 * jnp.sin(angle / 2) ** 2 / safe)
    K = skew(w)
    return jnp.eye(3, dtype=w.dtype) + a * K + b * (K @ K)


def matrix_to_vector(R: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Matrix to rotation vector (radians), of length at most π.

    Through the quaternion whose largest component is found first (S. W. Shepperd, J. Guidance and Control 1978),
    so that neither θ = 0 nor θ = π divides by a small number.
    """
    xx, yy, zz = R[0, 0], R[1, 1], R[2, 2]
    # Each row is 4 q_i q for one component i; the row of the largest |q_i| is the accurate one.
    rows = jnp.array(
        [
            [1 + xx + yy + zz, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], 1 + xx - yy - zz, R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], 1 - xx + yy - zz, R[2, 1] + R[1, 2]],
            [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], 1 - xx - yy + zz],
        ]
    )
    row = rows[jnp.argmax(jnp.diagonal(rows))]
    q = row / jnp.sqrt(row @ row)
    q = jnp.where(q[0] < 0, -q, q)
    w, v = q[0], q[1:]
    s = v @ v
    near = s < _SERIES_QUATERNION
    length = jnp.sqrt(jnp.where(near, 1.0, s))
    # 2 asin(|v|) / |v| as a series: with |q| = 1, half the angle is asin |v| when w ≥ 0.
    series = 2 * (1 + s / 6 * (1 + s * 9 / 20 * (1 + s * 25 / 42)))
    return v * jnp.where(near, series, 2 * jnp.arctan2(length, w) / length)
