"""A fisheye at 90° to its axis and beyond: its formula, its derivatives, where it ends, and what lights are there."""

from contextlib import nullcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import initial
from jaxscan.cli.format_summary import format_summary
from jaxscan.cli.summary import rig_summary
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.geometry import vector_to_matrix
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import BowedSheet, Camera, LightPlane, Rig
from jaxscan.rig.chart import AROUND, FLAT
from jaxscan.rig.light import distance, meet, section_around
from jaxscan.rig.projection import pixel_rays, project_points, within_fold

ANGULAR = (0.012, -0.006, 0.0012, -0.00008)
# Of these terms r_d grows up to √(1 / 0.3) radians: 104.6°.
FOLDING, FOLD = (-0.1, 0.0, 0.0, 0.0), np.sqrt(1 / 0.3)


def camera_of(angular=ANGULAR, tilt=()):
    with float64():
        return as_numpy(Camera.create((640, 480), (151.0, 149.0), (316.3, 242.8), "fisheye", angular, tilt=tilt))


def ways(angles):
    """Unit vectors at angles from the axis, all around it."""
    theta, phi = (x.ravel() for x in np.meshgrid(angles, np.radians(np.arange(3.0, 360.0, 19.0))))
    return theta, phi, np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


def test_pixels_are_those_of_the_formula_and_come_back():
    theta, phi, way = ways(np.radians([0.0, 1e-7, 5.0, 60.0, 89.9999, 90.0, 90.0001, 100.0, 130.0, 170.0]))
    k1, k2, k3, k4 = ANGULAR
    rd = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    pixels = np.stack([151.0 * rd * np.cos(phi) + 316.3, 149.0 * rd * np.sin(phi) + 242.8], axis=1)
    camera = camera_of()
    seen = project_points(camera, 130.0 * way)
    np.testing.assert_allclose(seen.pixels, pixels, atol=1e-10)
    np.testing.assert_allclose(pixel_rays(camera, pixels), way, atol=1e-12)
    assert within_fold(camera, 130.0 * way).all()


@pytest.mark.parametrize("tilt", [(), (0.03, -0.02)])
def test_derivatives_are_those_of_differences(tilt):
    camera = camera_of(tilt=tilt)
    _, _, way = ways(np.radians([0.0, 1e-4, 40.0, 90.0, 110.0]))
    points, h = 130.0 * way, 1e-4
    by_point = project_points(camera, points).by_point
    apart = [project_points(camera, points + s * h * e).pixels for e in np.eye(3) for s in (1, -1)]
    numeric = np.stack([(apart[2 * i] - apart[2 * i + 1]) / (2 * h) for i in range(3)], axis=-1)
    np.testing.assert_allclose(by_point, numeric, atol=1e-7)
    pixels = project_points(camera, points).pixels
    with float64():
        along = jnp.array([0.6, -0.8])
        rays, changes = jax.vmap(lambda pixel: camera.ray_and_change(pixel, along))(jnp.asarray(pixels))
        by_lens = jax.jacrev(lambda lens: Camera(camera.focal, camera.principal, lens, (640, 480), camera.tilt).ray(p))
        p = jnp.asarray(pixels[-1])
        by_k1 = np.asarray(by_lens(jax.tree.map(jnp.asarray, camera.lens)).angular[0])
    np.testing.assert_allclose(rays, way, atol=1e-12)
    step = 1e-4 * np.array([0.6, -0.8])
    numeric = (pixel_rays(camera, pixels + step) - pixel_rays(camera, pixels - step)) / 2e-4
    np.testing.assert_allclose(changes, numeric, atol=1e-8)
    more, less = (camera_of((ANGULAR[0] + s, *ANGULAR[1:]), tilt) for s in (1e-5, -1e-5))
    numeric = (pixel_rays(more, pixels[-1:]) - pixel_rays(less, pixels[-1:]))[0] / 2e-5
    np.testing.assert_allclose(by_k1, numeric, atol=1e-6)


