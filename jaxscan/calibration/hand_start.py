"""Camera and hand in closed form, and the usual mistakes in a table of poses.

From one photograph to another the board turns by α in the camera's frame and by β behind K, and α = R β (R. Y. Tsai
and R. K. Lenz 1989): R takes the β onto the α, by weights that leave wrong poses little say. Where nothing turns, the
shifts take the place of the turns; where all turns are about one direction, angles about it are tried. With R known the
places are linear in the offset and in where the board is mounted.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from jaxscan.calibration.hand_eye import Fit, Motion, Seen, median_lengths
from jaxscan.calibration.initial import usual_rotation
from jaxscan.errors import InputError
from jaxscan.files.pose_table import misread, transposed
from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix

# Less is no turn, rad.
_A_TURN: Final = 0.03
_ANGLES: Final = 36
_ROUNDS: Final = 30
_MOST_PAIRS: Final = 2000
# Given poses go with the photographs where half of them are nearer than these shares.
_OF_THE_WAY: Final = 0.1
_MOST_RAD: Final = 0.05
# Another way to read a table is taken for the right one where it is nearer by so much.
_CLEARLY: Final = 0.2
# With how many photographs the others are compared, where boards look the same after half a turn; and how often they
# are then turned back by where the hand is.
_FIRSTS, _TURNED_BACK = 6, 4


def hand_start(kind: type[Motion], seen: Seen, half_turn_mm: Float[np.ndarray, "2"] | None) -> tuple[Fit, Seen]:
    """Where K and the boards are, roughly; and the photographs, each board that is turned by half a turn turned back.

    Args:
        kind: what moves.
        seen: the photographs.
        half_turn_mm: the middle of a board that looks the same after half a turn; None for one that does not.

    Raises:
        InputError: the poses do not go with the photographs; a usual mistake is named where there is one.
    """
    if half_turn_mm is None:
        fit = _start(kind, seen)
    else:
        fit, seen = _either_way_round(kind, seen, half_turn_mm)
    if (off := _off(kind, seen, fit)) <= 1.0:
        return fit, seen
    for words, given in (*misread(seen.given), transposed(seen.given)):
        as_meant = replace(seen, given=given)
        if _off(kind, as_meant, _start(kind, as_meant)) < _CLEARLY * min(off, 1 / _CLEARLY):
            raise InputError(f"the given poses do not fit the photographs, but they do {words}")
    mm, angle = median_lengths(fit.errors(kind, seen))
    raise InputError(
        f"the given poses do not fit the photographs: half of them are {mm:.3g} mm or {np.degrees(angle):.2g}° "
        "off or more: check that each name in the table is that of the photograph taken at this pose, that the board "
        "stayed where it was mounted, and that its squares have the size that [board] says"
    )


def _off(kind: type[Motion], seen: Seen, fit: Fit) -> float:
    """How far half of the poses are off, in parts of what is taken for a mistake."""
    mm, angle = median_lengths(fit.errors(kind, seen))
    way = float(np.linalg.norm(np.ptp(seen.boards.translation, axis=0))) + 1e-9
    return float(max(mm / (_OF_THE_WAY * way), angle / _MOST_RAD))


def _start(kind: type[Motion], seen: Seen) -> Fit:
    """The best of the rotations that the turns allow."""
    behind = kind.carry(seen.given)
    pairs = _pairs(seen)
    a, b = (_turns(pose.matrix(), pairs) for pose in (seen.boards, behind))
    spread = np.sqrt(np.linalg.eigvalsh(b.T @ b / max(len(b), 1)))
    if spread[1] > _A_TURN:
        rotations = [_aligned(a, b)]
    elif spread[2] > _A_TURN:
        first, axis = _aligned(a, b), np.linalg.svd(b)[2][0]
        turns = Rotation.from_rotvec(np.outer(2 * np.pi * np.arange(_ANGLES) / _ANGLES, axis)).as_matrix()
        rotations = [first @ turn for turn in turns]
    else:
        i, j = pairs
        rotations = [_aligned(*(pose.translation[i] - pose.translation[j] for pose in (seen.boards, behind)))]
    fits = [_placed(R, seen, behind) for R in rotations]
    return min(fits, key=lambda fit: _off(kind, seen, fit))


def _pairs(seen: Seen) -> tuple[np.ndarray, np.ndarray]:
    """Photographs of one mounting, two by two; of many those that are evenly apart."""
    i, j = np.triu_indices(len(seen.session), 1)
    same = seen.session[i] == seen.session[j]
    i, j = i[same], j[same]
    some = slice(None, None, -(-len(i) // _MOST_PAIRS) or 1)
    return i[some], j[some]


def _turns(R: Float[np.ndarray, "photographs 3 3"], pairs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    i, j = pairs
    return matrix_to_vector(R[i] @ R[j].swapaxes(-1, -2))


def _aligned(a: Float[np.ndarray, "pairs 3"], b: Float[np.ndarray, "pairs 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation that takes b to a, of least absolute distances."""
    R, weights = np.eye(3), np.ones(len(a))
    for _ in range(_ROUNDS):
        u, _, vt = np.linalg.svd((weights[:, None] * a).T @ b)
        R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        distance = np.linalg.norm(a - b @ R.T, axis=1)
        weights = 1 / np.maximum(distance, np.median(distance) + 1e-12)
    return R


