"""Rotation vectors: values against OpenCV, derivatives against finite differences, also where they are delicate."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import matrix_to_vector, vector_to_matrix

ANGLES = np.array([0.0, 1e-12, 1e-7, 1e-3, 0.0316, 0.5, 2.0, 3.0, np.pi - 1e-7, np.pi])
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1.0, -2.0, 0.5] / np.sqrt(5.25), -np.ones(3) / np.sqrt(3)])
VECTORS = (ANGLES[:, None, None] * AXES).reshape(-1, 3)


def test_matrix_is_rodrigues(x64):
    R = jax.jit(jax.vmap(vector_to_matrix))(jnp.asarray(VECTORS))
    np.testing.assert_allclose(R, [cv2.Rodrigues(w)[0] for w in VECTORS], atol=1e-14)


def test_vector_comes_back(x64):
    back = np.asarray(jax.jit(jax.vmap(lambda w: matrix_to_vector(vector_to_matrix(w))))(jnp.asarray(VECTORS)))
    error = np.abs(back - VECTORS).max(axis=1)
    # At π the axis and its opposite are the same rotation.
    opposite = np.where(np.linalg.norm(VECTORS, axis=1) > 3.14, np.abs(back + VECTORS).max(axis=1), np.inf)
    assert np.minimum(error, opposite).max() < 1e-9


def test_derivative_of_matrix(x64):
    w = jnp.asarray(VECTORS)
    forward = jax.jit(jax.vmap(jax.jacfwd(vector_to_matrix)))(w)
    reverse = jax.jit(jax.vmap(jax.jacrev(vector_to_matrix)))(w)
    np.testing.assert_allclose(forward, reverse, atol=1e-12)
    value, h = jax.jit(jax.vmap(vector_to_matrix)), 1e-6
    numeric = np.stack([(value(w + h * e[None]) - value(w - h * e[None])) / (2 * h) for e in jnp.eye(3)], -1)
    np.testing.assert_allclose(forward, numeric, atol=1e-9)


def test_derivative_of_round_trip_is_identity(x64):
    w = VECTORS[np.linalg.norm(VECTORS, axis=1) < 3.1]
    J = jax.jit(jax.vmap(jax.jacfwd(lambda w: matrix_to_vector(vector_to_matrix(w)))))(jnp.asarray(w))
    np.testing.assert_allclose(J, np.broadcast_to(np.eye(3), J.shape), atol=1e-8)


def test_second_derivative_at_zero_is_finite(x64):
    H = jax.jit(jax.hessian(lambda w: vector_to_matrix(w)[0, 1] + vector_to_matrix(w)[0, 0]))(jnp.zeros(3))
    # R ≈ I + [w]× + [w]×² / 2: R01 = −w2 + w0 w1 / 2, R00 = 1 − (w1² + w2²) / 2.
    np.testing.assert_allclose(H, [[0, 0.5, 0], [0.5, -1, 0], [0, 0, -1]], atol=1e-12)


def test_float32_stays_float32():
    back = jax.jit(lambda w: matrix_to_vector(vector_to_matrix(w)))(jnp.array([0.1, 0.2, 0.3], jnp.float32))
    assert back.dtype == jnp.float32
    np.testing.assert_allclose(back, [0.1, 0.2, 0.3], atol=1e-6)


def test_second_derivatives_of_matrix(x64):
    w, h = jnp.asarray(VECTORS), 1e-6
    slope = jax.jit(jax.vmap(jax.jacfwd(vector_to_matrix)))
    second = jax.jit(jax.vmap(jax.jacfwd(jax.jacrev(vector_to_matrix))))(w)
    numeric = np.stack([(slope(w + h * e[None]) - slope(w - h * e[None])) / (2 * h) for e in jnp.eye(3)], -1)
    np.testing.assert_allclose(second, numeric, atol=1e-8)


def test_derivative_compiles_few_sines(x64):
    """The nine numbers share them: each would otherwise have its own, which took longer to compile than all else."""
    compiled = jax.jit(jax.vmap(jax.jacfwd(vector_to_matrix))).lower(jnp.asarray(VECTORS)).compile()
    text = compiled.as_text() or ""
    assert " sine(" in text
    assert text.count(" sine(") + text.count(" cosine(") <= 4
