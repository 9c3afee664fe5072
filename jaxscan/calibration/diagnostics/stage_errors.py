"""Straightness and step errors of the stage: where the board really stood, against t₀ + n · per_step.

The corner errors e of one photograph and the derivative J of its corners by a small displacement δt and rotation δr of
the board about its middle give the board's own place to first order: δ = −(JᵀJ)⁻¹ Jᵀ e, with covariance
σ² (JᵀJ)⁻¹. Displacement is taken with the rotation held, which knows it much better.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration.result import Calibration, PhotographFit
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Camera


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


def stage_errors(calibration: Calibration) -> tuple[StageErrors, ...]:
    """Each sequence; photographs with fewer than four corners that took part are left out."""
    rig, system = calibration.rig, calibration.system
    if rig.stage is None:
        return ()
    per_step = np.stack(rig.stage.per_step).astype(np.float64)
    direction = per_step / np.linalg.norm(per_step)
    points = calibration.observations.board.points()
    out, at = [], 0
    with float64():
        camera = as_float64(rig.camera)
        for i, sequence in enumerate(calibration.observations.stages):
            fits = calibration.stage_fits[at : at + len(sequence.views)]
            at += len(sequence.views)
            used = [j for j, fit in enumerate(fits) if fit.corner_kept.sum() >= 4]
            if len(used) < 2:
                continue
            R = np.asarray(as_float64(system).stage_board(i, jnp.zeros(())).matrix())
            still = points @ R.T + np.asarray(system.stages.translation[i])
            X = still[None] + sequence.steps[used, None, None] * per_step
            J = np.asarray(_point_jacobians(camera, jnp.asarray(X)))
            each = [_own_place(fits[j], J[k], X[k]) for k, j in enumerate(used)]
            axes = _axes(direction)
            out.append(
                StageErrors(
                    names=tuple(fits[j].name for j in used),
                    steps=sequence.steps[used],
                    travel_mm=(sequence.steps[used] - sequence.steps.min()) * float(np.linalg.norm(per_step)),
                    error_mm=np.stack([axes @ moved for moved, _, _, _ in each]),
                    sigma_mm=np.stack([np.sqrt(np.diagonal(axes @ C @ axes.T)) for _, C, _, _ in each]),
                    rotation_mrad=1e3 * np.stack([turned for _, _, turned, _ in each]),
                    rotation_sigma_mrad=1e3 * np.stack([np.sqrt(np.diagonal(C)) for _, _, _, C in each]),
                )
            )
    return tuple(out)


def _axes(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Along the travel, across it and as nearly parallel to the image as can be, and the third."""
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


@jax.jit
def _point_jacobians(camera: Camera, X: Float[Array, "images corners 3"]) -> Float[Array, "images corners 2 3"]:
    return jax.vmap(jax.vmap(jax.jacfwd(camera.project)))(X)
