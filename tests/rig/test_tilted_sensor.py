"""Sensors that are tilted: against OpenCV, there and back, derivatives, and the way back without iterations."""

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.precision import float64
from jaxscan.reconstruction.lens_inverse import TiltedInverse, lens_inverse
from jaxscan.rig import Camera
from jaxscan.rig.camera import camera_parameters, lens_numbers
from jaxscan.rig.opencv_lens import LADDER
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.tilted_sensor import onto_sensor

SIZE, FOCAL, PRINCIPAL = (640, 480), (1400.0, 1390.0), (310.0, 228.0)
TERMS = (-0.2, 0.1, 1e-3, -5e-4, 0.03, 0.01, 0.02, 0.005)
TILTS = [(10, 0), (0, 10), (-3, 2), (12, -17), (0, 1e-7)]


def camera(tilt_deg=(10, -7), lens="rational"):
    n_radial, n_tangential = LADDER[lens].numbers.values()
    k1, k2, p1, p2, *more = TERMS
    radial = [k1, k2, *more][:n_radial]
    with float64():
        return Camera.create(SIZE, FOCAL, PRINCIPAL, lens, radial, [p1, p2][:n_tangential], tilt=np.radians(tilt_deg))


def points(count=400):
    return np.random.default_rng(0).uniform([-70, -50, 300], [70, 50, 400], (count, 3))


@pytest.mark.parametrize("tilt", TILTS)
def test_projection_is_opencvs(tilt):
    K = np.array([[FOCAL[0], 0, PRINCIPAL[0]], [0, FOCAL[1], PRINCIPAL[1]], [0, 0, 1.0]])
    k = np.array([*TERMS, 0, 0, 0, 0, *np.radians(tilt)])
    seen = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), K, k)[0].reshape(-1, 2)
    np.testing.assert_allclose(project_points(camera(tilt), points()).pixels, seen, rtol=0, atol=1e-9)


@pytest.mark.parametrize("tilt", TILTS)
def test_there_and_back(tilt):
    X = points()
    there = project_points(camera(tilt), X).pixels
    np.testing.assert_allclose(pixel_rays(camera(tilt), there), X / X[:, 2:], rtol=0, atol=1e-13)


def test_derivatives_are_those_of_differences():
    own, X, along, h = camera(), points(20), np.array([0.3, 0.7]), 1e-4
    pixels = project_points(own, X).pixels
    with float64():
        _, change = jax.jit(jax.vmap(lambda pixel: own.ray_and_change(pixel, jnp.asarray(along))))(jnp.asarray(pixels))
    ahead, behind = (pixel_rays(own, pixels + step * along) for step in (h, -h))
    np.testing.assert_allclose(change, (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-10)
    by_tilt = project_points(own, X).by_camera[..., -2:]
    for i, step in enumerate(1e-6 * np.eye(2)):
        ahead, behind = (project_points(tilted_by(own, sign * step), X).pixels for sign in (1, -1))
        np.testing.assert_allclose(by_tilt[..., i], (ahead - behind) / 2e-6, rtol=1e-6, atol=1e-5)


def tilted_by(own, step):
    tilt = tuple(np.asarray(float(leaf) + more) for leaf, more in zip(own.tilt, step, strict=True))
    return eqx.tree_at(lambda own: own.tilt, own, tilt)


def test_an_upright_sensor_has_no_numbers_of_it():
    upright = camera(())
    assert upright.tilt == ()
    assert len(jax.tree.leaves(upright)) == len(camera_parameters("rational"))
    assert camera_parameters("radial1", tilted=True)[-3:] == ("camera.radial.0", "camera.tilt.0", "camera.tilt.1")
    assert lens_numbers("camera.tilt.0") is None
    seen = [project_points(each, points()).pixels for each in (camera((0, 0)), upright)]
    np.testing.assert_allclose(*seen, rtol=1e-13)


def test_a_ray_that_does_not_meet_the_sensor_has_no_pixel():
    steep = (jnp.zeros(()), jnp.radians(-60.0))
    assert np.isnan(onto_sensor(steep, jnp.array([0.7, 0.0]))).all()
    assert np.isfinite(onto_sensor(steep, jnp.array([0.5, 0.0]))).all()


@pytest.mark.parametrize("tilt", [(10, -7), (30, 20), (0, 0)])
@pytest.mark.parametrize("lens", ["none", "radial1", "brown"])
def test_the_way_back_without_iterations(tilt, lens):
    own = camera(tilt, lens)
    inverse = lens_inverse(own)
    assert isinstance(inverse, TiltedInverse)
    pixels = np.stack(np.meshgrid(np.linspace(0, 639, 40), np.linspace(0, 479, 30)), axis=-1).reshape(-1, 2)
    with float64():
        xt = jnp.asarray((pixels - np.array(PRINCIPAL)) / np.array(FOCAL))
        found = np.stack(jax.vmap(inverse)(*xt.T), axis=-1)
    assert FOCAL[0] * np.abs(found - pixel_rays(own, pixels)[:, :2]).max() < 1e-3


def test_a_tilt_is_two_angles():
    with pytest.raises(InputError, match="tilt takes two angles"):
        Camera.create(SIZE, FOCAL, PRINCIPAL, tilt=[0.1])


def test_a_sensor_of_which_a_part_sees_nothing_is_refused():
    with float64():
        wide = Camera.create(SIZE, (300.0, 300.0), PRINCIPAL, tilt=np.radians([0, 75]))
    with pytest.raises(InputError, match=r"tilted by 0\.0° and 75\.0°.* calibrate again"):
        lens_inverse(wide)
