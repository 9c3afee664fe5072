"""The sheet of laser light, as a plane in dual space."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxscan.precision import Leaf


class LightPlane(eqx.Module):
    """The points X of the camera frame with ω · X = 1.

    Attributes:
        plane: the three components of ω, 1/mm.
        name: which laser of several this is; the only one needs none.
    """

    plane: tuple[Leaf, Leaf, Leaf]
    name: str = eqx.field(static=True, default="")

    @staticmethod
    def create(omega: ArrayLike | Sequence[float], name: str = "") -> "LightPlane":
        """A light plane from three numbers (1/mm)."""
        a, b, c = jnp.asarray(omega, dtype=float)
        return LightPlane((a, b, c), name)

    @property
    def omega(self) -> Float[Array, "3"]:
        """ω as one vector (1/mm)."""
        return jnp.stack(self.plane)

    def triangulate(self, ray: Float[Array, "3"]) -> Float[Array, "3"]:
        """Where a camera ray meets the sheet: X = x / (ω · x), mm; NaN where it does not, in front of the camera."""
        inverse_depth = self.omega @ ray
        meets = inverse_depth > 0
        return jnp.where(meets, ray / jnp.where(meets, inverse_depth, 1.0), jnp.nan)
