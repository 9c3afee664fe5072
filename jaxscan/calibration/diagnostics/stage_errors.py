"""Errors of stage and turntable: where the board really stood, against the one line or turn that was fitted to all.

For the stage that is straightness and step errors, for the turntable wobble and errors of its angle.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.own_places import axes_along, own_places, sigmas_along
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.stage_order import about_a_line
from jaxscan.rig import Rotary
from jaxscan.rig.line import Line


@dataclass(frozen=True)
class StageErrors:
    """One sequence of photographs of the board on the stage.

    Attributes:
        axis: the name of the stage.
        names: of the photographs.
        steps: their step counts.
        travel_mm: of each along the line, from the first step count.
        error_mm: of each, real place minus fitted: along the travel, across it parallel to the image as far as that
            goes, and at right angles to both.
        sigma_mm: of these.
        rotation_mrad: of each about the camera's axes against the sequence's one rotation.
        rotation_sigma_mrad: of these.
    """

    axis: str
    names: tuple[str, ...]
    steps: Float[np.ndarray, "images"]
    travel_mm: Float[np.ndarray, "images"]
    error_mm: Float[np.ndarray, "images 3"]
    sigma_mm: Float[np.ndarray, "images 3"]
    rotation_mrad: Float[np.ndarray, "images 3"]
    rotation_sigma_mrad: Float[np.ndarray, "images 3"]

    def without(self, names: Collection[str]) -> "StageErrors":
        """Those of the other photographs, about the line that these make."""
        if not (gone := np.isin(self.names, list(names))).any():
            return self
        error = about_a_line(self.steps[~gone], self.error_mm[~gone], self.sigma_mm[~gone])
        left = {each: getattr(self, each)[~gone] for each in _OF_STAGE}
        return replace(self, **left, names=tuple(np.array(self.names)[~gone].tolist()), error_mm=error)

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

    def without(self, names: Collection[str]) -> "TurntableErrors":
        """Those of the other photographs, about the turn that these make."""
        if not (gone := np.isin(self.names, list(names))).any():
            return self
        left = {each: getattr(self, each)[~gone] for each in _OF_TURNTABLE}
        turned = about_a_line(self.steps[~gone], self.turn_error_deg[~gone], self.turn_sigma_deg[~gone])
        moved = about_a_line(self.steps[~gone], self.error_mm[~gone], self.sigma_mm[~gone])
        kept = tuple(np.array(self.names)[~gone].tolist())
        return replace(self, **left, names=kept, turn_error_deg=turned, error_mm=moved)

    @property
    def chi2_turn(self) -> float:
        """Mean square of the errors of the angle in σ; about 1 for a turntable without any."""
        return float(np.mean((self.turn_error_deg[:, 0] / self.turn_sigma_deg[:, 0]) ** 2))

    @property
    def chi2_wobble(self) -> float:
        """Mean square of all other errors in σ: the axis tilts or wanders."""
        turned, moved = self.turn_error_deg[:, 1:] / self.turn_sigma_deg[:, 1:], self.error_mm / self.sigma_mm
        return float(np.mean(np.concatenate([turned, moved], axis=1) ** 2))


# What of each photograph stays as it is where others are left out.
_OF_STAGE = ("steps", "travel_mm", "sigma_mm", "rotation_mrad", "rotation_sigma_mrad")
_OF_TURNTABLE = ("steps", "turn_deg", "turn_sigma_deg", "sigma_mm")


def stage_errors(calibration: Calibration) -> tuple[StageErrors, ...]:
    """Each sequence along a line; photographs with fewer than four corners that took part are left out."""
    out = []
    for places in own_places(calibration):
        sequence = places.sequence
        if isinstance(line := calibration.rig.axis(sequence.axis), Line):
            axes, first = axes_along(line.direction()), sequence.steps.min()
            out.append(
                StageErrors(
                    axis=sequence.axis,
                    names=places.names,
                    steps=sequence.steps,
                    travel_mm=(sequence.steps - first) * line.amount(1.0)[0],
                    error_mm=places.moved @ axes.T,
                    sigma_mm=sigmas_along(axes, places.moved_covariance),
                    rotation_mrad=1e3 * places.turned,
                    rotation_sigma_mrad=1e3 * sigmas_along(np.eye(3), places.turned_covariance),
                )
            )
    return tuple(out)


def turntable_errors(calibration: Calibration) -> tuple[TurntableErrors, ...]:
    """Each sequence about an axis; photographs with fewer than four corners that took part are left out."""
    out = []
    for places in own_places(calibration):
        sequence = places.sequence
        if isinstance(turn := calibration.rig.axis(sequence.axis), Rotary):
            axes, first = axes_along(turn.direction()), sequence.steps.min()
            # A small turn δr tilts the first axis towards the others by δr · (third) and −δr · (second).
            tilts = np.stack([axes[0], axes[2], -axes[1]])
            out.append(
                TurntableErrors(
                    names=places.names,
                    steps=sequence.steps,
                    turn_deg=(sequence.steps - first) * turn.amount(1.0)[0],
                    turn_error_deg=np.degrees(places.turned @ tilts.T),
                    turn_sigma_deg=np.degrees(sigmas_along(tilts, places.turned_covariance)),
                    error_mm=places.moved @ axes.T,
                    sigma_mm=sigmas_along(axes, places.moved_covariance),
                )
            )
    return tuple(out)
