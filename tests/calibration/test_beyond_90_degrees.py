"""A fisheye whose boards and stripes are at 90° to its axis and beyond: found, written, triangulated, photographed."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import fisheye
from benchmarks.drawn import Noise, redrawn
from jaxscan.calibration import Model, calibrate, calibrate_by_evidence
from jaxscan.calibration.next_pose import reachable
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Kernel, triangulate
from jaxscan.reconstruction.next_best_views import next_best_views
from jaxscan.reconstruction.point_sigma import point_covariance, point_sigma
from jaxscan.reconstruction.triangulate import FramePoses
from jaxscan.reconstruction.working_volume import working_volumes
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from jaxscan.rig.board_shape import middle_and_half
from jaxscan.rig.projection import off_axis, pixel_rays
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.render import render


@pytest.fixture(scope="module")
def truth():
    with float64():
        camera = Camera.create((640, 480), fisheye._FOCAL, fisheye._PRINCIPAL, "fisheye", fisheye._ANGULAR)
        return as_numpy(Rig(camera, (LightPlane.create(fisheye._OMEGA),), Linear.create(fisheye._PER_STEP)))


@pytest.fixture(scope="module")
def session(truth):
    return fisheye.wide_session(truth)


@pytest.fixture(scope="module")
def found(session):
    return calibrate(redrawn(session[0].exact, Noise(), np.random.default_rng(0)), lens="fisheye")


def error_in_sigma(found, truth):
    """The largest of the rig's numbers."""
    sigma = np.array([found.covariance.sigma(name) for name in parameter_names(found.rig)])
    return np.abs((np.array(jax.tree.leaves(found.rig)) - np.array(jax.tree.leaves(truth))) / sigma).max()


def test_the_rig_is_found_within_its_errors_and_written(truth, session, found, tmp_path):
    assert session[1] > 110
    names = parameter_names(found.rig)
    sigma = np.array([found.covariance.sigma(name) for name in names])
    assert error_in_sigma(found, truth) < 4
    assert sigma[:2].max() < 0.03
    assert 0.9 < found.stripe_rms_px / Noise().stripe < 1.1
    stripes = found.stripe_points(0)[0]
    assert (np.degrees(off_axis(stripes)) > 90).sum() > 5
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert jax.tree.leaves(back.rig) == jax.tree.leaves(found.rig)
    near, far = back.fit["stripe_depths_mm"]
    distances = np.linalg.norm(stripes, axis=1)
    np.testing.assert_allclose([near, far], [distances.min(), distances.max()], atol=0.06)


def test_the_kernel_and_its_covariance_are_those_of_the_formula(found):
    rig = found.rig
    u, v = (x.ravel().astype(float) for x in np.meshgrid(np.arange(0, 640, 9), np.arange(0, 480, 11)))
    pixels = np.stack([u, v], axis=1)
    q = {"stage": np.full(len(pixels), 20000.0)}
    frames = FramePoses.create(rig.motion, {"stage": np.array([20000.0])}, 1)
    points = np.asarray(triangulate(Kernel.create(rig), frames, jnp.asarray(u[None]), jnp.asarray(v[None])))[0]
    with float64():
        exact = np.asarray(jax.jit(jax.vmap(rig.triangulate))(jnp.asarray(pixels), jax.tree.map(jnp.asarray, q)))
    np.testing.assert_array_equal(np.isfinite(points), np.isfinite(exact))
    rays = pixel_rays(rig.camera, pixels)
    near = np.isfinite(exact).all(axis=1) & (np.linalg.norm(exact, axis=1) < 400)
    assert (np.degrees(off_axis(rays[near])) > 90).sum() > 200
    np.testing.assert_allclose(points[near], exact[near], atol=2e-3)
    some = np.flatnonzero(near)[::7]
    each = {"stage": q["stage"][some]}
    whole = point_covariance(rig, "", found.covariance, 0.06, pixels[some], each, True)
    along, pixel = point_sigma(rig, "", found.covariance, 0.06, pixels[some], each, True)
    d = rays[some]
    np.testing.assert_allclose(along, np.sqrt(np.einsum("pi,pij,pj->p", d, whole.total, d)), rtol=1e-9)
    np.testing.assert_allclose(pixel, np.sqrt(np.einsum("pi,pij,pj->p", d, whole.pixel, d)), rtol=1e-9)


def test_the_working_volume_and_the_next_photograph(found):
    (volume,) = working_volumes(found)
    assert volume.depths_mm[0] > 100
    assert 0.6 < np.isfinite(volume.sigma_mm).mean() < 1
    # Around the camera: more than half a turn at the middle distance.
    assert np.ptp(volume.positions_mm) > np.pi * volume.depths_mm.mean()
    with float64():
        low, high = np.exp(np.asarray(reachable(found).log_depths))
    assert 90 < low < high < 220
    views = next_best_views(found, (volume,), count=1)
    assert views.medians[0] < views.median_now
    assert np.isfinite(views.poses[0].outline_px).all()


