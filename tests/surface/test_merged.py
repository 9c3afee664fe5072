"""Sides as one surface: the right place on curved surfaces, each point by its own σ, nothing beyond the rim."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.surface.mean_sigma import mean_sigma
from jaxscan.surface.merged import merge, merge_closed
from jaxscan.surface.side import Side
from tests.surface.hills import RADIUS, height, pose, scanned, side

R = 10.0
STILL = Pose.identity()


def ball(name: str, pole: np.ndarray, sigma: float, seed: int, part: float = -1.0) -> Side:
    """Points of a ball of radius 10, as far as their direction has this cosine with its pole, and more."""
    rng = np.random.default_rng(seed)
    i = np.arange(3000) + rng.uniform()
    up, turn = 1 - 2 * i / 3001, np.pi * (1 + 5**0.5) * i
    n = np.stack([np.sqrt(1 - up**2) * np.cos(turn), np.sqrt(1 - up**2) * np.sin(turn), up], axis=1)
    n = n[n @ pole > part]
    points = (R + sigma * rng.normal(size=(len(n), 1))) * n
    return Side(name, points, n, np.full(len(n), sigma), np.zeros(len(n), bool), 0.8)


@pytest.fixture(scope="module")
def halves():
    z = np.array([0.0, 0.0, 1.0])
    return [ball("a", z, 1e-6, 0, -0.3), ball("b", -z, 1e-6, 1, -0.3)]


@pytest.mark.parametrize("size", [1e-6, 1e-9])
def test_cubes_beyond_counting_are_refused(halves, size):
    """There are more cubes of 1e-6 mm than whole numbers can count."""
    with pytest.raises(InputError, match=r"are too many.*give larger ones"):
        merge(halves, (STILL, STILL), cube_mm=size)


def test_a_curved_surface_is_not_flattened(halves):
    """With each point's own normal alone vertices would be off by h² / 2r = 0.008 mm."""
    found = merge(halves, (STILL, STILL))
    assert found.mesh.is_watertight
    assert found.mesh.volume > 0
    radius = np.linalg.norm(found.mesh.vertices, axis=1)
    assert np.sqrt(np.mean((radius - R) ** 2)) < 5e-4
    assert np.abs(radius - R).max() < 4e-3
    assert set(found.sides) <= {1, 2}
    assert (found.sides == 2).sum() == pytest.approx(0.3 * len(radius), rel=0.5)


def test_each_point_weighs_by_its_sigma():
    z = np.array([0.0, 0.0, 1.0])
    good, bad = ball("good", z, 0.01, 2), ball("bad", z, 0.1, 3)
    alone, both, worse = (merge(s, (STILL,) * len(s), cube_mm=1.5) for s in ([good], [good, bad], [bad]))
    error = [np.std(np.linalg.norm(m.mesh.vertices, axis=1)) for m in (alone, both, worse)]
    assert error[1] < 1.05 * error[0]
    assert error[1] < 0.2 * error[2]
    assert np.median(both.sigma_pixel) == pytest.approx(error[1], rel=0.3)
    assert np.isnan(both.sigma).all()


def shared_error(points: np.ndarray, seed: int) -> np.ndarray:
    """Of a variance of 1, and alike within a millimetre or two."""
    rng = np.random.default_rng(seed)
    waves, phases = rng.normal(0, 1.0, (60, 3)), rng.uniform(0, 2 * np.pi, 60)
    return np.sqrt(2 / 60) * np.cos(points @ waves.T + phases).sum(axis=1)


@pytest.mark.parametrize("count", [2, 4])
def test_sides_that_err_by_themselves_are_as_far_apart_as_their_sigma_says(count):
    sides = [ball(str(k), np.array([0.0, 0.0, 1.0]), 0.03, 10 + k) for k in range(count)]
    found = merge(sides, (STILL,) * count)
    assert found.disagreement == pytest.approx(1.0, abs=0.08)
    error = np.linalg.norm(found.mesh.vertices, axis=1) - R
    assert np.sqrt(np.mean((error / found.sigma_pixel) ** 2)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("count", [2, 4])
def test_errors_that_neighbours_share_widen_sigma(count):
    """A mean of neighbours does not reduce them. Only the other sides show that."""
    sides = []
    for k in range(count):
        one = ball(str(k), np.array([0.0, 0.0, 1.0]), 0.03, 20 + k)
        off = 0.03 * shared_error(one.points, 30 + k)
        sides.append(replace(one, points=one.points + off[:, None] * one.normals, sigma=one.sigma * np.sqrt(2)))
    found = merge(sides, (STILL,) * count)
    assert found.disagreement is not None
    assert found.disagreement > 1.2
    z = (np.linalg.norm(found.mesh.vertices, axis=1) - R) / found.sigma_pixel
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.15)
    # Of one side nothing is known but what its points say.
    alone = merge(sides[:1], (STILL,))
    assert alone.disagreement is None
    assert np.std(np.linalg.norm(alone.mesh.vertices, axis=1)) > 1.2 * np.median(alone.sigma_pixel)