def test_a_ray_that_the_lens_does_not_reach_has_no_pixel(tmp_path):
    camera = camera_of(FOLDING)
    theta, _, way = ways(FOLD + np.array([-0.3, -0.01, -1e-5, 1e-5, 0.01, 0.5, 1.2]))
    seen = project_points(camera, 100.0 * way).pixels
    np.testing.assert_array_equal(np.isfinite(seen).all(axis=1), theta < FOLD)
    np.testing.assert_array_equal(within_fold(camera, way), theta < FOLD)
    well_within = theta < FOLD - 1e-3
    np.testing.assert_allclose(pixel_rays(camera, seen[well_within]), way[well_within], atol=1e-12)
    highest = 151.0 * 2 * FOLD / 3
    assert np.isfinite(pixel_rays(camera, np.array([[316.3 + 0.999 * highest, 242.8]]))).all()
    assert np.isnan(pixel_rays(camera, np.array([[316.3 + 1.001 * highest, 242.8]]))).all()
    # Straight behind the camera no pixel is the one.
    assert np.isnan(project_points(camera_of(), np.array([[0.0, 0.0, -50.0]])).pixels).all()
    write_rig(tmp_path / "rig.json", RigFile(Rig(camera)))
    words = format_summary(rig_summary(tmp_path / "rig.json"))
    # On a grid; the disc that it sees is 34 % of the image.
    assert "sees up to 105° off its axis, and 70 % of the image is beyond it" in words


def test_both_settings_of_precision():
    for setting in (nullcontext, float64):
        with setting():
            x = jnp.asarray([0.4, -1.9])
            ray = jnp.stack(AROUND.components(x[0], x[1]))
            assert ray.dtype == x.dtype
            back, there = AROUND.coordinates(ray)
            assert there
            np.testing.assert_allclose(back, x, rtol=20 * float(jnp.finfo(x.dtype).eps))
    _, _, way = ways(np.radians([30.0, 95.0]))
    seen = np.asarray(jax.jit(jax.vmap(camera_of().project))(jnp.asarray(way, jnp.float32)))
    np.testing.assert_allclose(seen, project_points(camera_of(), way).pixels, atol=1e-3)


def test_the_flat_chart_has_nothing_behind_the_camera():
    for z, there in ((2.0, True), (0.0, False), (-2.0, False)):
        assert bool(FLAT.coordinates(jnp.array([1.0, 1.0, z]))[1]) is there


def test_poses_of_boards_beside_the_camera_in_closed_form():
    points = np.stack(np.meshgrid(16.0 * np.arange(9), 16.0 * np.arange(6)), axis=-1).reshape(-1, 2)
    poses = []
    for degrees, around in ((0.0, 0.0), (50.0, 1.0), (90.0, 2.5), (105.0, 4.0), (120.0, 0.3)):
        turn = vector_to_matrix(np.radians(degrees) * np.array([-np.sin(around), np.cos(around), 0.0]))
        R = turn @ vector_to_matrix(np.array([0.4, -0.3, 1.0]))
        poses.append((R, 150.0 * turn[:, 2] - R[:, :2] @ points.mean(axis=0)))
    X = np.stack([points @ R[:, :2].T + t for R, t in poses])
    assert (X[3:, :, 2] < 0).sum() > 20
    used = np.ones(X.shape[:2], bool)
    used[:, 3] = False
    rays = np.where(used[..., None], X / np.linalg.norm(X, axis=-1, keepdims=True), np.nan)
    R, t = initial.board_poses(points, rays, used)
    np.testing.assert_allclose(R, [R for R, _ in poses], atol=1e-9)
    np.testing.assert_allclose(t, [t for _, t in poses], atol=1e-7)


def test_a_flat_sheet_goes_on_behind_the_camera_and_a_bowed_one_does_not():
    omega = [0.002, -0.027, 0.004]
    with float64():
        plane, bowed = as_numpy(LightPlane.create(omega)), as_numpy(BowedSheet.create(omega, 0.1))
    X = section_around(plane, np.array([60.0, 120.0]), np.radians(np.arange(-180.0, 180.0, 20.0)))
    assert (X[..., 2] < -20).sum() > 5
    np.testing.assert_allclose(np.linalg.norm(X, axis=-1), np.broadcast_to([[60.0], [120.0]], X.shape[:2]), rtol=1e-12)
    np.testing.assert_allclose(distance(plane, X), 0, atol=1e-10)
    behind = X[X[:, :, 2] < 0]
    rays = behind / np.linalg.norm(behind, axis=-1, keepdims=True)
    with float64():
        np.testing.assert_allclose(jax.vmap(lambda ray: meet(plane, ray))(jnp.asarray(rays)), behind, rtol=1e-9)
        assert np.isnan(jax.vmap(lambda ray: meet(bowed, ray))(jnp.asarray(rays))).all()
    # Of a ray of any length it is the same point.
    ahead = np.array([[0.3, -0.5, 1.0], [-2.0, -1.0, 0.2]])
    np.testing.assert_allclose(bowed.inverse_depth(7.0 * ahead), 7.0 * bowed.inverse_depth(ahead), rtol=1e-12)
    assert np.isnan(section_around(plane, np.array([20.0]), np.zeros(1))).all()
