"""A linear stage: what stands on it moves along a line, by motor steps."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry import Pose
from jaxscan.rig.line import Line, median_slope, per_steps
from jaxscan.rig.motion import Positions


class Linear(Line):
    """A motion along a line.

    Attributes:
        per_step: displacement of the load in the camera frame for one motor step, mm.
        axis: its name.
    """

    kind: ClassVar[str] = "linear"
    numbers: ClassVar[Mapping[str, int]] = {"per_step": 3}
    fewest: ClassVar[int] = 2

    @staticmethod
    def create(per_step: ArrayLike | Sequence[float], axis: str = "stage") -> "Linear":
        """A stage from three numbers (mm for each motor step)."""
        a, b, c = jnp.asarray(per_step, dtype=float)
        return Linear((a, b, c), axis=axis)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "Linear":
        """The motion, estimated by the median of slopes."""
        return cls.create(median_slope(positions, poses.translation), axis)

    @classmethod
    def at_rest(cls, axis: str) -> "Linear":
        """One that does not move."""
        return cls.create(np.zeros(3), axis)

    def pose(self, q: Positions) -> Pose:
        """The translation n · per_step."""
        shift = per_steps(q.get(self.axis, 0.0), self.per_step)
        return Pose.shift(shift)
