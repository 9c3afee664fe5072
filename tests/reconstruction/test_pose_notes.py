"""What the given poses of a scan show by themselves."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.geometry import Pose
from jaxscan.images import StripeSettings
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction.pose_notes import check_poses, pose_notes, stand_out
from jaxscan.rig import HeadPoses, ObjectPoses, PoseRange, Rig, positions_of
from jaxscan.simulation import rig_2003

COUNT = 40


def path(step_mm: float = 1.5, bend: float = 0.0, noise_mm: float = 0.03, noise_deg: float = 0.01) -> Pose[np.ndarray]:
    """Along x with a small turn, as an arm goes, looking down."""
    random = np.random.default_rng(3)
    n = np.arange(COUNT) - COUNT / 2
    x = np.stack([400 + step_mm * n, 50 + bend * n**2, 300 + 0.1 * n], axis=1) + random.normal(0, noise_mm, (COUNT, 3))
    turn = Rotation.from_euler("xyz", np.stack([180 + 0 * n, 0.2 * n, 0.1 * n], axis=1), degrees=True)
    off = Rotation.from_rotvec(np.radians(random.normal(0, noise_deg, (COUNT, 3))))
    return Pose((turn * off).as_rotvec(), x)


def rig(moves: type[HeadPoses | ObjectPoses] = HeadPoses, usual: Pose[np.ndarray] | None = None) -> RigFile:
    plain = rig_2003.simulated_rig(0)
    with float64():
        content = Rig(plain.camera, plain.lights, as_numpy(moves.at_rest("poses")))
    return RigFile(content, fit={"pose_range": PoseRange.of(usual).values()} if usual is not None else {})


def scan(given: Pose[np.ndarray]) -> Scan:
    frames = tuple(Path(f"{i:03d}.png") for i in range(len(given.rotation)))
    axes = {axis: tuple(int(n) for n in each) for axis, each in positions_of(given).items()}
    return Scan(Path("scan.toml"), StripeSettings("red"), frames, axes=axes)


def moved(given: Pose[np.ndarray], at: int, by=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)) -> Pose[np.ndarray]:
    x, R = given.translation.copy(), given.rotation.copy()
    x[at] += by
    R[at] = (Rotation.from_rotvec(R[at]) * Rotation.from_rotvec(turn)).as_rotvec()
    return Pose(R, x)


@pytest.mark.parametrize(
    "given",
    [path(), path(0.3), path(8.0), path(bend=0.02), path(noise_mm=0.1, noise_deg=0.05), path(step_mm=0.0)],
    ids=["usual", "short steps", "long steps", "bent", "a worse arm", "at rest"],
)
def test_a_path_is_one(given):
    assert pose_notes(rig(), scan(given)) == []


def test_corners_and_passes_of_a_path_are_none_beside_it():
    """Back and forth with steps aside, and a corner."""
    n = np.arange(COUNT)
    back = np.where(n < COUNT / 2, n, COUNT - n)
    x = np.stack([300 + 2.0 * back, 40.0 * (n >= COUNT / 2), 300 + 0 * n], axis=1)
    corner = np.stack([300 + 2.0 * np.minimum(n, 20), 2.0 * np.maximum(n - 20, 0), 300 + 0 * n], axis=1)
    still = np.tile(Rotation.from_euler("x", 180, degrees=True).as_rotvec(), (COUNT, 1))
    for each in (x, corner):
        assert stand_out(Pose(still, each.astype(float))) == []


@pytest.mark.parametrize(
    ("by", "turn"), [((5.0, 0, 0), (0, 0, 0)), ((0, 1.0, 0), (0, 0, 0)), ((0, 0, 0), (0, 0.03, 0))]
)
def test_a_pose_beside_the_path_is_named(by, turn):
    (note,) = pose_notes(rig(), scan(moved(path(), 17, by, turn)))
    assert note.startswith("the pose of 017.png (")
    assert "stands beside the path" in note


def test_two_poses_that_were_exchanged_are_named():
    given = path()
    order = np.arange(COUNT)
    order[[8, 30]] = order[[30, 8]]
    (note,) = pose_notes(rig(), scan(Pose(given.rotation[order], given.translation[order])))
    assert "008.png" in note
    assert "030.png" in note


def test_degrees_that_were_taken_for_radians_turn_the_head_wildly():
    given = path(noise_deg=0.05)
    turns = Rotation.from_euler("z", 6.0 * np.arange(COUNT)[:, None], degrees=True)
    wild = Pose(turns.as_rotvec(), given.translation)
    notes = pose_notes(rig(), scan(wild))
    assert "turns by 6° from frame to frame" in notes[0]
    # An object on a hand is turned so, to be seen from all around.
    assert pose_notes(rig(ObjectPoses), scan(wild)) == []


def test_poses_far_from_those_of_the_calibration_are_pointed_out():
    given = path()
    usual = Pose(given.rotation[::3], given.translation[::3])
    assert pose_notes(rig(usual=usual), scan(given)) == []
    (note,) = pose_notes(
        rig(usual=usual), scan(replace(given, translation=given.translation + np.array([0, 200.0, 0])))
    )
    assert "200 mm outside the space in which the rig was calibrated" in note
    tool = Rotation.from_euler("y", 40, degrees=True)
    turned = Pose((Rotation.from_rotvec(given.rotation) * tool).as_rotvec(), given.translation)
    (note,) = pose_notes(rig(usual=usual), scan(turned))
    assert "turned by" in note
    assert "tool or base frame" in note


@pytest.mark.parametrize(("words", "part"), [("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4)])
def test_positions_in_another_unit_are_named(words: str, part: float):
    """Refused where they are nowhere near those of the calibration, and pointed out where they are only far."""
    given = path()
    small = scan(Pose(given.rotation, given.translation / part))
    tight = rig(usual=Pose(given.rotation[::3], given.translation[::3]))
    with pytest.raises(InputError, match=f"but they do in {words}: write positions in millimetres"):
        check_poses(tight, small)
    check_poses(tight, scan(given))
    # A calibration that went over 700 mm, from which none of them is far enough to be refused.
    wide = Pose(given.rotation[:9], np.linspace([300.0, -300.0, 150.0], [600.0, 200.0, 500.0], 9))
    if words == "centimetres":
        check_poses(rig(usual=wide), small)
        (note,) = pose_notes(rig(usual=wide), small)
        assert re.search(rf"the rig was calibrated, and \d+ mm in {words}: write positions in millimetres", note)
    assert pose_notes(rig(usual=wide), scan(given)) == []
