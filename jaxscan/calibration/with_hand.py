"""A calibration whose camera, or object, is moved by given poses: what they say, joined to its rig."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.axis_details import POSES
from jaxscan.calibration.hand import FEWEST_POSES, Hand
from jaxscan.calibration.hand_eye import Fit, HandEye, Scale, Seen, hand_eye
from jaxscan.calibration.hand_start import hand_start
from jaxscan.calibration.result import Calibration
from jaxscan.errors import error_context
from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix
from jaxscan.precision import as_float64, as_numpy
from jaxscan.rig import CARRIED_BY, Covariance, HeadPoses, ObjectPoses, PoseRange, Rig

# Of a difference of rotation vectors, rad.
_STEP = 1e-6


def with_hand(result: Calibration) -> Calibration:
    """The calibration with the motion of the given poses and its covariance; itself where there are none.

    Raises:
        InputError: the poses do not go with the photographs, or do not show how camera and hand stand.
    """
    hand, views = result.observations.hand, result.observations.views
    posed = [i for i, view in enumerate(views) if view.given is not None]
    if hand is None or not posed:
        return result
    if len(posed) < FEWEST_POSES:
        said = f"{len(posed)} photographs at given poses do not show how camera and hand stand: the rig has no motion"
        still = Rig(result.rig.camera, result.rig.lights)
        return replace(_with_rig(result, still), notes=(*result.notes, said))
    kind, board = CARRIED_BY[hand.moves], result.observations.board
    half_turn = board.points()[:, :2].mean(axis=0) if board.half_turn_ambiguous else None
    known = hand.sigma_mm, None if hand.sigma_deg is None else float(np.radians(hand.sigma_deg))
    with error_context(hand.table) if hand.table else nullcontext():
        start, seen = hand_start(kind, _seen(result, posed), half_turn)
        found = hand_eye(kind, seen, start, known)
    fit = found.fit
    motion = as_numpy(as_float64(kind.create(matrix_to_vector(fit.rotation), fit.offset)))
    scale, scale_sigma = _scale(found.scale, result.covariance)
    placed = Hand(
        moves=hand.moves,
        names=tuple(views[i].name for i in posed),
        kept=found.kept,
        off_mm=found.errors[:, :3],
        off_deg=np.degrees(found.errors[:, 3:]),
        sigma_mm=float(found.sigma[0]),
        sigma_deg=float(np.degrees(found.sigma[1])),
        found_mm=float(found.found[0]),
        found_deg=float(np.degrees(found.found[1])),
        unknown=found.unknown,
        board_mm=_board_mm(kind, fit, seen, board.points().mean(axis=0)),
        given=(hand.sigma_mm, hand.sigma_deg),
        scale=scale,
        scale_sigma=scale_sigma,
        range=PoseRange.of(seen.only(found.kept).given),
    )
    rig = Rig(result.rig.camera, result.rig.lights, motion)
    return replace(
        _with_rig(result, rig),
        covariance=_joined(result.covariance, found, motion),
        formal_covariance=result.formal_covariance and _joined(result.formal_covariance, found, motion),
        rejected=(*result.rejected, *placed.rejected()),
        notes=(*result.notes, placed.note(), *placed.unknown_note()),
        warnings=(*result.warnings, *(f"{what}. {fix}".removesuffix(".") for what, fix in placed.statements)),
        hand=placed,
    )


def _with_rig(result: Calibration, rig: Rig) -> Calibration:
    return replace(result, rig=rig, system=eqx.tree_at(lambda system: system.rig, result.system, rig))


def _seen(result: Calibration, posed: Sequence[int]) -> Seen:
    """What the photographs at given poses show, by the calibration."""
    views = [result.observations.views[i] for i in posed]
    given = [view.given for view in views if view.given is not None]
    sessions = list(dict.fromkeys(view.session for view in views))
    boards = np.asarray(result.system.boards.as_vector(), np.float64)[posed]
    n = len(result.covariance.names)
    covariance, by_camera = [], []
    for i, pose in zip(posed, boards, strict=True):
        joint = result.board_covariances[i].matrix
        scale = np.sqrt(np.diagonal(joint)[:n])
        S = joint[:n, :n] / np.outer(scale, scale)
        moves = np.linalg.solve(S, joint[:n, n:] / scale[:, None]).T / scale if n else np.zeros((6, 0))
        J = np.eye(6)
        J[:3, :3] = _left_jacobian(pose[:3])
        own = joint[n:, n:] - moves @ joint[:n, n:]
        covariance.append(J @ (own + own.T) / 2 @ J.T)
        by_camera.append(J @ moves)
    return Seen(
        Pose(np.stack([pose.rotation for pose in given]), np.stack([pose.translation for pose in given])),
        Pose.from_vector(boards),
        np.array([sessions.index(view.session) for view in views]),
        np.stack(covariance),
        np.stack(by_camera),
    )


def _board_mm(kind: type[HeadPoses] | type[ObjectPoses], fit: Fit, seen: Seen, middle: Float[np.ndarray, "3"]) -> float:
    """The distance of the board's middle from the hand, in the median."""
    mounted = (fit.board_rotations @ middle + fit.board_places)[seen.session]
    at = kind.from_hand(seen.given, mounted[:, None])
    return float(np.median(np.linalg.norm(at[:, 0], axis=1)))


def _scale(scale: Scale, covariance: Covariance) -> tuple[float, float]:
    """The lengths of the given positions over those of the photographs, and σ of that."""
    variance = scale.sigma**2 + scale.by_camera @ covariance.matrix @ scale.by_camera
    factor = float(np.exp(scale.ln))
    return factor, factor * float(np.sqrt(variance))


def _joined(covariance: Covariance, found: HandEye, motion: HeadPoses | ObjectPoses) -> Covariance:
    """The covariance of a rig's parameters and of the motion's numbers."""
    # As the rotation vector has it.
    T = np.eye(6)
    T[:3, :3] = np.linalg.inv(_left_jacobian(matrix_to_vector(found.fit.rotation)))
    J = np.concatenate([np.eye(len(covariance.names)), T @ found.by_camera])
    matrix = J @ covariance.matrix @ J.T
    matrix[-6:, -6:] += T @ found.covariance @ T.T
    own = [f"motion.{POSES}.{name}.{i}" for name, count in motion.numbers.items() for i in range(count)]
    # An offset that is not found at all has no σ.
    names = (*covariance.names, *(own if len(found.unknown) < 3 else own[:3]))
    return Covariance(names, matrix[: len(names), : len(names)])


def _left_jacobian(rotation: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """How a rotation is turned, from the left (rad), for a change of its vector."""
    by = _STEP * np.eye(3)
    change = vector_to_matrix(rotation + by) @ vector_to_matrix(rotation - by).swapaxes(-1, -2)
    return matrix_to_vector(change).T / (2 * _STEP)
