"""σ of points against Monte Carlo over rigs and pixels drawn from their covariance."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.files.rig_file import Covariance
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.reconstruction.point_sigma import point_sigma
from jaxscan.rig import Camera, LightPlane, Rig, Stage
from jaxscan.rig.rig import parameter_names


def test_sigma_is_the_spread_of_drawn_rigs_and_pixels():
    with float64():
        camera = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "radial1", [-0.134])
        rig = as_numpy(Rig(camera, (LightPlane.create([0.0, -0.00494, 0.00303]),), Stage.create([0.0, 1e-3, -1e-4])))
    names = tuple(parameter_names(rig))
    random = np.random.default_rng(0)
    scale = np.array([0.3, 0.3, 0.2, 0.2, 1e-3, 1e-6, 2e-6, 2e-6, 1e-7, 1e-7, 1e-7])
    mixing = np.eye(len(names)) + 0.3 * random.normal(size=(len(names), len(names)))
    root = scale[:, None] * mixing
    pixels = np.array([[100.0, 60.0], [320.0, 100.0], [600.0, 20.0]])
    both, pixel_alone = point_sigma(rig, "", Covariance(names, root @ root.T), 0.1, pixels, columns=True)
    with float64():
        leaves, tree = jax.tree.flatten(as_float64(rig))

        @jax.jit
        @jax.vmap
        def distances(parameters, shift):
            drawn = jax.tree.unflatten(tree, list(parameters))
            each = jax.vmap(lambda p: drawn.lasers[0].triangulate(drawn.camera.ray(p)))
            return jnp.linalg.norm(each(jnp.asarray(pixels) + shift[:, None] * jnp.array([[0.0, 1.0]])), axis=1)

        n = 20000
        parameters = np.array([float(x) for x in leaves]) + random.normal(size=(n, len(names))) @ root.T
        shifts = 0.1 * random.normal(size=(n, len(pixels)))
        spread = np.asarray(distances(jnp.asarray(parameters), jnp.asarray(shifts))).std(axis=0)
        of_pixel = np.asarray(distances(jnp.asarray(np.tile(parameters.mean(0), (n, 1))), jnp.asarray(shifts))).std(
            axis=0
        )
    np.testing.assert_allclose(both, spread, rtol=0.03)
    np.testing.assert_allclose(pixel_alone, of_pixel, rtol=0.03)
