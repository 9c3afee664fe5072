"""The motion of a hand: along its way the mean pose stays, and the photographs are smeared."""

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.images import Board
from jaxscan.images.saddle import fit_saddles
from jaxscan.rig import Rig
from jaxscan.simulation.hand import STILL, Hand
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.shapes import board_plate

BOARD = Board.checkerboard((4, 3), 16.0)
POSE = Pose(np.array([0.2, -0.1, 0.05]), np.array([-24.0, -16.0, 300.0]))


def held(hand: Hand, exposures: int = 1) -> list[list[Pose]]:
    return hand.held(POSE, BOARD.points(), (7,), exposures, px_per_mm=2.0)


def middles(poses: list[Pose]) -> np.ndarray:
    return np.stack([pose.apply(BOARD.points()).mean(axis=0) for pose in poses])


def test_on_a_stand_a_board_stands_still() -> None:
    assert held(STILL, 3) == [[POSE]] * 3


@pytest.mark.parametrize("seed", range(5))
def test_the_mean_pose_is_the_one_that_is_given(seed: int) -> None:
    (poses,) = Hand(1.0).held(POSE, BOARD.points(), (seed,), 1, px_per_mm=2.0)
    at = middles(poses)
    np.testing.assert_allclose(at.mean(axis=0), middles([POSE])[0], atol=1e-9)
    # It goes straight, no further than it may, in steps of less than a pixel's third.
    way = at[-1] - at[0]
    assert 0 < np.linalg.norm(way) < 1.0
    np.testing.assert_allclose(np.cross(at - at[0], way), 0, atol=1e-9)
    assert 2.0 * np.linalg.norm(np.diff(at, axis=0), axis=1).max() < 0.33
    corners = np.stack([pose.apply(BOARD.points()) for pose in poses])
    assert np.abs(corners.mean(axis=0) - POSE.apply(BOARD.points())).max() < 1e-3
    turned = poses[-1].matrix() @ poses[0].matrix().T
    assert 1e-5 < np.arccos((np.trace(turned) - 1) / 2) < 1.0 / 28


def test_exposures_follow_one_another() -> None:
    first, second, third = (middles(poses) for poses in held(Hand(1.0), 3))
    for before, after in ((first, second), (second, third)):
        # From the last moment to the end, from the start to the first: half a step each, of a speed that changes.
        gap = np.linalg.norm(after[0] - before[-1])
        assert gap <= np.abs(np.diff(before[-2:], axis=0)).sum() + np.abs(np.diff(after[:2], axis=0)).sum()
        assert np.linalg.norm(after.mean(axis=0) - before.mean(axis=0)) > 0.02


def test_a_photograph_is_the_mean_of_its_moments(rig: Rig) -> None:
    plate = board_plate(BOARD)
    exact = Sensor(blur_px=0.6, noise=0.0, bits=16)
    dim = Lighting(laser_power=100.0, speckle=0.3, ghost=0.2)
    scenes = [Scene((plate.moved(np.eye(3), np.array([-24.0 + x, -16.0, 300.0])),)) for x in (0.0, 2.0)]
    both = render(rig, scenes, laser=0, lighting=dim, sensor=exact, seed=3)
    apart = [render(rig, scene, laser=0, lighting=dim, sensor=exact, seed=3).astype(float) for scene in scenes]
    assert np.abs(both - np.mean(apart, axis=0)).max() <= 1.0
    assert np.abs(apart[0] - apart[1]).max() > 1000
    np.testing.assert_array_equal(render(rig, scenes[:1], sensor=exact), render(rig, scenes[0], sensor=exact))


def test_edges_across_the_way_are_smeared_and_corners_stay(rig: Rig) -> None:
    def corners(*ways: float) -> tuple[np.ndarray, np.ndarray]:
        plate = board_plate(BOARD)
        scenes = [Scene((plate.moved(np.eye(3), np.array([-24.0 + x, -16.0, 200.0])),)) for x in ways]
        image = render(rig, scenes, sensor=Sensor(blur_px=0.6, noise=0.0, bits=16))
        X = np.array([-24.0, -16.0, 200.0]) + BOARD.points()
        at = np.array([174.4, 172.6]) * X[:, :2] / X[:, 2:] + np.array([77.6, 57.0])
        edges = np.tile([[14.0, 0.0]], (len(at), 1)), np.tile([[0.0, 14.0]], (len(at), 1))
        found = fit_saddles(image, at, edges, np.zeros_like(at), 0.45, np.full(len(at), 12.0), 15.0)
        return found.pixels - at, np.median(found.blur, axis=0)

    still_off, still = corners(0.0)
    off, smeared = corners(*(np.arange(16) + 0.5) / 4 - 2)
    assert np.abs(off).max() < np.abs(still_off).max() + 0.01
    # The second edge runs up and down, across the way: a way of 3.5 px adds its variance of 3.5² / 12 = 1.0 px².
    assert smeared[0] == pytest.approx(still[0], rel=0.05)
    assert smeared[1] == pytest.approx(np.hypot(still[1], 1.0), rel=0.1)


@pytest.mark.parametrize("shake", [-0.1, np.nan, np.inf, 100.0])
def test_what_is_no_shake_is_refused(shake: float) -> None:
    with pytest.raises(InputError, match=r"shake_mm = .*: give 0 to 20 mm"):
        Hand(shake)
