"""Where the board on stage and turntable really stood, against the one line or the one turn that was fitted to all.

For the stage that is straightness and step errors, for the turntable wobble and errors of its angle.

The corner errors e of one photograph and the derivative J of its corners by a small displacement δt and rotation δr of
the board about its middle give the board's own place to first order: δ = −(JᵀJ)⁻¹ Jᵀ e, with covariance
σ² (JᵀJ)⁻¹. Displacement is taken with the rotation held, which knows it much better.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.observations import BoardSequence
from jaxscan.calibration.result import Calibration, PhotographFit
from jaxscan.geometry import Pose
from jaxscan.rig import Linear, Rotary
from jaxscan.rig.projection import project_points


@dataclass(frozen=True)
class StageErrors:
    """One sequence of photographs of the board on the stage.

    Attributes:
        names: of the photographs.
        steps: their step counts.
        travel_mm: of each along the line, from the first step count.
        error_mm: of each, real place minus line: along the travel, across it parallel to the image as far as that goes,
            and at right angles to both.
        sigma_mm: of these.
        rotation_mrad: of each about the camera's axes against the sequence's one rotation.
        rotation_sigma_mrad: of these.
    """

    names: tuple[str, ...]
    steps: Float[np.ndarray, "images"]
    travel_mm: Float[np.ndarray, "images"]
    error_mm: Float[np.ndarray, "images 3"]
    sigma_mm: Float[np.ndarray, "images 3"]
    rotation_mrad: Float[np.ndarray, "images 3"]
    rotation_sigma_mrad: Float[np.ndarray, "images 3"]

    @property
    def chi2_along(self) -> float:
        """Mean square of the step errors in σ; about 1 for a stage without any."""
        return float(np.mean((self.error_mm[:, 0] / self.sigma_mm[:, 0]) ** 2))

    @property
    def chi2_across(self) -> float:
        """Mean square of the errors across the travel in σ."""
        return float(np.mean((self.error_mm[:, 1:] / self.sigma_mm[:, 1:]) ** 2))


@dataclass(frozen=True)
class TurntableErrors:
    """One sequence of photographs of the board on the turntable.

    Attributes:
        names: of the photographs.
        steps: the turntable's step counts.
        turn_deg: of each about the axis, from the first step count.
        turn_error_deg: of each, real turn minus fitted: about the axis, and by how much the axis is tilted towards two
            directions across it, its wobble.
        turn_sigma_deg: of these.
        error_mm: of the board's middle, real place minus fitted: along the axis and in the same two directions.
        sigma_mm: of these.
    """

    names: tuple[str, ...]
    steps: Float[np.ndarray, "images"]
    turn_deg: Float[np.ndarray, "images"]
    turn_error_deg: Float[np.ndarray, "images 3"]
    turn_sigma_deg: Float[np.ndarray, "images 3"]
    error_mm: Float[np.ndarray, "images 3"]
    sigma_mm: Float[np.ndarray, "images 3"]

    @property
    def chi2_turn(self) -> float:
        """Mean square of the errors of the angle in σ; about 1 for a turntable without any."""
        return float(np.mean((self.turn_error_deg[:, 0] / self.turn_sigma_deg[:, 0]) ** 2))

    @property
    def chi2_wobble(self) -> float:
        """Mean square of all other errors in σ: the axis tilts or wanders."""
        turned, moved = self.turn_error_deg[:, 1:] / self.turn_sigma_deg[:, 1:], self.error_mm / self.sigma_mm
        return float(np.mean(np.concatenate([turned, moved], axis=1) ** 2))


def stage_errors(calibration: Calibration) -> tuple[StageErrors, ...]:
    """Each sequence along a line; photographs with fewer than four corners that took part are left out."""
    out = []
    for fits, sequence, places in _own_places(calibration):
        if isinstance(line := calibration.rig.axis(sequence.axis), Linear):
            axes, first = _axes(line.direction()), sequence.steps.min()
            out.append(
                StageErrors(
                    names=tuple(fit.name for fit in fits),
                    steps=sequence.steps,
                    travel_mm=(sequence.steps - first) * line.amount(1.0)[0],
                    error_mm=places.moved @ axes.T,
                    sigma_mm=_sigmas(axes, places.moved_covariance),
                    rotation_mrad=1e3 * places.turned,
                    rotation_sigma_mrad=1e3 * _sigmas(np.eye(3), places.turned_covariance),
                )
            )
    return tuple(out)


def turntable_errors(calibration: Calibration) -> tuple[TurntableErrors, ...]:
    """Each sequence about an axis; photographs with fewer than four corners that took part are left out."""
    out = []
    for fits, sequence, places in _own_places(calibration):
        if isinstance(turn := calibration.rig.axis(sequence.axis), Rotary):
            axes, first = _axes(turn.direction()), sequence.steps.min()
            # A small turn δr tilts the first axis towards the others by δr · (third) and −δr · (second).
            tilts = np.stack([axes[0], axes[2], -axes[1]])
            out.append(
                TurntableErrors(
                    names=tuple(fit.name for fit in fits),
                    steps=sequence.steps,
                    turn_deg=(sequence.steps - first) * turn.amount(1.0)[0],
                    turn_error_deg=np.degrees(places.turned @ tilts.T),
                    turn_sigma_deg=np.degrees(_sigmas(tilts, places.turned_covariance)),
                    error_mm=places.moved @ axes.T,
                    sigma_mm=_sigmas(axes, places.moved_covariance),
                )
            )
    return tuple(out)


@dataclass(frozen=True)
class _Places:
    """Of each photograph, real place minus fitted (mm, camera frame) and real turn minus fitted (radians)."""

    moved: Float[np.ndarray, "images 3"]
    moved_covariance: Float[np.ndarray, "images 3 3"]
    turned: Float[np.ndarray, "images 3"]
    turned_covariance: Float[np.ndarray, "images 3 3"]


def _own_places(calibration: Calibration) -> list[tuple[list[PhotographFit], BoardSequence, _Places]]:
    """Sequence by sequence, those photographs of it that tell where their board stood."""
    points, at, found = calibration.observations.board.points(), 0, []
    for i, whole in enumerate(calibration.observations.sequences):
        fits = calibration.moved_fits[at : at + len(whole.views)]
        at += len(whole.views)
        used = [j for j, fit in enumerate(fits) if fit.corner_kept.sum() >= 4]
        if len(used) < 2:
            continue
        sequence = whole.only(used)
        X = _corners_in_space(calibration, i, sequence, points)
        J = project_points(calibration.rig.camera, X.reshape(-1, 3)).by_point.reshape(*X.shape[:2], 2, 3)
        each = [_own_place(fits[j], J[k], X[k]) for k, j in enumerate(used)]
        places = _Places(*(np.stack(part) for part in zip(*each, strict=True)))
        found.append(([fits[j] for j in used], sequence, places))
    return found


def _corners_in_space(
    calibration: Calibration, index: int, sequence: BoardSequence, points: Float[np.ndarray, "corners 3"]
) -> Float[np.ndarray, "images corners 3"]:
    """Where the corners stand in the camera frame by the rig, photograph by photograph of a sequence (mm)."""
    at_0 = Pose.from_vector(np.asarray(calibration.system.moved.as_vector())[index])
    return calibration.rig.pose(sequence.positions).apply(at_0.apply(points))


def _sigmas(
    axes: Float[np.ndarray, "3 3"], covariances: Float[np.ndarray, "images 3 3"]
) -> Float[np.ndarray, "images 3"]:
    return np.sqrt(np.diagonal(axes @ covariances @ axes.T, axis1=1, axis2=2))


def _axes(along: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Along travel or axis, across it and as nearly parallel to the image as can be, and the third."""
    direction = along / np.linalg.norm(along)
    across = np.cross(direction, [0.0, 0.0, 1.0])
    if np.linalg.norm(across) < 1e-6:
        across = np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    return np.stack([direction, across, np.cross(direction, across)])


def _own_place(
    fit: PhotographFit, J: Float[np.ndarray, "corners 2 3"], X: Float[np.ndarray, "corners 3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Displacement (mm) with its covariance, and rotation (rad) with its covariance."""
    kept = fit.corner_kept
    arm = X[kept] - X.mean(axis=0)
    # δX = δr × arm + δt, so ∂X/∂δr is −[arm]×, whose columns are e_i × arm.
    turn = np.stack([np.cross(e, arm) for e in np.eye(3)], axis=-1)
    weight = 1 / fit.corner_sigmas[kept][:, None]
    e = (fit.corner_errors[kept] * weight).ravel()
    shift = (J[kept] * weight[..., None]).reshape(-1, 3)
    both = np.concatenate([(J[kept] @ turn * weight[..., None]).reshape(-1, 3), shift], axis=1)
    C_shift, C_both = np.linalg.inv(shift.T @ shift), np.linalg.inv(both.T @ both)
    return -C_shift @ shift.T @ e, C_shift, (-C_both @ both.T @ e)[:3], C_both[:3, :3]