def test_a_photograph_shows_board_and_stripe_where_the_rig_has_them(truth, session):
    exact, boards = session[0].exact, session[0].boards
    scene = rig_2003.board_scene(boards.rotation[1], boards.translation[1])
    profile = true_profile(truth, scene)
    seen = np.isfinite(profile.position)
    pixels = np.stack([np.flatnonzero(seen), profile.position[seen]], axis=1)
    with float64():
        points = np.asarray(jax.vmap(lambda p: truth.triangulate(p, {}))(jnp.asarray(pixels)))
    assert np.degrees(off_axis(points)).max() > 100
    np.testing.assert_allclose(profile.points[seen], points, atol=1e-5)
    dark, lit = (render(truth, scene, laser=laser, seed=1).astype(float)[..., 0] for laser in (None, 0))
    rows = np.rint(pixels).astype(int)
    assert (lit - dark)[rows[:, 1], rows[:, 0]].mean() > 20
    assert np.abs(lit - dark).mean() < 2
    # White and dark squares stand where the corners say: the four around a corner differ crosswise.
    corners = exact.views[1].corners.reshape(6, 9, 2)
    middles = (corners[:-1, :-1] + corners[:-1, 1:] + corners[1:, :-1] + corners[1:, 1:]) / 4
    at = np.rint(middles).astype(int)
    grey = dark[at[..., 1], at[..., 0]]
    one = np.add.outer(np.arange(5), np.arange(8)) % 2 == 0
    a, b = sorted([grey[one], grey[~one]], key=np.mean)
    assert b.min() > 2 * a.max()


def test_the_model_that_is_chosen_begins_with_a_fisheye(session):
    seen = redrawn(session[0].exact, Noise(), np.random.default_rng(0))
    found = calibrate_by_evidence(seen, Model())
    assert found.choice.model == Model("fisheye", lights=("plane",))
    (trial,) = found.choice.added
    assert (trial.of, np.isnan(trial.gain)) == ("lens fisheye", True)
    assert found.choice.sentence.endswith(
        "since corners are 115° off the camera's axis, where only a fisheye sees them"
    )
    assert json.loads(json.dumps(found.choice.as_data()))["trials"][0]["gain"] is None
    given = calibrate(seen, lens="fisheye")
    np.testing.assert_array_equal(found.covariance.matrix, given.covariance.matrix)


def test_another_lens_that_is_asked_for_is_refused_by_name_of_the_right_one(session):
    seen = redrawn(session[0].exact, Noise(), np.random.default_rng(0))
    with pytest.raises((ObservabilityError, SolveError), match=r'115° off .* calibrate with lens = "fisheye"$'):
        calibrate(seen)


def test_a_bowed_sheet_behind_the_camera_is_refused(session):
    seen = redrawn(session[0].exact, Noise(), np.random.default_rng(0))
    with pytest.raises(InputError, match=r"the stripe in view-\d+ is 105° off the camera's axis.*--sheet plane"):
        calibrate(seen, lens="fisheye", light="bowed")


@pytest.mark.long
def test_two_lasers_are_found_behind_the_camera(truth):
    below = LightPlane.create(np.array([-0.003, 0.024, 0.003]), "below")
    two = as_numpy(replace(truth, lights=(replace(truth.lights[0], name="above"), below)))
    exact = fisheye.wide_session(two)[0].exact
    found = calibrate(redrawn(exact, Noise(), np.random.default_rng(1)), lens="fisheye")
    assert error_in_sigma(found, two) < 4
    assert all((np.degrees(off_axis(found.stripe_points(i)[0])) > 90).sum() > 5 for i in range(2))


@pytest.mark.long
def test_bent_boards_are_found_behind_the_camera(truth):
    middle, half = middle_and_half(rig_2003.BOARD.points())

    def height(x, y):
        s, t = (x - middle[0]) / half[0], (y - middle[1]) / half[1]
        return 0.5 * (1 / 3 - s**2) + 0.2 * s * t

    seen = redrawn(fisheye.wide_session(truth, height)[0].exact, Noise(), np.random.default_rng(0))
    found = calibrate_by_evidence(seen, Model())
    assert found.choice.model == Model("fisheye", board_shape="warp", lights=("plane",))
    assert error_in_sigma(found, truth) < 4
    np.testing.assert_allclose([*found.system.shape.bulge, *found.system.shape.twist], [0.5, 0.0, 0.2], atol=0.02)
