"""Grids of circles: the images of discs by their outlines, projected by OpenCV, which are exact polygons' moments."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import Observations, View, calibrate
from jaxscan.calibration.blocks import view_blocks
from jaxscan.images import Board
from jaxscan.precision import float64
from jaxscan.rig import Camera, Rig, System

SIZE, FOCAL, PRINCIPAL, K1 = (640, 480), 600.0, (315.0, 244.0), -0.2
BOARD = Board.circles((7, 6), 12.0)
RADIUS = 4.0
_K = np.array([[FOCAL, 0, PRINCIPAL[0]], [0, FOCAL, PRINCIPAL[1]], [0, 0, 1]])
_TURNS = np.linspace(0, 2 * np.pi, 720, endpoint=False)
_OUTLINE = RADIUS * np.stack([np.cos(_TURNS), np.sin(_TURNS), 0 * _TURNS], axis=-1)


def centres_of_gravity(pose):
    """The centres of gravity of the images of all circles, px."""
    outlines = BOARD.points()[:, None] + _OUTLINE
    pixels = cv2.projectPoints(outlines.reshape(-1, 3), pose[:3], pose[3:], _K, np.array([K1, 0, 0, 0]))[0]
    at = pixels.reshape(*outlines.shape[:2], 2)
    middle = at.mean(axis=1)
    x, y = np.moveaxis(at - middle[:, None], -1, 0)
    cross = x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y
    moments = [((c + np.roll(c, -1, 1)) * cross).sum(1) / (3 * cross.sum(1)) for c in (x, y)]
    return middle + np.stack(moments, axis=-1)


def observed(poses, noise=0.0, seed=0, radius=RADIUS):
    random = np.random.default_rng(seed)
    seen = [centres_of_gravity(pose) for pose in poses]
    views = [View(f"{i}", each + noise * random.standard_normal(each.shape)) for i, each in enumerate(seen)]
    return Observations(SIZE, BOARD, tuple(views), radius_mm=radius)


def poses(count, seed=0):
    random = np.random.default_rng([seed, 3])
    middle = BOARD.points().mean(axis=0)
    for _ in range(count):
        turn = np.array([*random.uniform(-0.7, 0.7, 2), random.uniform(-0.2, 0.2)])
        place = np.array([*random.uniform(-15, 15, 2), random.uniform(150, 200)])
        yield np.concatenate([turn, place - cv2.Rodrigues(turn)[0] @ middle])


@pytest.mark.parametrize(("radius", "low", "high"), [(RADIUS, 0.0, 0.002), (0.0, 0.1, 1.0)])
def test_a_circle_is_predicted_where_its_image_has_its_centre_of_gravity(radius, low, high):
    all_poses = list(poses(4))
    with float64():
        blocks = view_blocks(observed(all_poses, radius=radius))
        rig = Rig(Camera.create(SIZE, (FOCAL, FOCAL), PRINCIPAL, "radial1", (K1,)))
        errors = []
        for i, pose in enumerate(all_poses):
            block = jax.tree.map(lambda leaf, i=i: leaf[i : i + 1], blocks)
            errors.append(np.asarray(block.errors(System(rig, ()), jnp.asarray(pose)[None])[0]))
    assert low <= np.abs(errors).max() < high


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_focal_length_is_that_of_circles_and_not_of_their_centres(seed):
    calibration = calibrate(observed(poses(10, seed), noise=0.01, seed=seed))
    camera, sigma = calibration.rig.camera, calibration.covariance.sigma
    for i in range(2):
        assert abs(float(camera.focal[i]) - FOCAL) < 2.5 * sigma(f"camera.focal.{i}")
    assert abs(float(camera.lens.radial[0]) - K1) < 2.5 * sigma("camera.radial.0")
