"""Where the board that an axis moved really stood in each photograph, against the motion that was fitted to all.

The corner errors e of one photograph and the derivative J of its corners by a small displacement δt and rotation δr of
the board about its middle give the board's own place to first order: δ = −(JᵀJ)⁻¹ Jᵀ e, with covariance
σ² (JᵀJ)⁻¹. Displacement is taken with the rotation held, which knows it much better.

A board that stood elsewhere as a whole has many corners that the solve left out. So all that were seen are asked, but
for those that are off by themselves.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.observations import BoardSequence
from jaxscan.calibration.result import Calibration, PhotographFit
from jaxscan.geometry import Pose
from jaxscan.rig.projection import project_points

FEWEST_CORNERS = 4
# Corners beyond this number of σ from their photograph, at its own pose, are ignored; number of rounds.
_LIMIT, _ROUNDS = 4.5, 3
# Of the length of a vector of two normal numbers, in σ of one.
_MEDIAN_LENGTH = 1.1774


@dataclass(frozen=True)
class OwnPlaces:
    """For each photograph of a sequence: real place minus fitted (mm), and real turn minus fitted (radians).

    Attributes:
        index: of the sequence among the observations'.
        names: of the photographs.
        sequence: those photographs of it that determine where their board was.
        corners: where the fitted motion has their corners, camera frame, mm.
        used: which corners told.
        moved: displacement of the middle of the board, camera frame.
        moved_covariance: of that.
        turned: rotation vector.
        turned_covariance: of that.
    """

    index: int
    names: tuple[str, ...]
    sequence: BoardSequence
    corners: Float[np.ndarray, "images corners 3"]
    used: Bool[np.ndarray, "images corners"]
    moved: Float[np.ndarray, "images 3"]
    moved_covariance: Float[np.ndarray, "images 3 3"]
    turned: Float[np.ndarray, "images 3"]
    turned_covariance: Float[np.ndarray, "images 3 3"]


def own_places(calibration: Calibration) -> list[OwnPlaces]:
    """Sequence by sequence, of those photographs that show four corners and more; two of them at least."""
    points, at, found = calibration.observations.board.points(), 0, []
    for i, whole in enumerate(calibration.observations.sequences):
        fits = calibration.moved_fits[at : at + len(whole.views)]
        at += len(whole.views)
        seen = [_seen(fit) for fit in fits]
        told = [j for j, mask in enumerate(seen) if mask.sum() >= FEWEST_CORNERS]
        if len(told) < 2:
            continue
        sequence = whole.only(told)
        X = _corners_in_space(calibration, i, sequence, points)
        J = project_points(calibration.rig.camera, X.reshape(-1, 3)).by_point.reshape(*X.shape[:2], 2, 3)
        each = [_own_place(fits[j], seen[j], J[k], X[k]) for k, j in enumerate(told)]
        used, *places = (np.stack(part) for part in zip(*each, strict=True))
        found.append(OwnPlaces(i, tuple(fits[j].name for j in told), sequence, X, used, *places))
    return found


def _seen(fit: PhotographFit) -> Bool[np.ndarray, "corners"]:
    return np.isfinite(fit.corner_errors).all(axis=1) & np.isfinite(fit.corner_sigmas)


def _corners_in_space(
    calibration: Calibration, index: int, sequence: BoardSequence, points: Float[np.ndarray, "corners 3"]
) -> Float[np.ndarray, "images corners 3"]:
    """Where the corners stand in the camera frame by the rig, photograph by photograph of a sequence (mm)."""
    at_0 = Pose.from_vector(np.asarray(calibration.system.moved.as_vector())[index])
    return calibration.rig.pose(sequence.positions).apply(at_0.apply(points))


def _own_place(
    fit: PhotographFit,
    used: Bool[np.ndarray, "corners"],
    J: Float[np.ndarray, "corners 2 3"],
    X: Float[np.ndarray, "corners 3"],
) -> tuple[np.ndarray, ...]:
    """Which corners told; displacement (mm) with its covariance, and rotation (radians) with its covariance."""
    arm = X - X.mean(axis=0)
    by_place = np.concatenate([place_by_turn(J, arm), J], axis=2)
    errors = fit.corner_errors
    place = np.zeros(6)
    for i in range(_ROUNDS):
        left = errors + by_place @ place if i else errors - np.median(errors[used], axis=0)
        far = np.linalg.norm(left, axis=1) / fit.corner_sigmas
        usual = max(float(np.median(far[used])) / _MEDIAN_LENGTH, 1.0)
        with np.errstate(invalid="ignore"):
            near = used & (far <= _LIMIT * usual)
        if near.sum() < FEWEST_CORNERS:
            break
        used = near
        weight = 1 / fit.corner_sigmas[used][:, None]
        e = (errors[used] * weight).ravel()
        both = (by_place[used] * weight[..., None]).reshape(-1, 6)
        C_both = np.linalg.inv(both.T @ both)
        place = -C_both @ both.T @ e
    weight = 1 / fit.corner_sigmas[used][:, None]
    e = (errors[used] * weight).ravel()
    shift = (J[used] * weight[..., None]).reshape(-1, 3)
    both = (by_place[used] * weight[..., None]).reshape(-1, 6)
    C_shift, C_both = np.linalg.inv(shift.T @ shift), np.linalg.inv(both.T @ both)
    return used, -C_shift @ shift.T @ e, C_shift, (-C_both @ both.T @ e)[:3], C_both[:3, :3]


def place_by_turn(
    J: Float[np.ndarray, "corners 2 3"], arm: Float[np.ndarray, "corners 3"]
) -> Float[np.ndarray, "corners 2 3"]:
    """How corners move in the image with a rotation δr about what their arms begin at.

    δX = δr × arm, so ∂X/∂δr is −[arm]×, whose columns are e_i × arm.
    """
    return J @ np.stack([np.cross(e, arm) for e in np.eye(3)], axis=-1)


def axes_along(way: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Along travel or axis, across it and as nearly parallel to the image as can be, and the third."""
    direction = way / np.linalg.norm(way)
    across = np.cross(direction, [0.0, 0.0, 1.0])
    if np.linalg.norm(across) < 1e-6:
        across = np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    return np.stack([direction, across, np.cross(direction, across)])


def sigmas_along(
    axes: Float[np.ndarray, "3 3"], covariances: Float[np.ndarray, "images 3 3"]
) -> Float[np.ndarray, "images 3"]:
    """σ along some axes."""
    return np.sqrt(np.diagonal(axes @ covariances @ axes.T, axis1=1, axis2=2))