def _placed(R: Float[np.ndarray, "3 3"], seen: Seen, behind: Pose[np.ndarray]) -> Fit:
    """The offset and the boards for one rotation of K: t_i = R (R_gi t_B + t_gi + offset), linear in both."""
    count = int(seen.session.max()) + 1
    Rg = behind.matrix()
    A = np.zeros((len(Rg), 3, 3 + 3 * count))
    A[:, :, :3] = np.eye(3)
    for i, session in enumerate(seen.session):
        A[i, :, 3 + 3 * session : 6 + 3 * session] = Rg[i]
    y = seen.boards.translation @ R - behind.translation
    weights, found = np.ones(len(A)), np.zeros(A.shape[2])
    for _ in range(_ROUNDS):
        found = np.linalg.lstsq((A * weights[:, None, None]).reshape(-1, A.shape[2]), (y * weights[:, None]).ravel())[0]
        distance = np.linalg.norm(y - A @ found, axis=1)
        weights = np.maximum(distance, np.median(distance) + 1e-9) ** -0.5
        weights /= weights.max()
    mounted = matrix_to_vector(Rg.swapaxes(-1, -2) @ R.T @ seen.boards.matrix())
    turned = np.stack([usual_rotation(mounted[seen.session == k]) for k in range(count)])
    return Fit(R, found[:3], vector_to_matrix(turned), found[3:].reshape(-1, 3))


def _either_way_round(kind: type[Motion], seen: Seen, middle_mm: Float[np.ndarray, "2"]) -> tuple[Fit, Seen]:
    """The start of photographs whose boards may each be turned by half a turn, and these turned as they were.

    The angle by which the hand turned from one photograph to another says so, unless it is a right one. So all are
    compared with one of each session, and then, once K is found, with where the hand was; and that from several.
    """
    other, found = _half_turned(seen, middle_mm), []
    for share in np.arange(_FIRSTS) / _FIRSTS:
        tried, spare = _exchanged(seen, other, _turned_otherwise(seen, other, share))
        fit = _start(kind, tried)
        for _ in range(_TURNED_BACK):
            off, otherwise = (np.linalg.norm(fit.errors(kind, each)[:, 3:], axis=1) for each in (tried, spare))
            if not (otherwise < off).any():
                break
            tried, spare = _exchanged(tried, spare, otherwise < off)
            fit = _start(kind, tried)
        found.append((_off(kind, tried, fit), fit, tried))
    _, fit, tried = min(found, key=lambda each: each[0])
    return fit, tried


def _half_turned(seen: Seen, middle_mm: Float[np.ndarray, "2"]) -> Seen:
    """The same with each board turned by half a turn about its middle."""
    boards = seen.boards @ Pose(np.array([0.0, 0.0, np.pi]), np.array([*(2 * middle_mm), 0.0]))
    # The place of the other corner moves with the turn of the board too.
    by = boards.translation - seen.boards.translation
    J = np.tile(np.eye(6), (len(by), 1, 1))
    J[:, 3:, :3] = np.cross(np.eye(3)[None], by[:, None]).swapaxes(-1, -2)
    return replace(
        seen,
        boards=boards,
        covariance=J @ seen.covariance @ J.swapaxes(-1, -2),
        by_camera=J @ seen.by_camera,
    )


def _exchanged(one: Seen, other: Seen, which: Bool[np.ndarray, "photographs"]) -> tuple[Seen, Seen]:
    """Two readings of the same boards, some of them exchanged."""

    def mixed(a: Seen, b: Seen) -> Seen:
        def some(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.where(which.reshape(-1, *[1] * (x.ndim - 1)), y, x)

        return replace(
            a,
            boards=Pose(some(a.boards.rotation, b.boards.rotation), some(a.boards.translation, b.boards.translation)),
            covariance=some(a.covariance, b.covariance),
            by_camera=some(a.by_camera, b.by_camera),
        )

    return mixed(one, other), mixed(other, one)


def _turned_otherwise(seen: Seen, other: Seen, share: float) -> Bool[np.ndarray, "photographs"]:
    """Which boards turned as far as the hand did, from one of their session, if they are read the other way round.

    Args:
        seen: the photographs.
        other: the same with all boards the other way round.
        share: of its session that comes before the one with which the others are compared.
    """
    own = [np.flatnonzero(seen.session == session) for session in seen.session]
    first = np.array([each[int(share * len(each))] for each in own])

    def turned(R: Float[np.ndarray, "photographs 3 3"], of: Float[np.ndarray, "photographs 3 3"]) -> np.ndarray:
        return np.linalg.norm(matrix_to_vector(R @ of[first].swapaxes(-1, -2)), axis=1)

    G, R = seen.given.matrix(), seen.boards.matrix()
    hand = turned(G, G)
    return np.abs(turned(other.boards.matrix(), R) - hand) < np.abs(turned(R, R) - hand)
