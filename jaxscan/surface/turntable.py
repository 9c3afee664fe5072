"""The turntable that registered sides stood on: its axis and its angle for each step, from their poses.

A turntable at step n carries what stands on it by x ↦ exp(n w) (x − c) + c, so the side scanned then has
T_first_side(n) = turned(n₀) turned(n)⁻¹, n₀ the first one's step. w and c, c · w = 0, are those of least squares over
the small motions that take each pose to that, weighted by their covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import block_diag

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.geometry import Pose
from jaxscan.geometry.turn import axis_point, rate_of_turn
from jaxscan.kept_programs import compiled
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Covariance, Rig, Rotary
from jaxscan.rig.motion import normal_motion
from jaxscan.rig.rig import motion_normal_jacobian
from jaxscan.surface.register import Registration

_NAMES: Final = tuple(f"motion.turntable.{part}.{i}" for part, count in Rotary.numbers.items() for i in range(count))
_ROUNDS: Final = 20
# Where the axis stands is lost in turns of less than this between the sides, radians.
_LEAST_TURN: Final = 0.02


@dataclass(frozen=True)
class TurntableFit:
    """A calibrated turntable.

    Attributes:
        turntable: axis and angle, in the object frame.
        covariance: of its six numbers, of rank 5: the centre is the point nearest to the origin.
        misfit: root mean square of what is left of the poses, in units of their σ: 1 where they are a turntable's.
    """

    turntable: Rotary
    covariance: Covariance
    misfit: float

    def on(self, content: RigFile) -> RigFile:
        """A rig with this turntable; what is known of the rest does not depend on it."""
        rig = content.rig.with_axis(self.turntable)
        if content.covariance is None:
            return replace(content, rig=rig, covariance=self.covariance)
        kept = [i for i, name in enumerate(content.covariance.names) if name not in _NAMES]
        names = tuple(content.covariance.names[i] for i in kept) + _NAMES
        matrix = np.asarray(block_diag(content.covariance.matrix[np.ix_(kept, kept)], self.covariance.matrix))
        return replace(content, rig=rig, covariance=Covariance(names, matrix))


def fit_turntable(registration: Registration, steps: Sequence[float]) -> TurntableFit:
    """The turntable of registered sides.

    Args:
        registration: of two or more sides.
        steps: motor step count of each.

    Raises:
        InputError: the counts do not fit the sides, or the sides are not turned against each other.
    """
    n = np.asarray(steps, np.float64)
    if len(n) != len(registration.poses):
        raise InputError(f"{len(n)} step counts for {len(registration.poses)} scans: give one for each")
    theta, around = _first(registration, n)
    with float64():
        weight = np.linalg.cholesky(np.linalg.inv(registration.covariance)).T
        poses = Pose.from_vector(jnp.asarray(np.stack([T.as_vector() for T in registration.poses[1:]])))
        given = (poses, jnp.asarray(registration.centre), jnp.asarray(n[1:] - n[0]), jnp.asarray(around))
        for _ in range(_ROUNDS):
            r, J = (np.asarray(x) for x in _misfit(jnp.asarray(theta), *given))
            step = np.linalg.lstsq(weight @ J, -weight @ r, rcond=None)[0]
            theta = theta + step
            if np.abs(step[:3]).max() * np.abs(n - n[0]).max() < 1e-12 and np.abs(step[3:]).max() < 1e-9:
                break
        r, J = (np.asarray(x) for x in _misfit(jnp.asarray(theta), *given))
        found = Rotary.create(theta[:3], around.T @ theta[3:])
        turntable = as_numpy(normal_motion(found))
    whitened = weight @ r
    freedom = len(r) - 5
    misfit = float(np.sqrt(whitened @ whitened / freedom)) if freedom > 0 else 1.0
    full = np.zeros((6, 5))
    full[:3, :3], full[3:, 3:] = np.eye(3), around.T
    full = motion_normal_jacobian(found) @ full
    covariance = max(misfit, 1.0) ** 2 * full @ np.linalg.inv((weight @ J).T @ (weight @ J)) @ full.T
    return TurntableFit(turntable, Covariance(_NAMES, (covariance + covariance.T) / 2), misfit)


def turntable_of(rig: Rig) -> Rotary:
    """The axis of a rig about which its load turns.

    Raises:
        InputError: there is none, or more than one.
    """
    turns = [part for part in rig.motion.parts() if isinstance(part, Rotary)]
    if len(turns) != 1:
        has = f"{len(turns)} axes that turn" if turns else "no turntable"
        raise InputError(f"has {has}: find it with --fit-turntable, or give --turn")
    return turns[0]


def turntable_poses(turntable: Rotary, steps: Sequence[float]) -> list[Pose]:
    """T_first_side of sides scanned at these step counts."""
    with float64():
        turned = [as_numpy(turntable.pose({turntable.axis: np.float64(n)})) for n in steps]
    return [turned[0] @ T.inverse() for T in turned]


def _first(
    registration: Registration, steps: Float[np.ndarray, "sides"]
) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "2 3"]]:
    """A start: w, and c in the plane at right angles to it; the two axes of that plane."""
    stood = Pose.from_vector(np.stack([T.as_vector() for T in registration.poses])).inverse()
    apart = steps - steps[0]
    again = (np.diff(steps) == 0).any()
    w = np.zeros(3) if again else rate_of_turn(stood.matrix(), apart)
    if np.linalg.norm(w) * np.abs(np.diff(steps)).max() < _LEAST_TURN:
        raise InputError("the scans are not turned against each other: a turntable takes scans at different steps")
    c, _ = axis_point(stood.apply(registration.centre), apart, w)
    around = np.linalg.svd(w[None])[2][1:]
    return np.concatenate([w, around @ c]), around


@compiled()
def _misfit(
    theta: Float[Array, "5"],
    poses: Pose[Array],
    middle: Float[Array, "3"],
    steps: Float[Array, "sides"],
    around: Float[Array, "2 3"],
) -> tuple[Float[Array, "residuals"], Float[Array, "residuals 5"]]:
    """The small motions (radians about the middle, mm) from each pose to the turntable's, and their derivatives."""

    def motions(theta: Float[Array, "5"]) -> Float[Array, "residuals"]:
        w, c = theta[:3], around.T @ theta[3:]
        off = Pose.about(-jnp.outer(steps, w), c) @ poses.inverse()
        return jnp.concatenate([off.rotation, off.apply(middle) - middle[None]], axis=1).ravel()

    return motions(theta), jax.jacfwd(motions)(theta)
