"""Poses of scans from JSON and from a `.conf`."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.files.scan_poses import read_scan_poses

R = Rotation.from_rotvec([0.3, -0.5, 0.2])
t = np.array([1.0, -2.0, 3.0])
T = np.vstack([np.column_stack([R.as_matrix(), t]), [0, 0, 0, 1]])
SCANS = [Path("some/a.ply"), Path("b.npz")]
STILL = np.eye(4).tolist()


def written(folder: Path, content: object, ending: str = "json") -> Path:
    path = folder / f"poses.{ending}"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize(
    "pose",
    [T.tolist(), T[:3].tolist(), {"position": t.tolist(), "quaternion": np.roll(R.as_quat(), 1).tolist()}],
)
def test_json(tmp_path, pose):
    for content in ([pose, STILL], {"b.npz": STILL, "a.ply": pose, "other.ply": STILL}):
        (first, second) = read_scan_poses(written(tmp_path, content), SCANS)
        np.testing.assert_allclose(first.rotation, R.as_rotvec(), atol=1e-12)
        np.testing.assert_allclose(first.translation, t, atol=1e-12)
        np.testing.assert_allclose(second.rotation, 0)


def test_conf(tmp_path):
    # A quarter turn about y. As quaternions usually go it would carry z to x; here it carries x to z.
    half = np.sqrt(0.5)
    text = f"camera 1 2 3 0 0 0 1\nmesh whole.ply\nbmesh a.ply 1 2 3 0 {half} 0 {half}\n\nbmesh b.npz 0 0 0 0 0 0 1\n"
    (first, second) = read_scan_poses(written(tmp_path, text, "conf"), SCANS)
    np.testing.assert_allclose(first.apply(np.array([1.0, 0.0, 0.0])), [1, 2, 4], atol=1e-12)
    np.testing.assert_allclose(second.rotation, 0)


@pytest.mark.parametrize(
    ("content", "ending", "problem"),
    [
        ([STILL], "json", r"has 1 poses for 2 scans"),
        ({"a.ply": STILL}, "json", r"has no pose for b\.npz, but for a\.ply"),
        ({"a.ply": STILL, "b.npz": {"position": [0, 0, 0]}}, "json", r'"b\.npz": has position, but a matrix'),
        ({"a.ply": STILL, "b.npz": [[1, 2], [3]]}, "json", r'"b\.npz": is .* but a matrix of 4 × 4'),
        ([STILL, (2 * np.eye(4)).tolist()], "json", r"pose 1: is no rotation with a translation"),
        ([STILL, np.diag([1, 1, -1, 1]).tolist()], "json", r"pose 1: is no rotation"),
        ([STILL, {"position": [0, 0, 0], "quaternion": [2, 0, 0, 0]}], "json", r"has the length 2, but 1 is expected"),
        ([STILL, {"position": [0, 0, "x"], "quaternion": [1, 0, 0, 0]}], "json", r"pose 1: is "),
        ([STILL, [[10**400] * 4] * 4], "json", r"pose 1: is .* but a matrix of 4 × 4"),
        ("7", "json", r"holds 7, but a list of poses"),
        ("{", "json", r"is not valid JSON"),
        ("bmesh a.ply 0 0 0 0 0 0 1\n", "conf", r"has no pose for b\.npz, but for a\.ply"),
        ("bmesh a.ply 0 0 0 0 0 1\n", "conf", r"line 1: is 'bmesh a\.ply 0 0 0 0 0 1', but bmesh NAME"),
        ("bmesh a.ply 0 0 0 0 0 0 x\n", "conf", r"line 1: .* seven numbers"),
        ("bmesh a.ply 0 0 0 0 0 0 1\nbmesh a.ply 0 0 0 0 0 0 1\n", "conf", r"line 2: a\.ply appears twice"),
        ("bmesh a.ply nan 0 0 0 0 0 1\n", "conf", r"line 1: .* finite numbers"),
        ('{"a.ply": 1, "a.ply": 2}', "json", r'the key "a\.ply" appears twice'),
        ("x", "txt", r"give the poses as \.json, or as \.conf"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, content, ending, problem):
    with pytest.raises(InputError, match=problem):
        read_scan_poses(written(tmp_path, content, ending), SCANS)


def test_scans_of_one_name_are_not_given_one_pose(tmp_path):
    scans = [Path("front/cup.npz"), Path("back/cup.npz")]
    with pytest.raises(InputError, match=r"several are called cup\.npz: give the poses as a JSON list"):
        read_scan_poses(written(tmp_path, {"cup.npz": STILL}), scans)
    (first, second) = read_scan_poses(written(tmp_path, [STILL, T.tolist()]), scans)
    np.testing.assert_allclose(first.translation, 0)
    np.testing.assert_allclose(second.translation, t)
