"""What is said of a turntable: its axis, angle for each step and place, each with its σ."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.rig.covariance import Covariance
from jaxscan.rig.rotary import Rotary


@dataclass(frozen=True)
class TurnSummary:
    """A turntable in a person's numbers. A σ is None where there is no covariance.

    Attributes:
        axis_direction: of the axis, a unit vector; turned about it by the right hand's rule as the step count rises.
        axis_sigma_deg: σ of that direction, in the direction in which it is largest.
        degrees_per_step: the angle of one motor step.
        degrees_per_step_sigma: its σ.
        steps_per_turn: motor steps for a full turn.
        through_mm: the point of the axis that is nearest to where things are scanned.
        through_sigma_mm: its σ at right angles to the axis, in the direction in which it is largest.
        way: how what stands on it goes as the step count rises, as the camera sees it, in words.
    """

    axis_direction: tuple[float, ...]
    axis_sigma_deg: float | None
    degrees_per_step: float
    degrees_per_step_sigma: float | None
    steps_per_turn: float
    through_mm: tuple[float, ...]
    through_sigma_mm: float | None
    way: str


def turn_summary(turntable: Rotary, covariance: Covariance | None, near: Float[np.ndarray, "3"]) -> TurnSummary:
    """What is said of a turntable.

    At c + s u, u the unit axis, the axis stands off by P (δc + s δu) with P = I − u uᵀ.

    Args:
        turntable: the turntable.
        covariance: of the rig's parameters, where it is known.
        near: where things are scanned, mm.
    """
    w, c = (np.array([float(x) for x in part]) for part in (turntable.per_step, turntable.centre))
    angle = float(np.linalg.norm(w))
    u, known = w / angle, _known(turntable.axis, covariance)
    s = float(u @ (near - c))
    sigmas: list[float | None] = [None] * 3
    if known is not None:
        P = np.eye(3) - np.outer(u, u)
        of_u, of_c = P @ known[:3, :3] @ P / angle**2, P @ known[3:, 3:] @ P
        both = P @ known[3:, :3] @ P / angle
        of_place = of_c + s * (both + both.T) + s**2 * of_u
        sigmas = [
            float(np.degrees(np.sqrt(np.linalg.eigvalsh(of_u)[-1]))),
            float(np.degrees(np.sqrt(u @ known[:3, :3] @ u))),
            float(np.sqrt(np.linalg.eigvalsh(of_place)[-1])),
        ]
    return TurnSummary(
        axis_direction=tuple(u.tolist()),
        axis_sigma_deg=sigmas[0],
        degrees_per_step=float(np.degrees(angle)),
        degrees_per_step_sigma=sigmas[1],
        steps_per_turn=2 * np.pi / angle,
        through_mm=tuple((c + s * u).tolist()),
        through_sigma_mm=sigmas[2],
        way=turntable.way(),
    )


def _known(axis: str, covariance: Covariance | None) -> Float[np.ndarray, "6 6"] | None:
    """The covariance of the six numbers, where it is known."""
    names = [f"motion.{axis}.{part}.{i}" for part in ("per_step", "centre") for i in range(3)]
    return None if covariance is None else covariance.among(names)
