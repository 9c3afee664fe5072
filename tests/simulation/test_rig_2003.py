"""The simulated rig of 2003 against its definition, and photographs of it through OpenCV's eyes."""

import cv2
import numpy as np
import pytest

from jaxscan.rig import Rig
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.render import render
from jaxscan.simulation.rig_2003 import (
    BOARD,
    BOARD_LIGHTING,
    OBJECT_Y,
    SCAN_LIGHTING,
    SENSOR,
    board_poses,
    board_scene,
    mirrored_lamp,
    platform,
    scan_scene,
    simulated_rig,
    stage_pose,
    step_over_axis,
    turning_axes,
    with_turntable,
)
from jaxscan.simulation.shapes import cup, panda

SEED = 1
K = np.array([[697.70833, 0, 310.29604], [0, 690.43328, 228.14934], [0, 0, 1]])
DISTORTION = np.array([-0.13396, 0, 0, 0])


@pytest.fixture(scope="module")
def rig() -> Rig:
    return simulated_rig(SEED)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))


def response(image: np.ndarray) -> np.ndarray:
    """The pipeline's of 2003: (R − G) + (R − B)."""
    red, green, blue = np.moveaxis(image.astype(int), -1, 0)
    return 2 * red - green - blue


def test_rig_is_the_one_of_the_definition() -> None:
    planes, travels = [], []
    for seed in range(20):
        rig = simulated_rig(seed)
        assert [float(x) for x in rig.camera.focal] == [697.70833, 690.43328]
        assert [float(x) for x in rig.camera.lens.radial] == [-0.13396]
        planes.append(np.array([float(x) for x in rig.lights[0].plane]))
        travels.append(np.array([float(x) for x in rig.axis("stage").per_step]))
    for omega, travel in zip(planes, travels, strict=True):
        assert angle_deg(omega, np.array([0, -0.00494, 0.00303])) == pytest.approx(2)
        assert np.linalg.norm(omega) == pytest.approx(np.hypot(0.00494, 0.00303))
        assert angle_deg(travel, np.array([0.03, 0.92, -0.39])) == pytest.approx(2)
        assert np.linalg.norm(travel) == pytest.approx(0.001)
    assert len({tuple(omega) for omega in planes}) == 20


def test_poses_are_those_of_the_definition() -> None:
    for seed in range(6):
        rig = simulated_rig(seed)
        poses = board_poses(rig, seed)
        rotations, translations = np.asarray(poses.rotation), np.asarray(poses.translation)
        assert rotations.shape == (11, 3)
        assert np.abs(rotations[:, :2]).max() <= 0.6
        centres = [
            cv2.Rodrigues(r)[0] @ BOARD.points().mean(0) + t for r, t in zip(rotations, translations, strict=True)
        ]
        assert min(c[2] for c in centres) >= 310
        assert max(c[2] for c in centres) <= 380
        for r, t in zip(rotations, translations, strict=True):
            corners = cv2.projectPoints(BOARD.points(), r, t, K, DISTORTION)[0].reshape(-1, 2)
            assert corners.min() > 5
            assert (corners < [635, 475]).all()
        stage = stage_pose(rig, seed)
        for steps in (0, 60000):
            moved = np.asarray(stage.translation) + steps * np.array([float(x) for x in rig.axis("stage").per_step])
            corners = cv2.projectPoints(BOARD.points(), np.asarray(stage.rotation), moved, K, DISTORTION)[0]
            assert corners.min() > 5
            assert (corners.reshape(-1, 2) < [635, 475]).all()


def test_thresholds_of_2003_are_reached_on_boards(rig: Rig) -> None:
    poses = board_poses(rig, SEED)
    seen = reached = 0
    for i in range(0, 11, 2):
        scene = board_scene(np.asarray(poses.rotation[i]), np.asarray(poses.translation[i]))
        image = render(rig, scene, laser=0, lighting=BOARD_LIGHTING, sensor=SENSOR, seed=i)
        ideal = np.isfinite(true_profile(rig, scene).position)
        assert ideal.sum() > 200
        seen += ideal.sum()
        reached += (ideal & (response(image) >= 300).any(0)).sum()
    assert reached / seen >= 0.98


