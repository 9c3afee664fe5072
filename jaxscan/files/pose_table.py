"""A table of given poses, such as a robot's program or a tracker writes: a line for each photograph.

A line is `name, x, y, z, qw, qx, qy, qz`, position in mm and a quaternion of length 1, or the name and the 4 × 4 matrix
row by row (its last row may be left out). Semicolons, commas, tabs or spaces stand between, the first of them that a
line has; between semicolons a comma is that of a decimal. A line without a number is a heading, and what follows # is a
remark. A heading, or a remark before the first pose, that names the eight columns says their order. Photographs that
the table has and nobody asks for do not matter.
"""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.rigid import rigid_pose, turned, usable
from jaxscan.files.table import Table
from jaxscan.files.text import parse_file
from jaxscan.geometry import Pose
from jaxscan.phrases import first_few

# Position and quaternion; three rows of a matrix; four.
_COUNTS: Final = (7, 12, 16)
_MM_IN: Final = {"metres": 1000.0, "inches": 25.4, "centimetres": 10.0}
# Names of columns: x, tx, pos_x, x_mm, "X [mm]"; qw, q_w, rot_w. What a pose is of, as it is read.
_OF_POSITION: Final = re.compile(
    r"(?:t|p|pos|position|trans|translation)?[._ ]*([xyz])(?:[._ ]*[\[(]?(mm|cm|m|in|inch)[\])]?)?"
)
_OF_ROTATION: Final = re.compile(r"(?:q|quat|quaternion|r|rot|rotation|o|orientation)[._ ]*([wxyz])|([wijk])")
_IJK: Final = {"i": "x", "j": "y", "k": "z"}
_COLUMNS: Final = ("x", "y", "z", "qw", "qx", "qy", "qz")
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
        has = ", ".join(list(by_name)[:3]) + (" …" if len(by_name) > 3 else "")
        raise InputError(
            f"{path}: has no pose of {first_few(missing, 3)}, but of {has or 'nothing'}: begin each line with a "
            "photograph's file name"
        )
    return Pose(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses]))


def misread(given: Pose[np.ndarray]) -> Iterator[tuple[str, Pose[np.ndarray]]]:
    """The usual mistakes in a table, in words that follow "but they do", and the poses that are then meant."""
    from scipy.spatial.transform import Rotation

    yield (
        "the other way round: change moves to the other of head and object, or, if that is right, write the pose of "
        "the hand in the frame of the base (T_base_hand), and not its inverse",
        given.inverse(),
    )
    # What was read as w, x, y, z stands in the table as x, y, z, w.
    read = Rotation.from_quat(np.roll(Rotation.from_rotvec(given.rotation).as_quat(), 1, axis=-1))
    yield "with the quaternion as qx, qy, qz, qw: write qw first", Pose(read.as_rotvec(), given.translation)
    for unit, mm in _MM_IN.items():
        yield f"in {unit}: write positions in millimetres", Pose(given.rotation, mm * given.translation)


def transposed(given: Pose[np.ndarray]) -> tuple[str, Pose[np.ndarray]]:
    """One more mistake, as `misread` has them: rotations alone that are the inverse of what they should be.

    Poses that are turned the other way are possible ones too, so this alone is no reason to refuse them.
    """
    words = "with the rotations the other way round: transpose the matrices, or give qx, qy and qz the other sign"
    return words, Pose(-given.rotation, given.translation)


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
    from scipy.spatial.transform import Rotation

    quaternions = np.roll(Rotation.from_rotvec(poses.rotation).as_quat(), 1, axis=1)
    with replacing(path, "w") as file:
        file.write("name,x,y,z,qw,qx,qy,qz\n")
        for name, x, q in zip(names, poses.translation, quaternions, strict=True):
            file.write(",".join([name, *(f"{value:.6f}" for value in x), *(f"{value:.9f}" for value in q)]) + "\n")


def _lines(path: Path, text: str) -> dict[str, Pose[np.ndarray]]:
    poses: dict[str, Pose[np.ndarray]] = {}
    order: list[int] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        words = _words(line.partition("#")[0].strip())
        where = f"{path}: line {number}"
        numbers = [_number(word) for word in words]
        if not any(value is not None for value in numbers[1:]):
            heading = words or _words(line.strip().lstrip("# "))
            order = order if poses else _order(where, heading) or order
            if poses and words:
                raise InputError(f"{where}: is {line.strip()!r}, but {_SHAPES} is expected")
            continue
        name, values = words[0], numbers[1:]
        if len(words) in _COUNTS and all(value is not None for value in numbers):
            raise InputError(f"{where}: has {len(words)} numbers and no name: begin it with the photograph's file name")
        if len(values) not in _COUNTS or any(value is None for value in values):
            raise InputError(f"{where}: is {line.strip()!r:.80}, but {_SHAPES} is expected")
        if name in poses:
            raise InputError(f"{where}: {name} appears twice: keep one of them")
        pose = np.array(values, np.float64)
        poses[name] = _pose(where, pose[order] if order and len(pose) == len(order) else pose)
    return poses


def _order(where: str, heading: Sequence[str]) -> list[int] | None:
    """Where the numbers of a pose stand behind the name, by the names of the columns; None where these do not say."""
    positions = [_OF_POSITION.fullmatch(word.lower()) for word in heading[1:]]
    units = [(found[1], found[2]) for found in positions if found and found[2] not in (None, "mm")]
    if units:
        raise InputError(f"{where}: {units[0][0]} is in {units[0][1]}: write positions in mm, and name the columns so")
    rotations = [_OF_ROTATION.fullmatch(word.lower()) for word in heading[1:]]
    names: list[str] = []
    for position, rotation in zip(positions, rotations, strict=True):
        if position:
            # x, y, z, x, y, z, w: the second time they are the quaternion's.
            names.append(position[1] if position[1] not in names else f"q{position[1]}")
        else:
            part = (rotation[1] or rotation[2]) if rotation else ""
            names.append(part and f"q{_IJK.get(part, part)}")
    if sorted(names) == sorted(_COLUMNS):
        return [names.index(column) for column in _COLUMNS]
    if "qw" in names and len(names) == len(_COLUMNS):
        raise InputError(
            f"{where}: names its columns {', '.join(heading)}, which do not say where the quaternion's parts stand: "
            "name them name, x, y, z, qw, qx, qy, qz, in the order that they have"
        )
    return None


def _pose(where: str, values: Float[np.ndarray, "numbers"]) -> Pose[np.ndarray]:
    for value in values:
        if not usable(value):
            raise InputError(
                f"{where}: has the number {value:g}: write the pose as it was, or leave the photograph out"
            )
    if len(values) == _COUNTS[0]:
        return Pose(turned(where, np.roll(values[3:], -1)), values[:3])
    return rigid_pose(where, values.reshape(-1, 4))


def _words(line: str) -> list[str]:
    between = next((each for each in (";", ",", "\t") if each in line), None)
    if between == ";":
        name, *numbers = line.split(";")
        line = ";".join([name, *(number.replace(",", ".") for number in numbers)])
    # A line may end in what stands between.
    return [word.strip().strip("\"'") for word in line.strip(between).split(between)] if line else []


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
