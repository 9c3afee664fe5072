"""The turntable that turns the object between scans, by motor steps about an axis."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.precision import Leaf


class Turntable(eqx.Module):
    """A turntable, in the object frame.

    Attributes:
        per_step: rotation vector of one motor step: the axis, times the angle (radians).
        centre: the point of the axis that is nearest to the frame's origin, mm.
    """

    per_step: tuple[Leaf, Leaf, Leaf]
    centre: tuple[Leaf, Leaf, Leaf]

    @staticmethod
    def create(per_step: ArrayLike | Sequence[float], centre: ArrayLike | Sequence[float]) -> "Turntable":
        """A turntable from twice three numbers (radians for each motor step, mm)."""
        a, b, c = jnp.asarray(per_step, dtype=float)
        x, y, z = jnp.asarray(centre, dtype=float)
        return Turntable((a, b, c), (x, y, z))

    def turned(self, steps: Leaf) -> Pose:
        """Where what stands on the table goes in so many steps: x ↦ R (x − centre) + centre."""
        rotation, centre = jnp.stack(self.per_step) * steps, jnp.stack(self.centre)
        return Pose(rotation, centre - vector_to_matrix(rotation) @ centre)
