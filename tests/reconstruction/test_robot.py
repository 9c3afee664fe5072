"""A scanner that a robot moves, from photographs to points: what is found of it, how well, and what is refused."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan import InputError, read_range_image, read_rig, read_scan, reconstruct, write_points
from jaxscan.cli.main import main
from jaxscan.files.pose_table import read_pose_table, write_pose_table
from jaxscan.files.session import read_session, write_session
from jaxscan.geometry import Pose
from jaxscan.images import read_image
from jaxscan.reconstruction import RangeImage
from jaxscan.rig import CARRIED_BY, HeadPoses, given_poses, positions_of
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import ScanTruth, write_truth
from jaxscan.simulation.robot import Robot, simulate_robot_scan, simulate_robot_session, with_robot
from jaxscan.simulation.shapes import cup

FRAMES = 7


def make(folder: Path, moves: str) -> ScanTruth:
    """A session of four boards by hand and eight at given poses, calibrated; a scan of a cup."""
    plain = rig_2003.simulated_rig(1)
    robot = Robot(moves)
    rig = with_robot(plain, robot, 1)
    session = simulate_robot_session(folder / "session", 1, rig, robot, views=4, posed=8)
    scene = rig_2003.scan_scene(plain, cup(rig_2003.OBJECT_Y))
    travel = rig_2003.stage_travel(plain, np.linspace(0, 60_000, FRAMES))
    middle = rig_2003.middle_of_object(plain)
    scan = simulate_robot_scan(folder / "scan", rig, robot, scene, travel, middle, 1)
    write_truth(folder / "truth", session, scan)
    assert main(["calibrate", str(folder / "session"), "-o", str(folder / "rig.json")]) == 0
    return scan


@pytest.fixture(scope="module", params=CARRIED_BY)
def world(request, tmp_path_factory) -> tuple[Path, ScanTruth]:
    folder = tmp_path_factory.mktemp(request.param)
    return folder, make(folder, request.param)


def along_rays(image: RangeImage, truth: ScanTruth) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the points along their rays, mm, and their σ; without strays."""
    rays = image.points - image.cameras()[:, None]
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    errors = ((image.points - truth.points) * rays).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        near = image.valid & (np.abs(errors) < 1)
    return errors[near], image.sigma[near]


def test_camera_and_hand_are_as_they_were_drawn(world):
    folder, _ = world
    found, true = read_rig(folder / "rig.json"), read_rig(folder / "truth" / "rig.json")
    assert type(found.rig.motion) is type(true.rig.motion)
    assert found.covariance is not None
    names = [f"motion.poses.{part}.{i}" for part in ("rotation", "offset") for i in range(3)]
    at = [found.covariance.names.index(name) for name in names]
    off = np.array([*found.rig.motion.rotation, *found.rig.motion.offset]) - np.array(
        [*true.rig.motion.rotation, *true.rig.motion.offset]
    )
    assert off @ np.linalg.solve(found.covariance.matrix[np.ix_(at, at)], off) < 22
    assert np.abs(off[3:]).max() < 0.6
    assert found.fit["pose_images"] == 8
    assert found.fit["pose_sigma_mm"] == pytest.approx(0.05, rel=0.5)
    assert found.fit["pose_sigma_deg"] == pytest.approx(0.02, rel=0.5)


def test_points_lie_where_they_were_drawn_within_their_sigma(world):
    folder, truth = world
    scan = read_scan(folder / "scan")
    image = reconstruct(read_rig(folder / "rig.json"), scan)
    errors, sigma = along_rays(image, truth)
    assert len(errors) > 0.97 * image.valid.sum() > 1000
    assert np.sqrt(np.mean(errors**2)) < 0.25
    within = [np.mean(np.abs(errors) < k * sigma) for k in (1, 2)]
    # Seven frames have seven errors of the robot, and one of the rig.
    assert 0.35 < within[0] < 0.95
    assert within[1] > 0.8
    # The robot's part is in no pixel's.
    assert np.median(sigma) > 1.3 * np.median(image.sigma_pixel[image.valid])
    write_points(folder / "scan.npz", image)
    again = read_range_image(folder / "scan.npz")
    assert again.motion == image.motion
    assert {axis: n.tolist() for axis, n in again.positions.items()} == {
        axis: n.tolist() for axis, n in image.positions.items()
    }
    np.testing.assert_allclose(again.cameras(), image.cameras())


def test_photographs_in_memory_with_their_poses(world):
    folder, _ = world
    rig, scan = read_rig(folder / "rig.json"), read_scan(folder / "scan")
    whole = reconstruct(rig, scan)
    frames = [(read_image(path), {axis: n[i] for axis, n in scan.axes.items()}) for i, path in enumerate(scan.frames)]
    np.testing.assert_array_equal(reconstruct(rig, frames).points, whole.points)


