"""Motions by given poses: what they carry where, and as positions and files have them."""

from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import CARRIED_BY, Covariance, HeadPoses, ObjectPoses, PoseRange, Rig, given_poses, positions_of
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.summary import axis_summary
from jaxscan.simulation import rig_2003

K = Pose(np.array([0.3, -0.2, 1.4]), np.array([10.0, 70.0, -90.0]))


def poses(count: int = 4, seed: int = 0) -> Pose[np.ndarray]:
    random = np.random.default_rng(seed)
    return Pose(random.normal(0, 1, (count, 3)), random.normal(0, 400, (count, 3)))


def motion(kind: type[HeadPoses] | type[ObjectPoses]) -> HeadPoses | ObjectPoses:
    with float64():
        return as_numpy(kind.create(K.rotation, K.matrix().T @ K.translation))


def test_positions_are_whole_numbers_and_lose_nothing():
    given = poses(50)
    q = positions_of(given)
    assert {n.dtype for n in q.values()} == {np.dtype(np.int64)}
    back = given_poses({axis: n.astype(float) for axis, n in q.items()})
    np.testing.assert_allclose(back.translation, given.translation, atol=5e-7)
    np.testing.assert_allclose(back.rotation, given.rotation, atol=5e-10)


def test_equal_poses_after_each_other_are_one_position():
    given = poses(3)
    some = [0, 0, 1, 2, 2, 0]
    q = positions_of(Pose(given.rotation[some], given.translation[some]))
    assert q["poses"].tolist() == [0, 0, 1, 2, 2, 3]


def test_a_head_sees_the_base_and_an_object_is_on_the_hand():
    given = poses()
    q = {axis: n.astype(float) for axis, n in positions_of(given).items()}
    x = np.array([[3.0, -5.0, 8.0]])
    head = motion(HeadPoses).pose(q).apply(x)
    np.testing.assert_allclose(head[:, 0], K.apply(given.inverse().apply(x)[:, 0]), atol=1e-5)
    carried = motion(ObjectPoses).pose(q).apply(x)
    np.testing.assert_allclose(carried[:, 0], K.apply(given.apply(x)[:, 0]), atol=1e-5)


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_it_goes_through_a_file(tmp_path: Path, moves: str):
    plain = rig_2003.simulated_rig(0)
    rig = Rig(plain.camera, plain.lights, motion(CARRIED_BY[moves]))
    fit = {"pose_sigma_mm": 0.1, "pose_sigma_deg": 0.02, "pose_offset_unknown": [[0.0, 0.0, 1.0]]}
    write_rig(tmp_path / "rig.json", RigFile(rig, None, fit))
    read = read_rig(tmp_path / "rig.json")
    assert read.rig.motion == rig.motion
    assert read.fit == fit


def summary_of(moves: str, offset: np.ndarray, root: np.ndarray) -> tuple[Rig, Covariance, dict]:
    """A rig whose hand is at an offset, its covariance root rootᵀ of turn (rad) and offset (mm), and its summary."""
    plain = rig_2003.simulated_rig(0)
    with float64():
        rig = Rig(plain.camera, plain.lights, as_numpy(CARRIED_BY[moves].create(K.rotation, offset)))
    names = tuple(parameter_names(rig))
    matrix = np.zeros((len(names), len(names)))
    matrix[-6:, -6:] = root @ root.T
    covariance = Covariance(names, matrix)
    (axis,) = axis_summary(rig, covariance)
    return rig, covariance, axis


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_sigma_of_where_the_hand_is(moves: str):
    """A base that is far away is known as its turn is."""
    root = np.diag([1e-4] * 3 + [0.1] * 3)
    offset = np.array([3000.0, -2000.0, 500.0])
    axis = summary_of(moves, offset, root)[2]
    assert axis["hand_open_along"] == []
    random = np.random.default_rng(0)
    drawn = root @ random.standard_normal((6, 4000))
    places = Rotation.from_rotvec(K.rotation + drawn[:3].T).apply(offset + drawn[3:].T)
    np.testing.assert_allclose(axis["hand_sigma_mm"], np.std(places, axis=0), rtol=0.06)


def test_a_direction_along_which_the_place_is_not_found():
    way = np.array([0.6, 0.0, 0.8])
    root = np.diag([1e-4] * 3 + [0.1] * 3)
    root[3:, 3:] -= 0.1 * np.outer(way, way)
    ((x, y, z),) = summary_of("head", np.array([10.0, 20.0, 30.0]), root)[2]["hand_open_along"]
    assert abs(np.dot([x, y, z], way)) > 0.999999


def test_poses_that_are_near_others():
    random = np.random.default_rng(1)
    usual = Pose(random.normal([2.0, 0.0, 0.0], 0.2, (12, 3)), random.uniform(250, 450, (12, 3)))
    where = PoseRange.from_values(PoseRange.of(usual).values())
    moved = usual.translation[:4] + np.array([150.0, 0.0, 0.0])
    assert where.is_near(Pose(usual.rotation[:4], moved))
    assert not where.is_near(Pose(usual.rotation[:4], moved + np.array([300.0, 0.0, 0.0])))
    assert not where.is_near(Pose(usual.rotation[:4], usual.translation[:4] / 1000))
    assert not where.is_near(Pose(usual.rotation[:4] - [2.0, 0.0, 0.0], usual.translation[:4]))
    assert where.is_still(Pose(usual.rotation, usual.translation / 1000))
    assert not where.is_still(usual)


def test_one_photograph_with_a_rolled_camera_does_not_let_any_rotation_pass():
    random = np.random.default_rng(2)
    turns = random.normal([0.0, 0.0, 0.0], 0.2, (12, 3))
    turns[5] = [0.0, 0.0, 3.1]
    usual = Pose(turns, random.uniform(250, 450, (12, 3)))
    values = PoseRange.of(usual).values()
    where, old = (PoseRange.from_values(each) for each in (values, {k: v for k, v in values.items() if k != "turns"}))
    other = Pose(turns[:4] + np.array([1.5, 0.0, 0.0]), usual.translation[:4])
    assert old.is_near(other)
    assert not where.is_near(other)
    assert where.is_near(Pose(turns[4:7] + np.array([0.3, 0.0, 0.0]), usual.translation[:3]))
    assert where.is_usual(Pose(turns[4:7], usual.translation[:3]))


def test_a_motion_of_no_turn_is_one(tmp_path: Path):
    plain = rig_2003.simulated_rig(0)
    with float64():
        rig = Rig(plain.camera, plain.lights, as_numpy(HeadPoses.at_rest("poses")))
    write_rig(tmp_path / "rig.json", RigFile(rig))
    assert read_rig(tmp_path / "rig.json").rig.motion == rig.motion


def test_points_do_not_move_where_the_head_does():
    plain = rig_2003.simulated_rig(0)
    rig = Rig(plain.camera, plain.lights, motion(HeadPoses))
    given = poses(1)
    q = {axis: int(n[0]) for axis, n in positions_of(given).items()}
    with jax.enable_x64(True):
        point = np.asarray(rig.triangulate((320.0, 200.0), q))
        still = np.asarray(Rig(plain.camera, plain.lights).triangulate((320.0, 200.0), {}))
    expected = given.apply(K.inverse().apply(still[None])[None])[0, 0]
    np.testing.assert_allclose(point, expected, atol=1e-5)
