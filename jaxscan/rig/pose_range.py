"""Where the poses of a calibration were: poses of a scan that are nowhere near are read in another way than these."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Pose

# Poses are near others if half of them are no farther outside their box than this many of its diagonals, and turned by
# no more than this from one of them, rad.
_DIAGONALS: Final = 0.5
_BEYOND_RAD: Final = 0.8
# Of those within these, nothing is said.
_USUAL_DIAGONALS, _USUAL_RAD = 0.25, 0.44
# A hand that goes over less than this share of that diagonal stands still: its positions may be in metres.
_STILL: Final = 1 / 200
# Rotations that are kept.
_MOST: Final = 100


@dataclass(frozen=True)
class PoseRange:
    """The range of given poses T_base_hand.

    Attributes:
        least_mm: smallest x, y, z.
        most_mm: largest x, y, z.
        turn: rotation vector of the mean rotation, rad.
        within_rad: how far the others are turned from it at the most.
        turns: rotation vectors of the poses themselves, of many of them some, rad; empty in rigs that have not kept
            them.
    """

    least_mm: Sequence[float]
    most_mm: Sequence[float]
    turn: Sequence[float]
    within_rad: float
    turns: Sequence[Sequence[float]] = ()

    @classmethod
    def of(cls, poses: Pose[np.ndarray]) -> "PoseRange":
        """That of a stack of poses."""
        from scipy.spatial.transform import Rotation

        mean = Rotation.from_rotvec(poses.rotation).mean()
        turned = (mean.inv() * Rotation.from_rotvec(poses.rotation)).magnitude()
        places = poses.translation
        some = poses.rotation[:: -(-len(poses.rotation) // _MOST)]
        return cls(
            least_mm=places.min(axis=0).tolist(),
            most_mm=places.max(axis=0).tolist(),
            turn=mean.as_rotvec().tolist(),
            within_rad=float(turned.max()),
            turns=some.tolist(),
        )

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> "PoseRange":
        """The inverse of `values`."""
        return cls(values["least_mm"], values["most_mm"], values["turn"], values["within_rad"], values.get("turns", ()))

    def values(self) -> dict[str, object]:
        """As a rig file has it."""
        return {
            "least_mm": list(self.least_mm),
            "most_mm": list(self.most_mm),
            "turn": list(self.turn),
            "within_rad": float(self.within_rad),
            "turns": [list(turn) for turn in self.turns],
        }

    def outside(self, poses: Pose[np.ndarray]) -> tuple[float, float]:
        """How far half of some poses are outside this range, at least: mm from its box, and rad from its rotations."""
        least, most = np.array(self.least_mm), np.array(self.most_mm)
        away = np.maximum(np.maximum(least - poses.translation, poses.translation - most), 0)
        return float(np.median(np.linalg.norm(away, axis=1))), float(np.median(self._turned(poses)))

    def _turned(self, poses: Pose[np.ndarray]) -> Float[np.ndarray, "poses"]:
        """How far each pose is turned from the nearest of these, rad."""
        from scipy.spatial.transform import Rotation

        given = Rotation.from_rotvec(poses.rotation)
        if not len(self.turns):
            turned = (Rotation.from_rotvec(np.array(self.turn)).inv() * given).magnitude()
            return np.maximum(turned - self.within_rad, 0.0)
        known = Rotation.from_rotvec(np.array(self.turns))
        return np.min([(one.inv() * given).magnitude() for one in known], axis=0)

    def is_near(self, poses: Pose[np.ndarray]) -> bool:
        """Whether half of some poses are near these."""
        mm, rad = self.outside(poses)
        return mm <= _DIAGONALS * self._diagonal and rad <= _BEYOND_RAD

    def is_usual(self, poses: Pose[np.ndarray]) -> bool:
        """Whether half of some poses are so near that nothing need be said."""
        mm, rad = self.outside(poses)
        return mm <= _USUAL_DIAGONALS * self._diagonal and rad <= _USUAL_RAD

    def is_within(self, poses: Pose[np.ndarray]) -> bool:
        """Whether half of some poses have places of which nothing need be said."""
        return self.outside(poses)[0] <= _USUAL_DIAGONALS * self._diagonal

    def is_still(self, poses: Pose[np.ndarray]) -> bool:
        """Whether a hand goes over next to nothing of this range."""
        return bool(np.linalg.norm(np.ptp(poses.translation, axis=0)) < _STILL * self._diagonal)

    @property
    def _diagonal(self) -> float:
        return float(np.linalg.norm(np.subtract(self.most_mm, self.least_mm)))
