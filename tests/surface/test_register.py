"""Sides brought together: recovery of known poses within their predicted σ, derivatives, and what is refused."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from jaxscan.errors import InputError, ObservabilityError
from jaxscan.geometry import Pose
from jaxscan.surface.coarse_register import check_fits, check_turned, coarse_register, fits
from jaxscan.surface.floor import find_floor, stands_on
from jaxscan.surface.pairs import equations, match
from jaxscan.surface.register import NotSettledWarning, as_given, register
from jaxscan.surface.side import side_of_cloud
from tests.surface import scenes
from tests.surface.hills import NOISE, height, pose, scanned, side

TURNS = (0.0, 85.0, 175.0, 272.0)
SHIFTS = ((0.0, 0.0), (1.0, -0.5), (-0.7, 0.8), (0.3, 1.0))


@pytest.fixture(scope="module")
def sides():
    return [
        side(f"{turn:g}.npz", scanned(turn, seed, shift))
        for seed, (turn, shift) in enumerate(zip(TURNS, SHIFTS, strict=True))
    ]


@pytest.fixture(scope="module")
def truth():
    return [pose(turn, shift) for turn, shift in zip(TURNS, SHIFTS, strict=True)]


def off(found, true, centre):
    """The small motion (radians about the centre, mm) from the true pose to the found one."""
    apart = found @ true.inverse()
    return np.concatenate([apart.rotation, apart.apply(centre) - centre])


def test_sigma_is_the_scatter_about_the_surface(sides):
    x, y, z = sides[0].points.T
    up = 300.0 - z - height(x, -(y + 12.0))
    inner = ~sides[0].rim
    in_sigma = (up * -sides[0].normals[:, 2] / sides[0].sigma)[inner]
    assert np.median(np.abs(in_sigma)) * 1.4826 == pytest.approx(1.0, abs=0.05)
    assert sides[0].sigma.max() <= NOISE * 1.001


def test_derivatives_against_finite_differences(sides, truth):
    found = match(sides[0], sides[1], truth[0], truth[1], 1.0, 50)
    centre = sides[0].points.mean(axis=0)
    J = equations(sides[0], sides[1], truth[0], truth[1], found, centre).J
    for k in (0, 2, 4, 7, 11):
        ends = []
        for step in (1e-5, -1e-5):
            motion = np.zeros(12)
            motion[k] = step
            poses = []
            for T, part in zip(truth[:2], (motion[:6], motion[6:]), strict=True):
                poses.append(Pose.about(part[:3], centre, part[3:]) @ T)
            ends.append(equations(sides[0], sides[1], poses[0], poses[1], found, centre).residual)
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-5, J[:, k], rtol=1e-4, atol=1e-6)


def test_all_sides_together_within_the_predicted_covariance(sides, truth):
    rough = [arg - base for arg, base in zip(TURNS, (0.0, 9.0, -8.0, 10.0), strict=True)]
    starts = coarse_register(sides, rough)
    found = register(sides, starts)
    check_fits(sides, found)
    assert len(found.pairs) == 6
    error = np.concatenate([off(T, true, found.centre) for T, true in zip(found.poses, truth, strict=True)][1:])
    chi2 = error @ np.linalg.solve(found.covariance, error) / len(error)
    assert 0.3 < chi2 < 2.0
    assert found.variance == pytest.approx(0.9, abs=0.15)
    assert max(np.linalg.norm(part[3:]) for part in error.reshape(-1, 6)) < 0.01
    assert found.closure_mm < 0.01
    assert found.sigma(0) == (0.0, 0.0)
    assert 0 < found.sigma(2)[0] < np.radians(0.1)


@pytest.mark.parametrize("claimed", [0.5, 2.0])
def test_residuals_that_are_larger_than_their_sigma_widen_the_covariance(sides, truth, claimed):
    """With σ given as half of it the residuals say so; with twice it nothing is made smaller on their word alone."""
    honest = register(sides[:3], truth[:3])
    found = register([replace(each, sigma=claimed * each.sigma) for each in sides[:3]], truth[:3])
    assert found.variance == pytest.approx(honest.variance / claimed**2, rel=0.15)
    ratio = np.sqrt(np.diagonal(found.covariance) / np.diagonal(honest.covariance))
    np.testing.assert_allclose(ratio, 1.0 if claimed < 1 else claimed, rtol=0.25)


def test_rounds_that_run_out_are_said(sides, truth):
    starts = [Pose.identity(), Pose(np.zeros(3), np.array([0.3, 0.2, 0.2])) @ truth[1]]
    with pytest.warns(NotSettledWarning, match=r"after 2 rounds the poses still moved, in the end by"):
        found = register(sides[:2], starts, rounds=2)
    assert not found.converged
    assert found.rounds == 2
    assert found.left_in_sigma > 0.02
    found = register(sides[:2], starts)
    assert found.converged
    assert 2 < found.rounds < 40
    assert found.left_in_sigma < 0.02


def test_matches_that_flip_for_ever_are_no_drift(truth):
    clouds = []
    for k in range(2):
        image = scanned(TURNS[k], k, SHIFTS[k])
        clouds.append(side_of_cloud(f"{k}.ply", image.where(stands_on(image, find_floor(image))).cloud()))
    found = register(clouds, truth[:2])
    assert found.converged
    assert found.left_in_sigma < 0.1


def test_features_need_no_angle(sides, truth):
    pytest.importorskip("kiss_matcher", reason="kiss-matcher (extra features) is not installed")
    for T, true in zip(coarse_register(sides), truth, strict=True):
        assert np.linalg.norm(off(T, true, sides[0].points.mean(axis=0))[3:]) < 0.02


def test_views_that_do_not_overlap_are_named(sides):
    x, y = scenes.grid()
    other = side("other.npz", scenes.seen(np.where(x**2 + y**2 < 60, 4 + np.sin(2 * x) + np.sin(3 * y), 0.0), NOISE))
    with pytest.raises(InputError, match=r"other\.npz: does not overlap with 0\.npz, 85\.npz"):
        coarse_register([*sides[:2], other], [0.0, 85.0, 170.0])
    with pytest.raises(InputError, match=r"85\.npz: does not overlap with 0\.npz"):
        register(sides[:2], (Pose.identity(), Pose(np.zeros(3), np.array([0.0, 50.0, 0.0]))))


def test_angles_of_the_other_sign_are_refused():
    """A square block fits at every quarter turn; small things on it do not."""
    x, y = scenes.grid()

    def turned(k: int):
        c, s = np.cos(np.pi / 2 * k), np.sin(np.pi / 2 * k)
        u, v = c * x + s * y, c * y - s * x
        block = np.where(np.maximum(np.abs(u), np.abs(v)) < 7, 4.0, 0.0)
        small = [0.8 * np.exp(-((u - a) ** 2 + (v - b) ** 2)) for a, b in ((4, 1), (1, -3), (-4, 3), (3, 4))]
        return side(f"{k}.npz", scenes.seen(block + np.where(block > 0, sum(small), 0), NOISE, seed=k))

    quarters = [turned(k) for k in range(2)]
    found = {}
    with warnings.catch_warnings():
        # Turned the wrong way they do not settle.
        warnings.simplefilter("ignore", NotSettledWarning)
        for angle in (90.0, -90.0):
            found[angle] = register(quarters, coarse_register(quarters, [0.0, angle]))
    # One of the two signs is the camera's.
    wrong, right = sorted(found, key=lambda angle: sum(pair.matches for pair in found[angle].pairs))
    check_turned(quarters, [0.0, right], found[right])
    with pytest.raises(InputError, match=r"turned the other way: .* give the angles the other sign"):
        check_turned(quarters, [0.0, wrong], found[wrong])


def test_what_slides_is_not_guessed():
    x, y = scenes.grid()
    r2 = x**2 + y**2
    dome = np.where(r2 < 81, np.sqrt(np.maximum(144.0 - r2, 0)) - 6, 0.0)
    balls = [side(f"{k}.npz", scenes.seen(dome, NOISE, seed=k)) for k in range(2)]
    with pytest.raises(ObservabilityError, match=r"1\.npz: slides"):
        coarse_register(balls, [0.0, 45.0])


def test_poses_as_given_are_kept_and_judged(sides, truth):
    found = as_given(sides[:3], truth[:3])
    assert found.poses == tuple(truth[:3])
    assert found.variance == pytest.approx(register(sides[:3], truth[:3]).variance, rel=0.1)
    assert len(found.pairs) == 3
    assert all(map(fits, found.pairs))
    assert np.isnan(found.sigma(1)).all()
    # A tenth of a millimetre is what the pair alone would move by; ten times its σ does not fit.
    moved = Pose(np.zeros(3), np.array([0.0, 0.0, 0.1]))
    (pair,) = as_given(sides[:2], [truth[0], moved @ truth[1]]).pairs
    assert pair.apart_mm == pytest.approx(0.1, rel=0.1)
    assert not fits(as_given(sides[:2], [truth[0], moved @ moved @ moved @ truth[1]]).pairs[0])
    far = as_given(sides[:2], [truth[0], Pose(np.zeros(3), np.array([0.0, 50.0, 0.0])) @ truth[1]])
    assert far.pairs == ()
    assert np.isnan(far.variance)


def test_what_slides_stays_as_given():
    x, y = scenes.grid()
    dome = np.where(x**2 + y**2 < 81, np.sqrt(np.maximum(144.0 - x**2 - y**2, 0)) - 6, 0.0)
    balls = [side(f"{k}.npz", scenes.seen(dome, NOISE, seed=k)) for k in range(2)]
    with pytest.raises(ObservabilityError, match="--as-given keeps it there"):
        register(balls, [Pose.identity(), Pose.identity()])
    found = as_given(balls, [Pose.identity(), Pose.identity()])
    assert found.variance == pytest.approx(1.0, abs=0.3)
    # What cannot be told is left out of how far they are apart.
    assert found.pairs[0].apart_mm < 0.02


def test_scans_of_one_place_are_tried_as_they_stand():
    """Two lasers of one rig see other parts of an object, so that the middles of their points are no start."""
    left, right = scanned(0.0, 0), scanned(0.0, 1)
    parts = [left.where(left.points[..., 0] < 2.5), right.where(right.points[..., 0] > -2.5)]
    here = [side(f"{k}.npz", part) for k, part in enumerate(parts)]
    assert np.linalg.norm(here[0].points.mean(axis=0) - here[1].points.mean(axis=0)) > 5.0
    found = coarse_register(here, [0.0, 0.0])[1]
    assert np.linalg.norm(off(found, Pose.identity(), here[0].points.mean(axis=0))[3:]) < 0.05
