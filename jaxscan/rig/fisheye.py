"""The fisheye of J. Kannala and S. Brandt (2006), with the terms of OpenCV's `fisheye`; Kalibr's `equidistant`.

The distance of the image from the axis is an odd polynomial of the angle θ between ray and axis,

    r_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).

A ray is (x, y, 1), so that θ stays below 90°.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.precision import Leaf
from jaxscan.rig import growing

_WIDEST: Final = math.radians(84)
# Below this r² the angle is taken by its series, which has a derivative on the axis.
_NEAR_AXIS: Final = 1e-6


class Fisheye(eqx.Module):
    """An equidistant lens with its errors. Every coefficient is a leaf of its own, so that each can be held or freed.

    Attributes:
        angular: k1 … k4.
    """

    kind: ClassVar[str] = "fisheye"
    numbers: ClassVar[Mapping[str, int]] = {"angular": 4}
    pinhole: ClassVar[bool] = False

    angular: tuple[Leaf, ...]

    @classmethod
    def nominal(cls) -> "Fisheye":
        """r_d = θ."""
        return cls(tuple(jnp.zeros(()) for _ in range(cls.numbers["angular"])))

    def distort(self, x: Float[Array, "2"]) -> Float[Array, "2"]:
        """Undistorted to distorted normalised coordinates."""
        r2 = x @ x
        near = r2 < _NEAR_AXIS
        r = jnp.sqrt(jnp.where(near, 1.0, r2))
        share = jnp.where(near, 1 - r2 / 3 + r2**2 / 5, jnp.arctan(r) / r)  # θ / r
        return x * share * self._factor(r2 * share**2)

    def undistort(self, xd: Float[Array, "2"]) -> Float[Array, "2"]:
        """Distorted to undistorted normalised coordinates; NaN beyond 84° and where the lens folds."""
        rd = jnp.sqrt(xd @ xd)
        angle = growing.inverse(self._height, _WIDEST, rd)
        return xd * jnp.where(rd > 0, jnp.tan(angle) / jnp.where(rd > 0, rd, 1.0), 1.0)

    def invertible_radius(self, dtype: Any) -> Float[Array, ""]:
        """The tangent of the angle at which r_d stops growing, or of 84°."""
        return jnp.tan(growing.turning_point(self._height, _WIDEST, dtype)[0])

    def _height(self, angle: Float[Array, "*any"]) -> Float[Array, "*any"]:
        return angle * self._factor(angle**2)

    def _factor(self, t: Float[Array, "*any"]) -> Float[Array, "*any"]:
        k1, k2, k3, k4 = self.angular
        return 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))
