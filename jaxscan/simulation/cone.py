"""A cone, or what is left of one where its tip is cut off.

With M = m × a and D = d × a, m from the base's middle to the ray's origin, d the ray's direction, a the axis, and
r(h) = R + k h the radius at height h, a ray is inside the double cone where

    |M + t D|² ≤ (ρ + t δ)²,    ρ = R + k m · a,    δ = k d · a.

The discriminant of this is |ρ D − δ M|² − (a · N)² with N = d × m, and ρ D − δ M = R D + k (N − a (a · N)): cross
products only, as for the other solids.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.simulation.solids import Convex, Interval, Number, Surface, Vector, both, nonzero, slab
from jaxscan.simulation.vector import Rays, Vec, add, cross, dot, scale, subtract, vec

# A ray whose quadratic coefficient is below this part of its terms runs along the side.
_ALONG = 0.05


class Cone(Convex):
    """A cone between two flat ends.

    Attributes:
        base: centre of the end at height 0, mm.
        axis: unit vector from the base to the other end.
        radius: of the base, mm.
        top: radius of the other end, mm; 0 for a tip.
        length: mm.
    """

    base: Vector
    axis: Vector
    radius: Number
    top: Number
    length: Number

    def span(self, rays: Rays) -> Interval:
        """What the double cone and the slab between the ends have in common.

        Of a ray that is steeper than the cone's side the part inside the double cone is what is not between the roots:
        the piece on the side of the nappe between the ends.
        """
        d, axis, k = rays.direction, vec(self.axis), self._slope()
        m = subtract(rays.origin, vec(self.base))
        rise, start = dot(d, axis), dot(m, axis)
        D, M, N = cross(d, axis), cross(m, axis), cross(d, m)
        delta, rho = k * rise, self.radius + k * start
        about = dot(axis, N)
        aside = add(scale(D, self.radius), scale(subtract(N, scale(axis, about)), k))
        across = dot(D, D)
        a = nonzero(across - delta**2)
        root_of = dot(aside, aside) - about**2
        real = root_of > 0
        root = jnp.sqrt(jnp.where(real, root_of, 0.0))
        middle = rho * delta - dot(M, D)
        # Of a ray along the side one root is far away, and the other is lost in its own rounding but for c / q.
        q = nonzero(middle + jnp.where(middle < 0, -root, root))
        far = q / a
        near = jnp.where(
            jnp.abs(a) < _ALONG * across, (dot(M, M) - rho**2) / q, (middle - jnp.where(middle < 0, -root, root)) / a
        )
        first, last = jnp.minimum(near, far), jnp.maximum(near, far)
        inf = jnp.asarray(jnp.inf, d.x.dtype)
        # The nappe widens with t where δ is positive, and lies behind the later root then.
        outer = jnp.where(delta > 0, last, -inf), jnp.where(delta > 0, inf, first)
        shallow = a > 0
        side = (
            jnp.where(shallow, jnp.where(real, first, inf), outer[0]),
            jnp.where(shallow, jnp.where(real, last, -inf), outer[1]),
        )
        return both(side, slab(start, rise, 0.0, self.length))

    def surfaces(self, x: Vec) -> list[Surface]:
        """Side, base, far end."""
        axis, k = vec(self.axis), self._slope()
        p = subtract(x, vec(self.base))
        along = dot(p, axis)
        radial = subtract(p, scale(axis, along))
        here, cosine = self.radius + k * along, 1 / jnp.sqrt(1 + k**2)
        out = subtract(scale(radial, 1 / nonzero(here)), scale(axis, k))
        return [
            Surface((jnp.sqrt(dot(radial, radial)) - here) * cosine, scale(out, cosine)),
            Surface(-along, scale(axis, -1)),
            Surface(along - self.length, axis),
        ]

    def _slope(self) -> Number:
        """The slope k of the radius over the height."""
        return (self.top - self.radius) / self.length

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Cone":
        """Base and axis move."""
        return Cone(R @ self.base + translation, R @ self.axis, self.radius, self.top, self.length)
