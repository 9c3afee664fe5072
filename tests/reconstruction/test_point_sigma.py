"""σ of points against Monte Carlo over rigs and pixels drawn from their covariance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.reconstruction.point_sigma import point_covariance, point_sigma, ray_jacobian
from jaxscan.rig import Camera, Covariance, LightPlane, Linear, Rig, Rotary
from jaxscan.rig.rig import parameter_names

PIXELS = np.array([[100.0, 60.0], [320.0, 100.0], [600.0, 20.0]])
STEPS = np.array([0.0, 40000.0, -72000.0])
Q = {"stage": STEPS, "turntable": STEPS / 50}
STRIPE_SIGMA = 0.1


@pytest.fixture(scope="module")
def rig():
    with float64():
        camera = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "radial1", [-0.134])
        return as_numpy(Rig(camera, (LightPlane.create([0.0, -0.00494, 0.00303]),), Linear.create([0.0, 1e-3, -1e-4])))


@pytest.fixture(scope="module")
def covariance(rig):
    names = tuple(parameter_names(rig))
    random = np.random.default_rng(0)
    scale = np.array([0.3, 0.3, 0.2, 0.2, 1e-3, 1e-6, 2e-6, 2e-6, 4e-6, 4e-6, 4e-6])
    root = scale[:, None] * (np.eye(len(names)) + 0.3 * random.normal(size=(len(names), len(names))))
    return Covariance(names, root @ root.T)


@pytest.fixture(scope="module")
def drawn(rig, covariance):
    """Points of 20 000 drawn rigs (draws, points, 3): with exact pixels, and of the rig with drawn pixels."""
    random = np.random.default_rng(1)
    n = 20000
    with float64():
        leaves, tree = jax.tree.flatten(as_float64(rig))

        @jax.jit
        @jax.vmap
        def points(parameters, shift):
            rig = jax.tree.unflatten(tree, list(parameters))
            moved = jnp.asarray(PIXELS) + shift[:, None] * jnp.array([[0.0, 1.0]])
            return jax.vmap(rig.triangulate)(moved, jax.tree.map(jnp.asarray, Q))

        mean = np.array([float(x) for x in leaves])
        parameters = random.multivariate_normal(mean, covariance.matrix, size=n)
        shifts = STRIPE_SIGMA * random.normal(size=(n, len(PIXELS)))
        of_rig = points(jnp.asarray(parameters), jnp.zeros(shifts.shape))
        of_pixel = points(jnp.asarray(np.tile(mean, (n, 1))), jnp.asarray(shifts))
        return np.asarray(of_rig), np.asarray(of_pixel)


def test_covariances_of_rig_and_pixel_are_those_of_drawn_rigs_and_pixels(rig, covariance, drawn):
    found = point_covariance(rig, "", covariance, STRIPE_SIGMA, PIXELS, Q, columns=True)
    for part, points in zip((found.rig, found.pixel), drawn, strict=True):
        for i in range(len(PIXELS)):
            spread = np.cov(points[:, i].T)
            np.testing.assert_allclose(part[i], spread, atol=0.04 * np.abs(spread).max())
    np.testing.assert_array_equal(found.total, found.rig + found.pixel)


def test_sigma_is_the_spread_along_the_ray(rig, covariance, drawn):
    both, pixel_alone = point_sigma(rig, "", covariance, STRIPE_SIGMA, PIXELS, Q, columns=True)
    with float64():
        rays = np.array([as_float64(rig).camera.ray(jnp.asarray(pixel)) for pixel in PIXELS])
    along = rays / np.linalg.norm(rays, axis=1)[:, None]
    of_rig, of_pixel = (np.einsum("npi,pi->np", points, along).std(axis=0) for points in drawn)
    np.testing.assert_allclose(pixel_alone, of_pixel, rtol=0.03)
    np.testing.assert_allclose(both, np.hypot(of_rig, of_pixel), rtol=0.03)


def test_a_stripe_found_row_by_row_is_uncertain_along_u(rig, covariance):
    near_axis = 1
    _, by_rows = point_sigma(rig, "", covariance, STRIPE_SIGMA, PIXELS, Q, columns=False)
    _, by_columns = point_sigma(rig, "", covariance, STRIPE_SIGMA, PIXELS, Q, columns=True)
    # ω has no x component: on the axis a step along u moves the point across the ray alone, not in depth.
    assert by_rows[near_axis] < 0.02 * by_columns[near_axis]


@pytest.mark.parametrize("turned", [False, True])
def test_derivatives_along_the_ray_are_differences(rig, turned):
    """The rig has a lens with all terms, two lasers and a stage; a pixel off the sheet has no derivative."""
    with float64():
        lens = {"radial": [-0.13, 0.02, 0.003, 0.01, 0.002, 0.001], "tangential": [4e-4, -3e-4]}
        camera = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "rational", **lens)
        other = LightPlane.create([0.0, 0.004, 0.003], "lower")
        lights = (LightPlane.create([1e-4, -0.00494, 0.00303], "upper"), other)
        both = Rig(camera, lights, rig.axis("stage"))
        if turned:
            both = both.with_axis(Rotary.create([2e-4, 1.5e-3, 1e-4], [3.0, 4.0, 340.0]))
        both = as_numpy(both)
        found, of_pixel = ray_jacobian(both, "upper", PIXELS, Q, columns=True)
        leaves, tree = jax.tree.flatten(as_float64(both))

        @jax.jit
        def points(leaves, shift):
            moved = jax.tree.unflatten(tree, list(leaves))
            pixels = jnp.asarray(PIXELS) + shift * jnp.array([[0.0, 1.0]])
            return jax.vmap(lambda p, q: moved.triangulate(p, q, "upper"))(pixels, jax.tree.map(jnp.asarray, Q))

        values = np.array([float(leaf) for leaf in leaves])
        # As the object sees it.
        ray = np.asarray(points(values, 0.0)) - both.pose(Q).inverse().translation
        along = ray / np.linalg.norm(ray, axis=1)[:, None]

        def difference(step, shift):
            up, down = (np.asarray(points(values + way * step, way * shift)) for way in (1, -1))
            return np.einsum("pi,pi->p", (up - down) / 2, along)

        for i, value in enumerate(values):
            h = 1e-5 * max(abs(value), 1e-3)
            expected = difference(h * (np.arange(len(values)) == i), 0.0) / h
            np.testing.assert_allclose(found[:, i], expected, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(of_pixel, difference(0.0, 1e-3) / 1e-3, rtol=1e-5)
    assert np.isnan(ray_jacobian(rig, "", np.array([[320.0, 700.0]]), {}, columns=True)[0]).all()
