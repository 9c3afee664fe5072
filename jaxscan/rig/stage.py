"""The stage that moves object or board, by motor steps along a line."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxscan.precision import Leaf

# A direction that is less than this share of the way is not worth a word.
_A_WORD = 0.25


class Stage(eqx.Module):
    """A linear stage.

    Attributes:
        per_step: what stands on the stage moves by this in the camera frame for one motor step (mm).
    """

    per_step: tuple[Leaf, Leaf, Leaf]

    @staticmethod
    def create(per_step: ArrayLike | Sequence[float]) -> "Stage":
        """A stage from three numbers (mm for each motor step)."""
        a, b, c = jnp.asarray(per_step, dtype=float)
        return Stage((a, b, c))

    def way(self) -> str:
        """Where its load goes as the step count rises, as the camera sees it, in words."""
        per_step = np.array([float(leaf) for leaf in self.per_step])
        words = (("to the left", "to the right"), ("up", "down"), ("towards the camera", "away from the camera"))
        shares = per_step / np.linalg.norm(per_step)
        return " and ".join(pair[int(s > 0)] for pair, s in zip(words, shares, strict=True) if abs(s) > _A_WORD)

    def displacement(self, steps: float | Float[Array | np.ndarray, "*any"]) -> Float[Array, "*any 3"]:
        """How far the stage has moved its load at a motor step count (mm, camera frame)."""
        count, along = jnp.asarray(steps), jnp.stack(self.per_step)
        return count[..., None] * jnp.broadcast_to(along, (*count.shape, 3))