def test_a_patch_where_sides_disagree_is_widened_by_itself():
    pole = np.array([0.0, 0.0, 1.0])
    sides = [ball(str(k), pole, 0.02, 40 + k) for k in range(2)]
    up = [(side.points @ pole / R > 0.85)[:, None] for side in sides]
    sides = [
        replace(side, points=side.points + sign * 0.05 * side.normals * where)
        for side, sign, where in zip(sides, (1, -1), up, strict=True)
    ]
    found = merge(sides, (STILL, STILL))
    top = found.mesh.vertices @ pole / R
    assert np.median(found.sigma_pixel[top > 0.9]) > 2.0 * np.median(found.sigma_pixel[top < 0.5])


def test_two_layers_that_err_in_opposite_directions_are_one_surface():
    """As beside the edge of a dark patch: 0.25 mm up in one side, 0.25 mm down in the other, where σ is 0.2 mm."""
    x, y = np.meshgrid(0.5 * np.arange(-30, 31), 0.5 * np.arange(-30, 31))
    sides = []
    for sign in (1.0, -1.0):
        off = 0.25 * sign * np.exp(-((np.hypot(x, y) - 6.0) ** 2))
        points = np.stack([x, y, off], axis=-1).reshape(-1, 3)
        # Each side's own normals: its layer rises by as much as 0.2 on each side of the edge.
        slope = np.stack(np.gradient(off, 0.5)[::-1], axis=-1).reshape(-1, 2)
        normals = np.concatenate([-slope, np.ones((len(points), 1))], axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sigma = 0.02 + 0.2 * np.abs(off).ravel() / 0.25
        sides.append(Side("side", points, normals, sigma, np.zeros(len(points), bool), 0.5))
    mesh = merge(sides, (STILL, STILL)).mesh
    assert np.degrees(mesh.face_adjacency_angles).max() < 30
    assert (mesh.face_normals[:, 2] > 0.8).all()
    assert np.abs(mesh.vertices[:, 2]).max() < 0.1
    assert mesh.area == pytest.approx(30.0**2, rel=0.03)


def test_what_one_rig_is_wrong_by_stays_in_the_mean_and_the_noise_becomes_less():
    pixel, rig = np.array([[0.03, 0.03, 0.03, np.nan]]), np.array([[0.04, 0.05, 0.06, np.nan]])
    both, own = mean_sigma(np.array([[1, 1, 1, 0]]) / 3, pixel, rig)
    assert own == pytest.approx(0.03 / np.sqrt(3))
    assert both == pytest.approx(np.sqrt(own**2 + np.mean(rig[0, :3] ** 2)))
    assert np.isnan(mean_sigma(np.full((1, 4), 0.25), np.full((1, 4), 0.03), rig)[0]).all()


def test_nothing_is_made_where_nothing_was_seen():
    cap = ball("cap", np.array([0.0, 0.0, 1.0]), 1e-6, 4, 0.5)
    mesh = merge([cap, cap], (STILL, STILL)).mesh
    assert not mesh.is_watertight
    assert mesh.vertices[:, 2].min() > 0.5 * R
    assert 0.75 < mesh.area / (np.pi * R**2) < 1.0


@pytest.fixture(scope="module")
def hills():
    return [side("0", scanned(0.0, 0)), side("1", scanned(90.0, 1))], (STILL, pose(90.0))


def test_hills_of_two_sides(hills):
    found = merge(*hills)
    x, y, z = found.mesh.vertices.T
    up = 300.0 - z - height(x, -(y + 12.0))
    inner = np.hypot(x, y + 12.0) < RADIUS - 0.7
    assert np.sqrt((up[inner] ** 2).mean()) < 0.01
    # Upwards, toward the camera: −z.
    assert (found.mesh.face_normals[:, 2] < 0).mean() > 0.99


def test_closed_with_the_floor_under_it(hills):
    pytest.importorskip("pymeshlab", reason="PyMeshLab (extra poisson) is not installed")
    found = merge_closed(*hills)
    assert found.mesh.is_watertight
    x, y = np.meshgrid(np.linspace(-10, 10, 801), np.linspace(-10, 10, 801))
    # Its wall was not seen, and bulges.
    assert 1.0 < found.mesh.volume / (height(x, y).sum() * 0.025**2) < 1.25
    assert np.isnan(found.sigma[found.sides == 0]).all()


def test_cubes_of_no_size(halves):
    with pytest.raises(InputError, match="more than 0"):
        merge(halves, (STILL, STILL), cube_mm=0.0)
