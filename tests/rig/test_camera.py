"""The camera against OpenCV, its inverse against itself, derivatives against finite differences."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.rig import Camera

LENS_VALUES = {
    "none": ([], []),
    "radial1": ([-0.13396], []),
    "radial2": ([-0.28, 0.08], []),
    "radial3": ([-0.27, 0.05, 0.02], []),
    "brown": ([-0.27, 0.05, 0.1], [1e-3, -2e-3]),
    "rational": ([0.47, 0.0267, 4.4e-5, 0.767, 0.0963, 0.0014], [-1.2e-5, 9e-5]),
}
PIXELS = [[0.0, 0.0], [310.3, 228.1], [639.0, 479.0], [17.25, 400.5], [320.0, 1.0]]


def camera(lens, dtype=None):
    radial, tangential = LENS_VALUES[lens]
    made = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], lens, radial, tangential)
    return made if dtype is None else jax.tree.map(lambda leaf: leaf.astype(dtype), made)


def opencv_coefficients(lens):
    (k1, k2, k3, k4, k5, k6), (p1, p2) = (
        np.pad(x, (0, n - len(x))) for x, n in zip(LENS_VALUES[lens], (6, 2), strict=True)
    )
    return np.array([k1, k2, p1, p2, k3, k4, k5, k6])


@pytest.mark.parametrize("lens", LENS_VALUES)
def test_projection_is_opencvs(x64, lens):
    points = np.random.default_rng(1).uniform([-120, -90, 300], [120, 90, 400], (40, 3))
    K = np.array([[697.7, 0, 310.3], [0, 690.4, 228.1], [0, 0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, opencv_coefficients(lens))[0].reshape(-1, 2)
    np.testing.assert_allclose(jax.jit(jax.vmap(camera(lens).project))(jnp.asarray(points)), expected, atol=1e-9)


@pytest.mark.parametrize("lens", LENS_VALUES)
def test_ray_inverts_projection_to_rounding(x64, lens):
    cam = camera(lens)
    pixels = jnp.asarray(PIXELS)
    rays = jax.jit(jax.vmap(cam.ray))(pixels)
    np.testing.assert_allclose(jax.jit(jax.vmap(cam.project))(350 * rays), pixels, atol=1e-10)


@pytest.mark.parametrize("lens", LENS_VALUES)
def test_ray_in_float32(lens):
    cam = camera(lens, jnp.float32)
    pixels = jnp.asarray(PIXELS, jnp.float32)
    rays = jax.jit(jax.vmap(cam.ray))(pixels)
    assert rays.dtype == jnp.float32
    np.testing.assert_allclose(jax.jit(jax.vmap(cam.project))(rays), pixels, atol=2e-3)


@pytest.mark.parametrize("lens", ["radial1", pytest.param("rational", marks=pytest.mark.long)])
def test_derivatives_of_the_ray(x64, lens):
    cam, pixel = camera(lens), jnp.array([31.0, 440.0])
    leaves, tree = jax.tree.flatten(cam)

    @jax.jit
    def ray(vector):
        return jax.tree.unflatten(tree, list(vector[2:])).ray(vector[:2])[:2]

    at = jnp.concatenate([pixel, jnp.stack(leaves)])
    gradient = jax.jit(jax.jacrev(ray))
    forward, reverse = jax.jit(jax.jacfwd(ray))(at), gradient(at)
    h = 1e-6 * jnp.maximum(1, jnp.abs(at))
    numeric = jnp.stack([(ray(at + e) - ray(at - e)) / (2 * e.sum()) for e in jnp.diag(h)], axis=-1)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(forward, numeric, rtol=2e-6, atol=1e-8)
    second = jax.jit(jax.jacfwd(jax.jacrev(ray)))(at)
    numeric2 = jnp.stack([(gradient(at + e) - gradient(at - e)) / (2 * e.sum()) for e in jnp.diag(h)], axis=-1)
    np.testing.assert_allclose(second, numeric2, rtol=1e-4, atol=1e-6)


def test_ray_at_the_principal_point_has_a_derivative(x64):
    J = jax.jit(jax.jacfwd(camera("radial1").ray))(jnp.array([310.3, 228.1]))
    np.testing.assert_allclose(J, [[1 / 697.7, 0], [0, 1 / 690.4], [0, 0]], atol=1e-15)


def test_outside_the_invertible_range_is_nan(x64):
    # r (1 + k1 r²) is highest at r² = −1 / (3 k1), where it is 2/3 r.
    cam = camera("radial1")
    highest = 2 / 3 / np.sqrt(3 * 0.13396)
    inside, outside = (jnp.array([310.3 + 697.7 * highest * s, 228.1]) for s in (0.9999, 1.0001))
    assert np.isfinite(cam.ray(inside)).all()
    assert np.isnan(cam.ray(outside)[0])


def test_a_point_behind_the_camera_has_no_pixel(x64):
    assert np.isnan(camera("radial1").project(jnp.array([1.0, 2.0, -300.0]))).all()
    assert np.isnan(camera("radial1").project(jnp.array([1.0, 2.0, 0.0]))).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"lens": "omni"}, 'no lens "omni"'),
        ({"lens": "radial1", "radial": [0.1, 0.2]}, "choose a richer lens"),
        ({"focal": [700.0, 700.0, 1.0]}, "two numbers"),
    ],
)
def test_what_is_no_camera_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        Camera.create(**({"image_size": (640, 480), "focal": [700.0, 700.0], "principal": [320.0, 240.0]} | arguments))
