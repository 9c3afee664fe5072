"""A table of given poses, such as a robot's program or a tracker writes: a line for each photograph.

A line is `name, x, y, z, qw, qx, qy, qz`, position in mm and a quaternion of length 1, or the name and the 4 × 4 matrix
row by row (its last row may be left out). Semicolons, commas, tabs or spaces stand between, the first of them that a
line has; between semicolons a comma is that of a decimal. A line without a number is a heading, and what follows # is a
remark. Photographs that the table has and nobody asks for do not matter.
"""

from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.rigid import rigid_pose, turned
from jaxscan.files.table import Table
from jaxscan.files.text import parse_file
from jaxscan.geometry import Pose

# Position and quaternion; three rows of a matrix; four.
_COUNTS: Final = (7, 12, 16)
_SHAPES: Final = "name, x, y, z, qw, qx, qy, qz or a name and the 16 numbers of a 4 × 4 matrix"


def read_pose_table(path: Path, photographs: Sequence[Path]) -> Pose[np.ndarray]:
    """T_base_hand of each photograph, stacked in their order, mm.

    Args:
        path: of the table.
        photographs: found in it by their names, with their folders or without.

    Raises:
        InputError: the table is missing or a line is none of it, a pose is no rigid motion, or a photograph has none.
    """
    by_name = parse_file(path, "table of poses", lambda text: _lines(path, text))
    poses, missing = [], []
    for photograph in photographs:
        names = (*(str(PurePath(*photograph.parts[-n:])) for n in (1, 2)), photograph.stem)
        found = [by_name[name] for name in names if name in by_name]
        if len(found) > 1 and photograph.name in by_name and names[1] in by_name:
            raise InputError(f"{path}: has poses of {names[0]} and of {names[1]}, which is one photograph: keep one")
        if found:
            poses.append(found[0])
        else:
            missing.append(photograph.name)
    if missing:
        some = ", ".join(missing[:3]) + (f" and {len(missing) - 3} more" if len(missing) > 3 else "")
        has = ", ".join(list(by_name)[:3]) + (" …" if len(by_name) > 3 else "")
        raise InputError(
            f"{path}: has no pose of {some}, but of {has or 'nothing'}: begin each line with a photograph's file name"
        )
    return Pose(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses]))


def named_table(table: Table, key: str, of: str) -> Path:
    """The table of poses that a session or a scan names, beside its TOML file.

    Args:
        table: with the name.
        key: its key.
        of: what has the poses, in words.

    Raises:
        InputError: there is no such file.
    """
    path = table.path.parent / table.string(key)
    if not path.is_file():
        raise table.error(key, f"{path} is no file: name the table with the pose of each {of}")
    return path


def write_pose_table(path: Path, names: Sequence[str], poses: Pose[np.ndarray]) -> None:
    """Write a table of poses T_base_hand (mm) that `read_pose_table` reads, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    quaternions = np.roll(Rotation.from_rotvec(poses.rotation).as_quat(), 1, axis=1)
    with replacing(path, "w") as file:
        file.write("name,x,y,z,qw,qx,qy,qz\n")
        for name, x, q in zip(names, poses.translation, quaternions, strict=True):
            file.write(",".join([name, *(f"{value:.6f}" for value in x), *(f"{value:.9f}" for value in q)]) + "\n")


def _lines(path: Path, text: str) -> dict[str, Pose[np.ndarray]]:
    poses: dict[str, Pose[np.ndarray]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = _words(line.partition("#")[0].strip())
        where = f"{path}: line {number}"
        numbers = [_number(word) for word in words]
        if not any(value is not None for value in numbers[1:]):
            if poses and words:
                raise InputError(f"{where}: is {line.strip()!r}, but {_SHAPES} is expected")
            continue
        name, values = words[0], numbers[1:]
        if len(words) in _COUNTS and all(value is not None for value in numbers):
            raise InputError(f"{where}: has {len(words)} numbers and no name: begin it with the photograph's file name")
        if len(values) not in _COUNTS or any(value is None for value in values):
            raise InputError(f"{where}: is {line.strip()!r:.80}, but {_SHAPES} is expected")
        if name in poses:
            raise InputError(f"{where}: {name} stands twice: keep one of them")
        poses[name] = _pose(where, np.array(values, np.float64))
    return poses


def _pose(where: str, values: Float[np.ndarray, "numbers"]) -> Pose[np.ndarray]:
    if len(values) == _COUNTS[0]:
        return Pose(turned(where, np.roll(values[3:], -1)), values[:3])
    return rigid_pose(where, values.reshape(-1, 4))


def _words(line: str) -> list[str]:
    between = next((each for each in (";", ",", "\t") if each in line), None)
    if between == ";":
        name, *numbers = line.split(";")
        line = ";".join([name, *(number.replace(",", ".") for number in numbers)])
    # A line may end in what stands between.
    return [word.strip() for word in line.strip(between).split(between)] if line else []


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