def test_the_gravest_mistakes_are_refused(world, tmp_path: Path):
    folder, _ = world
    rig, scan = read_rig(folder / "rig.json"), read_scan(folder / "scan")
    steps = replace(scan, axes={"stage": tuple(range(0, 1000 * FRAMES, 1000))}, poses=None)
    with pytest.raises(InputError, match=r"moved by given poses, and the scan has none.*give poses = "):
        reconstruct(rig, steps)
    with pytest.raises(InputError, match="spacetime analysis follows an axis"):
        reconstruct(rig, scan, spacetime=True)
    plain = replace(rig, rig=rig_2003.simulated_rig(1))
    with pytest.raises(InputError, match=r"the poses moves between frames.*calibrate with a \[poses\]"):
        reconstruct(plain, scan)
    open_ended = replace(rig, fit={**rig.fit, "pose_offset_unknown": np.eye(3).tolist()})
    with pytest.raises(InputError, match=r"the hand turns by .*scan without such turns"):
        reconstruct(open_ended, scan)
    metres = {axis: tuple(1000 * n for n in steps) if axis[-1] in "xyz" else steps for axis, steps in scan.axes.items()}
    with pytest.raises(InputError, match="from its base: give positions in millimetres"):
        reconstruct(rig, replace(scan, axes=metres))
    del tmp_path


MISREAD = {
    "with the quaternion as qx, qy, qz, qw": lambda given: Pose(
        Rotation.from_quat(np.roll(Rotation.from_rotvec(given.rotation).as_quat(), -1, axis=1)).as_rotvec(),
        given.translation,
    ),
    "in metres: write positions in millimetres": lambda given: Pose(given.rotation, given.translation / 1000),
    "the other way round": lambda given: given.inverse(),
}


@pytest.mark.parametrize("said", MISREAD)
def test_a_table_of_a_scan_that_is_read_in_another_way(world, said: str):
    folder, _ = world
    rig, scan = read_rig(folder / "rig.json"), read_scan(folder / "scan")
    if said == "the other way round" and isinstance(rig.rig.motion, HeadPoses):
        pytest.skip("a hand that is turned by half a turn is near its own inverse")
    given = given_poses({axis: np.asarray(steps, float) for axis, steps in scan.axes.items()})
    wrong = {axis: tuple(steps.tolist()) for axis, steps in positions_of(MISREAD[said](given)).items()}
    with pytest.raises(InputError, match=f"do not fit those of the calibration, but they do {said}"):
        reconstruct(rig, replace(scan, axes=wrong))
    # A rig file of before says nothing of where its poses were.
    fit = {key: value for key, value in rig.fit.items() if key != "pose_range"}
    reconstruct(replace(rig, fit=fit), replace(scan, axes=wrong))


def test_squares_that_are_not_as_large_as_was_said(world, tmp_path: Path, capsys):
    folder, _ = world
    text = (folder / "session" / "session.toml").read_text()
    (tmp_path / "session.toml").write_text(text.replace("square_mm = 16.0", "square_mm = 16.4"))
    for part in (folder / "session").iterdir():
        if part.name != "session.toml":
            (tmp_path / part.name).symlink_to(part)
    assert main(["calibrate", "--json", str(tmp_path), "-o", str(tmp_path / "rig.json")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"]["level"] == "stop"
    (said,) = [warning["statement"] for warning in found["warnings"] if "as far apart" in warning["statement"]]
    assert re.search(r"The given positions are 0.97\d+ ± 0.00\d+ times as far apart as the photographs", said)


def test_a_pose_of_another_moment_is_left_out_and_said(world, tmp_path: Path, capsys):
    folder, _ = world
    session = read_session(folder / "session")
    assert session.poses is not None
    names = [path.name for path in session.poses.images]
    wrong = Pose(session.poses.poses.rotation, session.poses.poses.translation.copy())
    wrong.translation[3, 1] += 15.0
    write_pose_table(tmp_path / "poses.csv", names, wrong)
    path = tmp_path / "session.toml"
    write_session(replace(session, path=path, poses=replace(session.poses, file=tmp_path / "poses.csv")))
    assert main(["calibrate", "--json", str(path), "-o", str(tmp_path / "rig.json")]) == 0
    out = capsys.readouterr().out
    assert json.loads(out)["verdict"]["level"] == "care"
    assert re.findall(r"poses/03.png: its given pose is (1[45][.\d]*) mm", out), out
    assert read_rig(tmp_path / "rig.json").fit["pose_sigma_mm"] < 0.1


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_what_the_simulator_writes_is_what_it_drew(tmp_path: Path, moves: str):
    plain = rig_2003.simulated_rig(2)
    robot = Robot(moves, 0.0, 0.0)
    rig = with_robot(plain, robot, 2)
    truth = simulate_robot_session(tmp_path, 2, rig, robot, views=0, posed=3)
    session = read_session(tmp_path)
    assert session.poses is not None
    read = read_pose_table(session.poses.file, session.poses.images)
    assert truth.hand is not None
    np.testing.assert_allclose(read.translation, truth.hand.translation, atol=1e-6)
    # The board is where it was mounted, after any of the poses.
    mounted = [
        (rig.motion.carry(Pose(r, t)).inverse() @ rig.motion.to_camera().inverse() @ Pose(*board)).translation
        for r, t, board in zip(
            read.rotation,
            read.translation,
            zip(truth.boards.rotation, truth.boards.translation, strict=True),
            strict=True,
        )
    ]
    np.testing.assert_allclose(mounted, np.broadcast_to(mounted[0], (3, 3)), atol=1e-4)
