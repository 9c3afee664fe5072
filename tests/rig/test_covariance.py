"""What is computed from a rig, and its covariance, against rigs drawn from theirs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import Camera, Covariance, LightPlane, Rig
from jaxscan.rig.rig import parameter_names

HELD = "camera.principal.1"


@pytest.fixture(scope="module")
def rig():
    with float64():
        camera = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "brown", [-0.13, 0.02, 0.0], [1e-3, -1e-3])
        return as_numpy(Rig(camera, (LightPlane.create([0.0, -0.00494, 0.00303]),)))


@pytest.fixture(scope="module")
def covariance(rig):
    """The covariance of all parameters but one, in another order, with a number of a pose behind them."""
    names = [*[name for name in parameter_names(rig) if name != HELD][::-1], "board.rotation.0"]
    random = np.random.default_rng(0)
    scale = np.array([2e-6, 2e-6, 1e-6, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 0.2, 0.3, 0.3, 1e-3])
    root = scale[:, None] * (np.eye(len(names)) + 0.3 * random.normal(size=(len(names), len(names))))
    return Covariance(tuple(names), root @ root.T)


def draws(rig, covariance, n=20000):
    leaves, tree = jax.tree.flatten(rig)
    mean = np.array([float(leaf) for leaf in leaves])
    drawn = np.random.default_rng(1).multivariate_normal(mean, covariance.of_leaves(rig), size=n)
    return drawn, tree


def test_of_leaves_puts_each_parameter_in_its_place_and_held_ones_to_zero(rig, covariance):
    full = covariance.of_leaves(rig)
    names = parameter_names(rig)
    assert full[names.index(HELD)].any() == False  # noqa: E712 (a NumPy bool)
    for a in ("camera.focal.0", "lights.0.plane.2"):
        assert full[names.index(a), names.index(a)] == pytest.approx(covariance.sigma(a) ** 2, rel=1e-12)
    i, j = covariance.names.index("camera.focal.0"), covariance.names.index("lights.0.plane.1")
    assert full[names.index("camera.focal.0"), names.index("lights.0.plane.1")] == covariance.matrix[i, j]


def test_projected_points_scatter_as_predicted(rig, covariance):
    points = np.array([[0.0, 0.0, 300.0], [100.0, -60.0, 350.0], [-90.0, 80.0, 400.0]])
    drawn, tree = draws(rig, covariance)
    with float64():
        seen = jax.jit(
            jax.vmap(lambda theta: jax.vmap(jax.tree.unflatten(tree, list(theta)).camera.project)(jnp.asarray(points)))
        )(jnp.asarray(drawn))
    predicted = covariance.of_projected(rig, points)
    for i in range(len(points)):
        spread = np.cov(np.asarray(seen)[:, i].T)
        np.testing.assert_allclose(predicted[i], spread, atol=0.04 * np.abs(spread).max())


def test_of_any_function_is_that_of_the_leaves_for_the_leaves(rig, covariance):
    found = covariance.of(rig, lambda rig: jnp.stack([rig.camera.focal[0], 2 * rig.lights[0].plane[2]]))
    a, b = covariance.sigma("camera.focal.0"), covariance.sigma("lights.0.plane.2")
    np.testing.assert_allclose(np.sqrt(np.diag(found)), [a, 2 * b], rtol=1e-12)


def test_of_a_function_agrees_with_of_projected(rig, covariance):
    point = np.array([100.0, -60.0, 350.0])
    with float64():
        as_function = covariance.of(rig, lambda rig: as_float64(rig).camera.project(jnp.asarray(point)))
    np.testing.assert_allclose(as_function, covariance.of_projected(rig, point[None])[0], rtol=1e-10)
