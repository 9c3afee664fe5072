"""A linear stage: what stands on it moves along a line, by motor steps."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import namespace
from jaxscan.precision import Leaf
from jaxscan.rig.motion import Positions, unit_vector

# A direction that is less than this share of the way is not worth a word.
_A_WORD = 0.25


class Linear(eqx.Module):
    """A motion along a line.

    Attributes:
        per_step: what stands on the stage moves by this in the camera frame for one motor step (mm).
        axis: its name.
    """

    kind: ClassVar[str] = "linear"
    numbers: ClassVar[Mapping[str, int]] = {"per_step": 3}
    fewest: ClassVar[int] = 2

    per_step: tuple[Leaf, Leaf, Leaf]
    axis: str = eqx.field(static=True, default="stage")

    @staticmethod
    def create(per_step: ArrayLike | Sequence[float], axis: str = "stage") -> "Linear":
        """A stage from three numbers (mm for each motor step)."""
        a, b, c = jnp.asarray(per_step, dtype=float)
        return Linear((a, b, c), axis)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "Linear":
        """By the median of slopes (H. Theil 1950, P. K. Sen 1968)."""
        i, j = np.triu_indices(len(positions), 1)
        moved = positions[i] != positions[j]
        slopes = (poses.translation[j] - poses.translation[i])[moved] / (positions[j] - positions[i])[moved, None]
        return cls.create(np.median(slopes, axis=0), axis)

    @classmethod
    def at_rest(cls, axis: str) -> "Linear":
        """One that does not move."""
        return cls.create(np.zeros(3), axis)

    def parts(self) -> "tuple[Linear]":
        """Itself."""
        return (self,)

    def pose(self, q: Positions) -> Pose:
        """The translation n · per_step."""
        steps = q.get(self.axis, 0.0)
        xp = namespace(steps, *self.per_step)
        shift = xp.tensordot(xp.asarray(steps), xp.stack([xp.asarray(leaf) for leaf in self.per_step]), axes=0)
        return Pose(xp.zeros_like(shift), shift)

    def idle(self) -> Float[np.ndarray, "0 3"]:
        """None."""
        return np.zeros((0, 3))

    def way(self) -> str:
        """Where its load goes as the step count rises, as the camera sees it, in words."""
        words = (("to the left", "to the right"), ("up", "down"), ("towards the camera", "away from the camera"))
        shares = zip(words, self.direction(), strict=True)
        return " and ".join(pair[int(s > 0)] for pair, s in shares if abs(s) > _A_WORD)

    def direction(self) -> Float[np.ndarray, "3"]:
        """Along its travel."""
        return unit_vector(self.per_step)

    def amount(self, steps: float) -> tuple[float, str]:
        """Millimetres."""
        return abs(steps) * float(np.linalg.norm([float(leaf) for leaf in self.per_step])), "mm"
