"""Tables of given poses: every form that the format has, and every mistake with its fix."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.files.pose_table import read_pose_table, write_pose_table
from jaxscan.geometry import Pose

NAMES = [Path("poses") / f"{i:02d}.png" for i in range(3)]


def poses(seed: int = 0) -> Pose[np.ndarray]:
    random = np.random.default_rng(seed)
    return Pose(random.normal(0, 1, (3, 3)), random.normal(0, 300, (3, 3)))


def matrices(given: Pose[np.ndarray]) -> np.ndarray:
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = given.matrix(), given.translation
    return T


def table(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def quaternion_line(given: Pose[np.ndarray], i: int) -> list[float]:
    x, y, z, w = Rotation.from_rotvec(given.rotation[i]).as_quat()
    return [*given.translation[i], w, x, y, z]


@pytest.mark.parametrize("between", [",", "; ", "\t", "  "])
@pytest.mark.parametrize("form", ["quaternion", "four rows", "three rows"])
def test_every_form_of_a_line(tmp_path: Path, between: str, form: str):
    given = poses()
    T = matrices(given)
    values = {
        "quaternion": [quaternion_line(given, i) for i in range(3)],
        "four rows": [t.ravel() for t in T],
        "three rows": [t[:3].ravel() for t in T],
    }[form]
    lines = [between.join([path.name, *(repr(float(x)) for x in row)]) for path, row in zip(NAMES, values, strict=True)]
    heading = between.join(["name", "x", "y", "z"])
    read = read_pose_table(table(tmp_path / "poses.csv", [heading, "", *lines[::-1], "# the end"]), NAMES)
    np.testing.assert_allclose(read.matrix(), given.matrix(), atol=1e-12)
    np.testing.assert_allclose(read.translation, given.translation, atol=1e-12)


def test_what_is_written_is_read(tmp_path: Path):
    given = poses(1)
    write_pose_table(tmp_path / "poses.csv", [path.name for path in NAMES], given)
    read = read_pose_table(tmp_path / "poses.csv", NAMES)
    np.testing.assert_allclose(read.matrix(), given.matrix(), atol=1e-8)
    np.testing.assert_allclose(read.translation, given.translation, atol=1e-6)


def test_names_with_their_folder_or_without_their_ending(tmp_path: Path):
    for names in ("poses/00.png", "00"):
        read = read_pose_table(table(tmp_path / "p.csv", [f"{names},1,2,3,1,0,0,0"]), NAMES[:1])
        np.testing.assert_allclose(read.translation, [[1, 2, 3]])


def test_decimal_commas_and_names_with_spaces(tmp_path: Path):
    photograph = Path("poses") / "my photograph 1.png"
    read = read_pose_table(table(tmp_path / "p.csv", [f"{photograph.name};1,5;-2;3e2;0,6;0,8;0;0;"]), [photograph])
    np.testing.assert_allclose(read.translation, [[1.5, -2.0, 300.0]])
    np.testing.assert_allclose(read.rotation, [[2 * np.arctan2(0.8, 0.6), 0, 0]])
    same = read_pose_table(
        table(tmp_path / "p.csv", [f"{photograph.name}, 1.5, -2, 3e2, 0.6, 0.8, 0, 0"]), [photograph]
    )
    np.testing.assert_array_equal(same.rotation, read.rotation)


@pytest.mark.parametrize(
    "heading",
    [
        "photograph,x,y,z,qx,qy,qz,qw",
        "Name, X [mm], Y [mm], Z [mm], q_x, q_y, q_z, q_w",
        "# timestamp,tx,ty,tz,qx,qy,qz,qw",
        '"name","pos_x","pos_y","pos_z","rot.x","rot.y","rot.z","rot.w"',
        "name,x,y,z,x,y,z,w",
        "name,X,Y,Z,i,j,k,w",
    ],
)
def test_a_heading_says_the_order_of_the_columns(tmp_path: Path, heading: str):
    given = poses()
    x, y, z, w = Rotation.from_rotvec(given.rotation).as_quat().T
    rows = np.column_stack([given.translation, x, y, z, w])
    lines = [f'"{path.name}",' + ",".join(map(repr, row.tolist())) for path, row in zip(NAMES, rows, strict=True)]
    read = read_pose_table(table(tmp_path / "p.csv", [heading, *lines]), NAMES)
    np.testing.assert_allclose(read.matrix(), given.matrix(), atol=1e-12)
    np.testing.assert_allclose(read.translation, given.translation, atol=1e-12)


def test_a_heading_that_says_nothing_of_the_order(tmp_path: Path):
    for heading in ("name,a,b,c,d,e,f,g", "# poses of Tuesday", "name,x,y,z,qw,qx,qy,qz"):
        read = read_pose_table(table(tmp_path / "p.csv", [heading, "00.png,1,2,3,0,1,0,0"]), NAMES[:1])
        np.testing.assert_allclose(np.abs(read.rotation), [[np.pi, 0, 0]])


@pytest.mark.parametrize("heading", ["name,x,y,z,a,b,c,w", "name,x,y,z,w,q1,q2,q3"])
def test_a_heading_that_says_a_part_of_the_order_is_refused(tmp_path: Path, heading: str):
    with pytest.raises(InputError, match=r"line 1: names its columns .* qw, qx, qy, qz, in the order"):
        read_pose_table(table(tmp_path / "p.csv", [heading, "00.png,1,2,3,0,1,0,0"]), NAMES[:1])


LINE = "{},1,2,3,1,0,0,0"
BAD = {
    "no such photograph": ([LINE.format("00.png"), LINE.format("9.png")], ["no pose of 01.png, 02.png", "00.png, 9"]),
    "empty": (["name,x,y,z"], ["no pose of 00.png, 01.png, 02.png", "but of nothing"]),
    "no names": (["1,2,3,1,0,0,0"], ["line 1: has 7 numbers and no name"]),
    "six numbers": (["00.png,1,2,3,0,0,90"], ["line 1", "qw, qx, qy, qz", "4 × 4"]),
    "a word": ([LINE.format("00.png"), "01.png,1,2,x,1,0,0,0"], ["line 2: is '01.png,1,2,x,1,0,0,0'"]),
    "twice": ([LINE.format("00.png")] * 2, ["line 2: 00.png appears twice"]),
    "no unit quaternion": (["00.png,1,2,3,1,1,0,0"], ["line 1: the quaternion has the length 1.414"]),
    "no number": (["00.png,1,2,3,nan,0,0,0"], ["line 1: has the number nan"]),
    "no position": (["00.png,1,nan,3,1,0,0,0"], ["line 1: has the number nan", "leave the photograph out"]),
    "a large one": (["00.png,1e200,0,3,1,0,0,0"], ["line 1: has the number 1e+200"]),
    "metres": (["name,x_m,y_m,z_m,qw,qx,qy,qz", LINE.format("00.png")], ["line 1: x is in m: write positions in mm"]),
    "a mirror": (["00.png,-1,0,0,1,0,1,0,2,0,0,1,3"], ["line 1: is no rotation", "mirroring"]),
    "a remark in between": ([LINE.format("00.png"), "and so on"], ["line 2: is 'and so on'"]),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_named_with_their_fix(tmp_path: Path, name: str):
    lines, expected = BAD[name]
    path = table(tmp_path / "poses.csv", lines)
    with pytest.raises(InputError) as caught:
        read_pose_table(path, NAMES)
    for part in (str(path), *expected):
        assert part in str(caught.value)


def test_a_table_that_is_not_there(tmp_path: Path):
    with pytest.raises(InputError, match="there is no such file"):
        read_pose_table(tmp_path / "poses.csv", NAMES)