def test_corners_where_they_are(rig: Rig) -> None:
    pose = stage_pose(rig, SEED)
    scene = board_scene(np.asarray(pose.rotation), np.asarray(pose.translation))
    image = render(rig, scene, lighting=BOARD_LIGHTING, sensor=SENSOR)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    assert 75 < np.percentile(grey[grey > 15], 90) < 110
    found, corners = cv2.findChessboardCorners(grey, (9, 6))
    assert found
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    corners = cv2.cornerSubPix(grey, corners, (7, 7), (-1, -1), criteria).reshape(-1, 2)
    true = cv2.projectPoints(BOARD.points(), np.asarray(pose.rotation), np.asarray(pose.translation), K, DISTORTION)[0]
    true = true.reshape(-1, 2)
    # OpenCV may count from the other end.
    error = min((corners - order for order in (true, true[::-1])), key=lambda e: np.abs(e).max())
    assert np.abs(error).max() < 0.2
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert np.abs(error.mean(0)).max() < 0.02


def test_thresholds_of_2003_are_reached_on_a_cup(rig: Rig) -> None:
    scene = scan_scene(rig, cup(OBJECT_Y))
    seen = reached = 0
    cup_points = 0
    up, origin = platform(rig)
    for frame in (1, 9, 18, 27, 35):
        steps = 2000 * frame
        image = render(rig, scene, q={"stage": steps}, laser=0, lighting=SCAN_LIGHTING, sensor=SENSOR, seed=frame)
        profile = true_profile(rig, scene, {"stage": steps}, lighting=SCAN_LIGHTING)
        ideal = np.isfinite(profile.position)
        seen += ideal.sum()
        reached += (ideal & (response(image) >= 200).any(0)).sum()
        depth = profile.points[ideal, 2] + steps * float(rig.axis("stage").per_step[2])
        assert np.min(depth) > 260
        assert np.max(depth) < 400
        height = (profile.points[ideal] - origin) @ up[:, 2]
        cup_points += (height > 1).sum()
        # The stripe in the photograph is where the profile says it is.
        rows = np.arange(480)[:, None]
        weight = np.where(np.abs(rows - profile.position) < 6, np.maximum(response(image) - 60, 0), 0)
        bright = ideal & (weight.sum(0) > 500)
        centre = (weight * rows).sum(0)[bright] / weight.sum(0)[bright]
        assert np.median(np.abs(centre - profile.position[bright])) < 0.1
    assert reached / seen >= 0.98
    assert cup_points > 200


def test_a_lamp_that_the_platform_mirrors_where_the_sheet_meets_it() -> None:
    rig = simulated_rig(3)
    R, origin = platform(rig)
    halfway = np.asarray(mirrored_lamp(rig)) - origin / np.linalg.norm(origin)
    np.testing.assert_allclose(halfway / np.linalg.norm(halfway), R[:, 2], atol=1e-12)


def test_a_turn_shows_the_object_up_to_the_axis_of_the_turntable():
    rig = with_turntable(simulated_rig(0), 0)
    R, origin = platform(rig)
    scene = scan_scene(rig, panda(OBJECT_Y))
    axes = turning_axes(800, step_over_axis(rig))
    assert set(axes["stage"]) != set(turning_axes(800)["stage"])
    axis, centre = np.asarray(rig.axis("turntable").direction()), np.asarray(rig.axis("turntable").centre)
    nearest = []
    for stage, turn in zip(*axes.values(), strict=True):
        _, points = true_profile(rig, scene, {"stage": stage, "turntable": turn}, lighting=SCAN_LIGHTING)
        seen = points[np.isfinite(points).all(axis=1) & ((points - origin) @ R[:, 2] > 20)]
        nearest.append(np.linalg.norm(np.cross(seen - centre, axis), axis=1).min())
    assert max(nearest) < 0.6
