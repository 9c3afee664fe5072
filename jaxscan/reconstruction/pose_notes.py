"""What the given poses of a scan show by themselves: where the hand was, and poses that stand out of its path."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.axis_details import POSES
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import matrix_to_vector
from jaxscan.rig import HeadPoses, Motion, ObjectPoses, PoseRange, given_poses

# A pose stands out of a path if two before it and two behind it lie on a parabola within this part of a step, and it
# lies beside that by this part of a step.
_SMOOTH, _BESIDE = 0.1, 0.5
# And by at least this, mm and rad: arms are no better.
_LEAST_MM, _LEAST_RAD = 0.5, 0.01
_AROUND: Final = np.array([-2, -1, 1, 2])
# From frame to frame a head turns by less than this, rad, or not about itself alone: what it sees at the first
# distance, mm, or farther would move by more than the second multiple of its own way.
_WILD_RAD: Final = 0.05
_LEVER_MM, _OF_ITS_WAY = 200.0, 8.0
# Poses that are named.
_NAMED: Final = 4


def pose_notes(content: RigFile, scan: Scan) -> list[str]:
    """What is said of a scan's poses; nothing of scans without."""
    if not isinstance(content.rig.motion, HeadPoses | ObjectPoses) or not scan.axes:
        return []
    given = given_poses({axis: np.asarray(n, np.float64) for axis, n in scan.axes.items()})
    return [*_wild(content.rig.motion, given), *_where(content, given), *_beside_path(scan, given)]


def turns_wildly(motion: Motion, given: Pose[np.ndarray]) -> float | None:
    """By how much a head turns from frame to frame, rad, where it turns far and hardly moves; else None.

    An object on a hand may well turn so.
    """
    if not isinstance(motion, HeadPoses) or len(given.rotation) <= len(_AROUND):
        return None
    R = given.matrix()
    turn = float(np.median(np.linalg.norm(matrix_to_vector(R[:-1].swapaxes(-1, -2) @ R[1:]), axis=1)))
    way = float(np.median(np.linalg.norm(np.diff(given.translation, axis=0), axis=1)))
    return turn if turn > _WILD_RAD and turn * _LEVER_MM > _OF_ITS_WAY * way else None


def _wild(motion: Motion, given: Pose[np.ndarray]) -> list[str]:
    turn = turns_wildly(motion, given)
    if turn is None:
        return []
    return [
        f"the head turns by {np.degrees(turn):.0f}° from frame to frame and hardly moves: if it did not turn so far, "
        "the rotations are in another form than the table should have, such as degrees taken for radians"
    ]


def _where(content: RigFile, given: Pose[np.ndarray]) -> list[str]:
    if "pose_range" not in content.fit:
        return []
    usual = PoseRange.from_values(content.fit["pose_range"])
    if usual.is_usual(given):
        return []
    mm, rad = usual.outside(given)
    return [
        f"the poses of half of the frames are {mm:.0f} mm outside the space in which the rig was calibrated and turned "
        f"by {np.degrees(rad):.0f}° from all poses of the calibration, or more: if the scan was not taken so far away, "
        f"{POSES} are of another tool or base frame, or in another form (the inverse, another order of the angles)"
    ]


def _beside_path(scan: Scan, given: Pose[np.ndarray]) -> list[str]:
    """Single poses that lie beside the path of those around them."""
    names = [path.name for path in scan.frames]
    found = stand_out(given)
    if not len(found):
        return []
    some = ", ".join(f"{names[i]} ({mm:.1f} mm, {np.degrees(rad):.1f}°)" for i, mm, rad in found[:_NAMED])
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    stands = "stands" if len(found) == 1 else "stand"
    return [
        f"the pose of {some}{more} {stands} beside the path of the frames before and behind: check that it is the "
        "photograph's own, and not another one's"
    ]


def stand_out(given: Pose[np.ndarray]) -> list[tuple[int, float, float]]:
    """The poses beside the path of their neighbours: which, and by how much, mm and rad."""
    count = len(given.rotation)
    if count < len(_AROUND) + 1:
        return []
    x, R = given.translation, given.matrix()
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    found = []
    for i in range(2, count - 2):
        near = i + _AROUND
        # Rotations as vectors from that of a neighbour: they are small along a path.
        turned = matrix_to_vector(R[near[0]].T @ R[[*near, i]])
        if np.linalg.norm(turned[:-1], axis=1).max() > 1.0:
            continue
        (off, rest), (off_rad, rest_rad) = (_parabola(values) for values in (x[[*near, i]], turned))
        step, step_rad = float(np.median(steps[i - 2 : i + 2])), float(np.median(_apart(turned)))
        moved = off > max(_BESIDE * step, _LEAST_MM) and rest < max(_SMOOTH * step, _LEAST_MM / 5)
        was_turned = off_rad > max(_BESIDE * step_rad, _LEAST_RAD) and rest_rad < max(
            _SMOOTH * step_rad, _LEAST_RAD / 5
        )
        if moved or was_turned:
            found.append((i, off, off_rad))
    return found


def _parabola(values: Float[np.ndarray, "five 3"]) -> tuple[float, float]:
    """How far the last value is from the parabola of the others, and how far these are from it at the most."""
    A = np.stack([np.ones(4), _AROUND, _AROUND**2], axis=1)
    fitted = np.linalg.lstsq(A, values[:4], rcond=None)[0]
    rest = np.linalg.norm(values[:4] - A @ fitted, axis=1).max()
    return float(np.linalg.norm(values[4] - fitted[0])), float(rest)


def _apart(turned: Float[np.ndarray, "five 3"]) -> Float[np.ndarray, "steps"]:
    """From each of the four neighbours to the next, rad for a frame."""
    return np.linalg.norm(np.diff(turned[:4], axis=0), axis=1) / np.diff(_AROUND)
