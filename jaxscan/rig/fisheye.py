"""The fisheye of J. Kannala and S. Brandt (2006), with the terms of OpenCV's `fisheye`; Kalibr's `equidistant`.

The distance of the image from the axis is an odd polynomial of the angle θ between ray and axis,

    r_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).

A ray is θ and the direction from the axis (`rig.chart.AROUND`): at 90° it goes on as before, up to where r_d stops
growing, or to 175°.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.precision import Leaf
from jaxscan.rig import growing
from jaxscan.rig.chart import AROUND, Chart
from jaxscan.rig.readable import Readable

_WIDEST: Final = math.radians(175)


class Fisheye(Readable):
    """An equidistant lens with its errors. Every coefficient is a leaf of its own, so that each can be held or freed.

    Attributes:
        angular: k1 … k4.
    """

    chart: ClassVar[Chart] = AROUND

    kind: ClassVar[str] = "fisheye"
    numbers: ClassVar[Mapping[str, int]] = {"angular": 4}
    pinhole: ClassVar[bool] = False

    angular: tuple[Leaf, ...]

    @classmethod
    def nominal(cls) -> "Fisheye":
        """r_d = θ."""
        return cls(tuple(jnp.zeros(()) for _ in range(cls.numbers["angular"])))

    def distort(self, x: Float[Array, "2"]) -> Float[Array, "2"]:
        """Where a ray at the angle |x| is imaged; NaN beyond the angle at which r_d stops growing."""
        square = x[0] ** 2 + x[1] ** 2
        fold, _ = growing.turning_point(jax.lax.stop_gradient(self)._height, _WIDEST, x.dtype)
        # The turn is known to a sample; within it the slope says on which side a ray is.
        grows = (square <= fold**2) & (self._slope(square) > 0)
        return jnp.where(grows, x * self._factor(square), jnp.nan)

    def undistort(self, xd: Float[Array, "2"]) -> Float[Array, "2"]:
        """The ray that is imaged there; NaN beyond 175° and where the lens folds."""
        rd = jnp.sqrt(xd @ xd)
        angle = growing.inverse(self._height, _WIDEST, rd)
        return xd * jnp.where(rd > 0, angle / jnp.where(rd > 0, rd, 1.0), 1.0)

    def invertible_radius(self, dtype: Any) -> Float[Array, ""]:
        """The angle at which r_d stops growing, or 175°."""
        return growing.turning_point(self._height, _WIDEST, dtype)[0]

    def _height(self, angle: Float[Array, "*any"]) -> Float[Array, "*any"]:
        return angle * self._factor(angle**2)

    def _factor(self, t: Float[Array, "*any"]) -> Float[Array, "*any"]:
        k1, k2, k3, k4 = self.angular
        return 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))

    def _slope(self, t: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """The derivative of the height by the angle, at the square of the angle."""
        k1, k2, k3, k4 = self.angular
        return 1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * 9 * k4)))
