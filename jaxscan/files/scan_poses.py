"""The poses of scans in one frame, as a person or another program has it: JSON, or a `.conf` of the Stanford scans.

JSON is a list in the order of the scans, or an object with a pose for each scan's file name. A pose is a matrix of
4 × 4 (or 3 × 4), row by row, or {"position": [x, y, z], "quaternion": [w, x, y, z]}: what carries the scan's points
into the frame that all share, in the scans' own unit of length.

In a `.conf` a line `bmesh NAME tx ty tz qi qj qk qw` stands for each scan. Points p go to R p + t with R the
*transpose* of the matrix that the quaternion (qi, qj, qk, qw) usually stands for: that of (qi, qj, qk, −qw). Only so do
the bunny's scans fall onto each other. The `camera` line says from where to look, and is of no use here.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from jaxscan.errors import InputError
from jaxscan.files.rigid import rigid_pose, turned, usable
from jaxscan.files.table import show
from jaxscan.files.text import parse_file, read_json_value
from jaxscan.geometry import Pose

_CONF_WORDS: Final = 9


def read_scan_poses(path: Path, scans: Sequence[Path]) -> list[Pose]:
    """T_common_scan of each scan, in the scans' own unit of length.

    Args:
        path: `.json` or `.conf`.
        scans: found in the file by their names, without the folder; others that it has do not matter.

    Raises:
        InputError: the file is missing or not of its kind, a scan has no pose, or a pose is no rigid motion.
    """
    if path.suffix.lower() not in (".json", ".conf"):
        raise InputError(f"{path}: give the poses as .json, or as .conf of the Stanford scans")
    if path.suffix.lower() == ".conf":
        poses = parse_file(path, "conf", lambda text: _of_conf(path, text))
    else:
        content = read_json_value(path)
        if isinstance(content, list):
            if len(content) != len(scans):
                raise InputError(
                    f"{path}: has {len(content)} poses for {len(scans)} scans: give one for each, in order"
                )
            return [_of_json(path, f"pose {k}", value) for k, value in enumerate(content)]
        if not isinstance(content, dict):
            raise InputError(f"{path}: holds {show(content)}, but a list of poses or an object is expected")
        poses = {name: _of_json(path, f'"{name}"', value) for name, value in content.items()}
    twins = [name for name, count in Counter(scan.name for scan in scans).items() if count > 1]
    if twins:
        raise InputError(
            f"{path}: names scans by their files, but several are called {', '.join(twins)}: give the poses as a JSON "
            "list, in the order of the scans"
        )
    missing = [scan.name for scan in scans if scan.name not in poses]
    if missing:
        raise InputError(
            f"{path}: has no pose for {', '.join(missing)}, but for {', '.join(poses) or 'nothing'}: "
            "name each scan's file there, without its folder"
        )
    return [poses[scan.name] for scan in scans]


def _of_conf(path: Path, text: str) -> dict[str, Pose]:
    poses: dict[str, Pose] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0] in ("camera", "mesh") or words[0].startswith("#"):
            continue
        where = f"line {number}"
        if words[0] != "bmesh" or len(words) != _CONF_WORDS:
            raise InputError(f"{path}: {where}: is {line!r}, but bmesh NAME tx ty tz qi qj qk qw is expected")
        if words[1] in poses:
            raise InputError(f"{path}: {where}: {words[1]} appears twice: keep one of them")
        try:
            values = np.array([float(word) for word in words[2:]])
        except ValueError as error:
            raise InputError(f"{path}: {where}: is {line!r}, but seven numbers are expected after the name") from error
        if not usable(values):
            raise InputError(f"{path}: {where}: is {line!r}, but finite numbers are expected after the name")
        poses[words[1]] = Pose(-turned(f"{path}: {where}", values[3:]), values[:3])
    return poses


def _of_json(path: Path, where: str, value: Any) -> Pose:
    expected = 'a matrix of 4 × 4, or {"position": [x, y, z], "quaternion": [w, x, y, z]}, is expected'
    try:
        if isinstance(value, dict):
            if set(value) != {"position", "quaternion"}:
                raise InputError(f"{path}: {where}: has {', '.join(value) or 'nothing'}, but {expected}")
            position, quaternion = (np.array(value[key], np.float64) for key in ("position", "quaternion"))
            if position.shape != (3,) or quaternion.shape != (4,) or not usable(position, quaternion):
                raise InputError(f"{path}: {where}: is {show(value)}, but {expected}")
            return Pose(turned(f"{path}: {where}", np.roll(quaternion, -1)), position)
        T = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: {where}: is {show(value)}, but {expected}") from error
    if T.shape not in ((3, 4), (4, 4)) or not usable(T):
        raise InputError(f"{path}: {where}: is {show(value)}, but {expected}")
    return rigid_pose(f"{path}: {where}", T)
