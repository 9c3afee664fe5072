"""Where the poses of a calibration were: poses of a scan that are nowhere near are read in another way than these."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from jaxscan.geometry import Pose

# Poses are near others if half of them are no farther outside their box than this many of its diagonals, and turned by
# no more than this beyond them, rad.
_DIAGONALS: Final = 1.0
_BEYOND_RAD: Final = 0.8
# A hand that goes over less than this share of that diagonal stands still: its positions may be in metres.
_STILL: Final = 1 / 200


@dataclass(frozen=True)
class PoseRange:
    """The range of given poses T_base_hand.

    Attributes:
        least_mm: smallest x, y, z.
        most_mm: largest x, y, z.
        turn: rotation vector of the mean rotation, rad.
        within_rad: how far the others are turned from it at the most.
    """

    least_mm: Sequence[float]
    most_mm: Sequence[float]
    turn: Sequence[float]
    within_rad: float

    @classmethod
    def of(cls, poses: Pose[np.ndarray]) -> "PoseRange":
        """That of a stack of poses."""
        from scipy.spatial.transform import Rotation

        mean = Rotation.from_rotvec(poses.rotation).mean()
        turned = (mean.inv() * Rotation.from_rotvec(poses.rotation)).magnitude()
        places = poses.translation
        return cls(places.min(axis=0).tolist(), places.max(axis=0).tolist(), mean.as_rotvec().tolist(), turned.max())

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> "PoseRange":
        """The inverse of `values`."""
        return cls(values["least_mm"], values["most_mm"], values["turn"], values["within_rad"])

    def values(self) -> dict[str, object]:
        """As a rig file has it."""
        return {
            "least_mm": list(self.least_mm),
            "most_mm": list(self.most_mm),
            "turn": list(self.turn),
            "within_rad": float(self.within_rad),
        }

    def is_near(self, poses: Pose[np.ndarray]) -> bool:
        """Whether half of some poses are near these."""
        from scipy.spatial.transform import Rotation

        least, most = np.array(self.least_mm), np.array(self.most_mm)
        outside = np.maximum(np.maximum(least - poses.translation, poses.translation - most), 0)
        turned = (Rotation.from_rotvec(np.array(self.turn)).inv() * Rotation.from_rotvec(poses.rotation)).magnitude()
        near = np.median(np.linalg.norm(outside, axis=1)) <= _DIAGONALS * self._diagonal
        return bool(near and np.median(turned) <= self.within_rad + _BEYOND_RAD)

    def is_still(self, poses: Pose[np.ndarray]) -> bool:
        """Whether a hand goes over next to nothing of this range."""
        return bool(np.linalg.norm(np.ptp(poses.translation, axis=0)) < _STILL * self._diagonal)

    @property
    def _diagonal(self) -> float:
        return float(np.linalg.norm(np.subtract(self.most_mm, self.least_mm)))
