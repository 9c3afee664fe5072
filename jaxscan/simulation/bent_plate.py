"""A plate that is bent like a sheet of paper: a part of a cylinder, on which the pattern keeps its lengths.

In the plate's own frame u and v go through its middle, u in the direction in which it bends and v along the cylinder's
axis. Its surface is z = u² / (r + √(r² − u²)), which is r − √(r² − u²) without the difference of two large numbers, and
a point of it was at r asin(u / r) on the flat paper.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscan.simulation.plate import Plate
from jaxscan.simulation.solids import Number, Surface, Vector
from jaxscan.simulation.vector import Rays, Vec, add, dot, scale, subtract, vec

# Newton steps from the flat plate's point: each squares an error that is a thousandth at first.
_STEPS = 4


class BentPlate(Plate):
    """A plate on a cylinder: a board. `distance` does not know it, so it is nothing to be scanned.

    Attributes:
        across: unit vector on the flat plate in whose direction it bends, (x, y).
        middle: of the plate, (x, y), mm; it stays where it is.
        radius: of the cylinder, mm; below 0 the edges stand on the side of −z.
    """

    across: Vector = eqx.field(default_factory=lambda: np.array([1.0, 0.0]))
    middle: Vector = eqx.field(default_factory=lambda: np.zeros(2))
    radius: Number = 1e6

    def _along(self, x: Vec) -> Float[Array, "*any"]:
        """How far points of the plate's frame are from its middle, in the direction in which it bends."""
        return (x.x - self.middle[0]) * self.across[0] + (x.y - self.middle[1]) * self.across[1]

    def _rise(self, u: Float[Array, "*any"]) -> tuple[Float[Array, "*any"], Float[Array, "*any"]]:
        """The height of the surface, and its slope."""
        inside = jnp.minimum((u / self.radius) ** 2, 0.99)
        root = jnp.sqrt(1 - inside)
        return u**2 / (self.radius * (1 + root)), u / (self.radius * root)

    def _paper(self, x: Vec) -> Vec:
        """Where points of the surface were on the flat paper, and their height above the surface."""
        p = self._local(x)
        u = self._along(p)
        more = self.radius * jnp.arcsin(jnp.clip(u / self.radius, -1, 1)) - u
        return Vec(p.x + more * self.across[0], p.y + more * self.across[1], p.z - self._rise(u)[0])

    def _crossing(self, rays: Rays) -> Float[Array, "*any"]:
        """Where the surface is crossed that is nearest to the flat plate."""
        o = self._local(rays.origin)
        d = Vec(
            dot(rays.direction, vec(self.x_axis)),
            dot(rays.direction, vec(self.y_axis)),
            dot(rays.direction, self._normal()),
        )
        t = -o.z / d.z
        for _ in range(_STEPS):
            rise, slope = self._rise(self._along(add(o, scale(d, t))))
            t = t - (o.z + t * d.z - rise) / (d.z - slope * (d.x * self.across[0] + d.y * self.across[1]))
        return t

    def normal_at(self, x: Vec, patch: Int[Array, "*any"]) -> Vec:
        """The cylinder's, on the side of the plate's."""
        slope = self._rise(self._along(self._local(x)))[1]
        over = 1 / jnp.sqrt(1 + slope**2)
        across = add(scale(vec(self.x_axis), self.across[0]), scale(vec(self.y_axis), self.across[1]))
        return scale(subtract(self._normal(), scale(across, slope)), over)

    def surfaces(self, x: Vec) -> list[Surface]:
        """The surface, as the unsigned distance from it to first order of its slope: there is no inside."""
        return [Surface(self.height(x), self.normal_at(x, jnp.zeros_like(x.x, jnp.int32)))]


def bent(plate: Plate, bend_mm: float, over_mm: float, angle: float) -> BentPlate:
    """A plate bent by `bend_mm` over `over_mm`: so far are points that far apart off their middle, across the bend.

    Args:
        plate: the flat one.
        bend_mm: below 0 to the other side.
        over_mm: the length on which it is bent so, mm.
        angle: from the plate's x to the direction in which it bends, radians.
    """
    radius = ((over_mm / 2) ** 2 + bend_mm**2) / (2 * bend_mm)
    across = np.array([np.cos(angle), np.sin(angle)])
    middle = (np.asarray(plate.low) + np.asarray(plate.high)) / 2
    return BentPlate(
        plate.origin,
        plate.x_axis,
        plate.y_axis,
        plate.low,
        plate.high,
        plate.pattern,
        plate.ink,
        across,
        middle,
        np.float64(radius),
    )
