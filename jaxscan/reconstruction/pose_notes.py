"""What the given poses of a scan show by themselves: a table in another form, where the hand was, and single poses."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.axis_details import POSES
from jaxscan.errors import InputError
from jaxscan.files.pose_table import misread
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import matrix_to_vector
from jaxscan.phrases import first_few
from jaxscan.rig import HeadPoses, Motion, ObjectPoses, PoseRange, given_poses

# Poses may turn by this multiple of σ of a given rotation about a direction about which the calibration's did not; by
# this, rad, where that σ is not known.
_TURNS: Final = 6.0
_A_TURN: Final = 0.002
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
# Another way to read a table is named where its poses are outside the calibration's space by less than this part.
_CLEARLY_NEARER: Final = 0.2
# Rotations of neighbours that are farther apart, rad, make no path.
_SMALL_RAD: Final = 1.0
# Poses that are named.
_NAMED: Final = 4

_EachPlace = Float[np.ndarray, "places"]


def check_poses(content: RigFile, scan: Scan) -> None:
    """Refuse poses that a scan's table has in another form than the calibration's had.

    They turn about a direction along which the calibration has not found where the hand is, or they are nowhere near
    the calibration's, unless a usual mistake in the table is put right.

    Raises:
        InputError: they are such.
    """
    if (found := _given(content, scan)) is None:
        return
    motion, given = found
    if "pose_range" in content.fit:
        usual = PoseRange.from_values(content.fit["pose_range"])
        still = len(scan.frames) > 1 and usual.is_still(given)
        # Rotations that jump from frame to frame are near anything now and then.
        odd = still or not (usual.is_near(given) or _turns_wildly(motion, given))
        near = [(usual.outside(meant), words) for words, meant in misread(given) if odd and _is_near(usual, meant)]
        if near:
            # In centimetres, and in inches, both may be near: the nearest.
            said = f"the poses do not fit those of the calibration, but they do {min(near)[1]}"
            raise InputError(f"{scan.path}: [scan] {POSES}: {said}")
    unknown = np.array(content.fit.get("pose_offset_unknown", []), float).reshape(-1, 3)
    if not len(unknown):
        return
    R = motion.carry(given).matrix()
    turned = np.linalg.norm((R @ R[0].T - np.eye(3)) @ unknown.T, axis=1).max()
    if turned > max(_A_TURN, _TURNS * np.radians(float(content.fit.get("pose_sigma_deg", 0.0)))):
        raise InputError(
            f"{scan.path}: [scan] {POSES}: the hand turns by {np.degrees(turned):.2g}°, as it did not where the rig "
            "was calibrated, so the rig does not say how: scan without such turns, or calibrate with photographs "
            "of the board with the hand turned in two directions"
        )


def _is_near(usual: PoseRange, meant: Pose[np.ndarray]) -> bool:
    return usual.is_near(meant) and not usual.is_still(meant)


def pose_notes(content: RigFile, scan: Scan) -> list[str]:
    """What is said of a scan's poses; nothing of scans without."""
    if (found := _given(content, scan)) is None:
        return []
    motion, given = found
    return [*_wild(motion, given), *_where(content, given), *_beside_path(scan, given)]


def _given(content: RigFile, scan: Scan) -> tuple[HeadPoses | ObjectPoses, Pose[np.ndarray]] | None:
    """What moves by a scan's poses, and these; None of scans without."""
    motion = content.rig.motion
    if not isinstance(motion, HeadPoses | ObjectPoses) or not scan.axes:
        return None
    return motion, given_poses({axis: np.asarray(n, np.float64) for axis, n in scan.axes.items()})


def _turns_wildly(motion: Motion, given: Pose[np.ndarray]) -> float | None:
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
    turn = _turns_wildly(motion, given)
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
    (nearest_mm, _), words = min((usual.outside(meant), words) for words, meant in misread(given))
    if not usual.is_within(given) and nearest_mm < _CLEARLY_NEARER * mm:
        return [
            f"the poses of half of the frames are {mm:.0f} mm or more outside the space in which the rig was "
            f"calibrated, and {nearest_mm:.0f} mm {words}; if the scan was taken so far away, nothing is wrong"
        ]
    return [
        f"the poses of half of the frames are {mm:.0f} mm outside the space in which the rig was calibrated and turned "
        f"by {np.degrees(rad):.0f}° from all poses of the calibration, or more: if the scan was not taken so far away, "
        f"{POSES} are of another tool or base frame, or in another form (the inverse, another order of the angles)"
    ]


def _beside_path(scan: Scan, given: Pose[np.ndarray]) -> list[str]:
    """Single poses that lie beside the path of those around them."""
    names = [path.name for path in scan.frames]
    found = stand_out(given)
    if not found:
        return []
    some = first_few([f"{names[i]} ({mm:.1f} mm, {np.degrees(rad):.1f}°)" for i, mm, rad in found], _NAMED)
    stands = "stands" if len(found) == 1 else "stand"
    return [
        f"the pose of {some} {stands} beside the path of the frames before and behind: check that it is the "
        "photograph's own, and not another one's"
    ]


def stand_out(given: Pose[np.ndarray]) -> list[tuple[int, float, float]]:
    """The poses beside the path of their neighbours: which, and by how much, mm and rad."""
    count = len(given.rotation)
    if count < len(_AROUND) + 1:
        return []
    x, R = given.translation, given.matrix()
    middle = np.arange(2, count - 2)
    five = middle[:, None] + np.append(_AROUND, 0)
    # Rotations as vectors from that of a neighbour: they are small along a path.
    turned = matrix_to_vector(R[five[:, :1]].swapaxes(-1, -2) @ R[five])
    (off, rest, step), (off_rad, rest_rad, step_rad) = (_parabola(values) for values in (x[five], turned))
    moved = (off > np.maximum(_BESIDE * step, _LEAST_MM)) & (rest < np.maximum(_SMOOTH * step, _LEAST_MM / 5))
    was_turned = off_rad > np.maximum(_BESIDE * step_rad, _LEAST_RAD)
    was_turned &= rest_rad < np.maximum(_SMOOTH * step_rad, _LEAST_RAD / 5)
    found = np.flatnonzero((moved | was_turned) & (np.linalg.norm(turned[:, :-1], axis=-1).max(axis=1) < _SMALL_RAD))
    return [(int(middle[k]), float(off[k]), float(off_rad[k])) for k in found]


def _parabola(values: Float[np.ndarray, "places 5 3"]) -> tuple[_EachPlace, _EachPlace, _EachPlace]:
    """How far the last value is from the parabola of the others, these from it at the most, and one from the next."""
    A = np.stack([np.ones(len(_AROUND)), _AROUND, _AROUND**2], axis=1)
    fit = np.linalg.pinv(A)
    others = values[:, :-1]
    off = np.linalg.norm(values[:, -1] - np.einsum("k,pkx->px", fit[0], others), axis=-1)
    rest = np.linalg.norm(others - np.einsum("jk,pkx->pjx", A @ fit, others), axis=-1).max(axis=1)
    apart = np.linalg.norm(np.diff(others, axis=1), axis=-1) / np.diff(_AROUND)
    return off, rest, np.median(apart, axis=1)
