"""The stage that moves object or board, by motor steps along a line."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxscan.precision import Leaf


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

    def displacement(self, steps: Float[Array | np.ndarray, "*any"]) -> Float[Array, "*any 3"]:
        """How far the stage has moved its load at a motor step count (mm, camera frame)."""
        along = jnp.stack(self.per_step)
        return jnp.asarray(steps)[..., None] * jnp.broadcast_to(along, (*steps.shape, 3))
