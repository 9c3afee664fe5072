"""The turntable that turns the object between scans, by motor steps about an axis."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Float, Float64

from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.precision import Leaf, as_float64, float64

# An axis within this share of its length of the line of sight's right angle is seen from the side.
_FROM_THE_SIDE = 0.25


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

    def way(self) -> str:
        """How its load goes as the step count rises, as the camera sees it, in words."""
        x, y, z = (float(leaf) for leaf in self.per_step)
        if abs(z) > _FROM_THE_SIDE * float(np.linalg.norm([x, y, z])):
            return "clockwise" if z > 0 else "anticlockwise"
        # What is nearest to the camera has the velocity w × (0, 0, −1) = (−y, x, 0).
        to = ("to the left", "to the right")[int(y < 0)] if abs(y) > abs(x) else ("up", "down")[int(x > 0)]
        return f"its near side {to}"

    def nearest(self) -> "Turntable":
        """The same turntable with its centre moved along the axis: c − (c · w) w / |w|², nearest to the origin."""
        w, c = jnp.stack(self.per_step), jnp.stack(self.centre)
        return Turntable.create(w, c - (c @ w) / (w @ w) * w)

    def along(self) -> int:
        """Which coordinate changes most along the axis: that of the centre is held where the others are sought."""
        return int(np.argmax(np.abs([float(x) for x in self.per_step])))

    def nearest_jacobian(self) -> Float64[np.ndarray, "6 6"]:
        """How the six numbers of `nearest` move with those of this one.

        By whatever the centre was held along the axis to find their covariance Σ, J Σ Jᵀ is that of `nearest`
        (W. Baarda's S-transformation, 1973). It has rank 5.
        """
        with float64():
            return np.asarray(_nearest_jacobian(as_float64(self)))

    def held_jacobian(self) -> Float64[np.ndarray, "6 6"]:
        """The way back: how the six numbers move when the centre's coordinate `along` is held."""
        w, k = np.array([float(x) for x in self.per_step]), self.along()
        J = np.eye(6)
        J[3:, 3 + k] -= w / w[k]
        J[3 + k] = 0.0
        return J


@jax.jit
def _nearest_jacobian(turntable: Turntable) -> Float[Array, "6 6"]:
    numbers, unravel = ravel_pytree(turntable)
    return jax.jacfwd(lambda numbers: ravel_pytree(unravel(numbers).nearest())[0])(numbers)
