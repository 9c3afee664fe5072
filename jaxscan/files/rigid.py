"""Rigid motions as files have them: a quaternion or a matrix, seen to be one."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.files.table import LARGEST
from jaxscan.geometry import Pose

# How far a matrix may be from a rotation, and the length of a quaternion from 1.
_OFF: Final = 1e-3


def turned(where: str, quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3"]:
    """The rotation vector of a quaternion x, y, z, w, radians.

    Args:
        where: it stands, for errors.
        quaternion: of length 1.

    Raises:
        InputError: its length is another.
    """
    from scipy.spatial.transform import Rotation

    length = float(np.linalg.norm(quaternion)) if usable(quaternion) else np.inf
    if not abs(length - 1) < _OFF:
        raise InputError(f"{where}: the quaternion has the length {length:.4g}, but 1 is expected")
    return Rotation.from_quat(quaternion).as_rotvec()


def rigid_pose(where: str, T: Float[np.ndarray, "rows 4"]) -> Pose[np.ndarray]:
    """The pose of a matrix of three or four rows.

    Args:
        where: it stands, for errors.
        T: the matrix; its translation in mm.

    Raises:
        InputError: it is no rigid motion.
    """
    rigid = usable(T)
    if rigid:
        R = T[:3, :3]
        rigid = bool(np.abs(R @ R.T - np.eye(3)).max() < _OFF and np.linalg.det(R) > 0)
        rigid = rigid and bool(len(T) == 3 or np.abs(T[3] - [0, 0, 0, 1]).max() <= _OFF)
    if not rigid:
        raise InputError(f"{where}: is no rotation with a translation: leave scale and mirroring out")
    u, _, vt = np.linalg.svd(T[:3, :3])
    return Pose.from_matrix(u @ vt, T[:3, 3])


def usable(*values: Float[np.ndarray, "*any"]) -> bool:
    """Whether numbers are finite, and their squares are too."""
    return all(bool((np.abs(each) <= LARGEST).all()) for each in values)
