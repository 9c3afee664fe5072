"""Solids that rays can meet: spheres, boxes, cylinders, half spaces, and what is cut from them.

A ray meets a convex solid in one interval of t, its *span*. The span of an intersection is the intersection of the
spans; what is left of a span when another is taken away is at most two pieces. So a mug is a cylinder without a
smaller one, and every hit is exact, without marching.

Each solid also gives its unbounded surfaces as signed distance functions. At a hit the surface with the smallest
absolute distance is the one that was met: its number is the *patch*, and where neighbouring patches differ there is an
edge. The same functions give the distance of any point from the true surface
(`jaxscan.simulation.distance`).

Distances between lines are taken from cross products, |m × d|² rather than |m|²|d|² − (m · d)², which keeps float32 to
about 1e-4 mm at half a metre.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.simulation.vector import Rays, Vec, cross, dot, scale, select, subtract, vec

# Parameters of solids: NumPy float64 on the host, tracers of the kernel's precision within it.
Number = Any
Vector = Any
Matrix = Any

Interval = tuple[Float[Array, "*any"], Float[Array, "*any"]]

# Stands for zero where a component of a direction is divided by.
_TINY = 1e-12


class Surface(NamedTuple):
    """An unbounded surface near a point.

    Attributes:
        distance: signed distance of the point from the surface, mm, positive outside.
        normal: outwards, across the surface; of length one where the point lies on the surface.
    """

    distance: Float[Array, "*any"]
    normal: Vec


class Shape(eqx.Module):
    """Something that rays can meet."""

    # Whether meeting it takes a call back to the host, so that depth and patch had better be found together.
    on_host: ClassVar[bool] = False

    @abstractmethod
    def meet(self, rays: Rays) -> tuple[Float[Array, "*any"], Int[Array, "*any"]]:
        """Where rays that start outside first meet the shape.

        Returns:
            The ray parameter, more than 0, infinite for a miss; and the patch: which smooth piece of the surface it is.
        """

    @abstractmethod
    def blocks(self, rays: Rays, margin: Float[Array, "*any"]) -> Bool[Array, "*any"]:
        """Whether the shape is met between t = margin and t = 1 − margin."""

    @abstractmethod
    def normal_at(self, x: Vec, patch: Int[Array, "*any"]) -> Vec:
        """The unit normal at a point of a patch."""

    @abstractmethod
    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> Self:
        """The shape after x ↦ R x + translation (mm)."""

    def smooth(self, patch: Int[Array, "*any"]) -> Int[Array, "*any"]:
        """Patch to another number that is the same for patches without an edge between them."""
        return patch

    def tone(self, patch: Int[Array, "*any"]) -> Number:
        """A factor on the body's albedo."""
        return 1.0


class Solid(Shape):
    """A shape with an inside, bounded by surfaces that are known in closed form."""

    @abstractmethod
    def pieces(self, rays: Rays) -> list[Interval]:
        """The intervals of t inside the solid, over the whole line; empty ones have `leave` < `enter`."""

    @abstractmethod
    def surfaces(self, x: Vec) -> list[Surface]:
        """The unbounded surfaces that bound the solid, at a point."""

    @abstractmethod
    def height(self, x: Vec) -> Float[Array, "*any"]:
        """A function of the point (mm) that is negative inside, zero on the boundary and positive outside."""

    def meet(self, rays: Rays) -> tuple[Float[Array, "*any"], Int[Array, "*any"]]:
        """The start of the first piece ahead, and the surface nearest to that point."""
        t = jnp.asarray(jnp.inf, rays.direction.x.dtype)
        for enter, leave in self.pieces(rays):
            t = jnp.where((leave >= enter) & (enter > 0) & (enter < t), enter, t)
        return t, self.patch(rays.at(t))

    def blocks(self, rays: Rays, margin: Float[Array, "*any"]) -> Bool[Array, "*any"]:
        """Whether any piece reaches into margin … 1 − margin."""
        blocked = jnp.asarray(False)
        for enter, leave in self.pieces(rays):
            blocked = blocked | ((leave >= enter) & (leave > margin) & (enter < 1 - margin))
        return blocked

    def patch(self, x: Vec) -> Int[Array, "*any"]:
        """Which of the surfaces a point of the boundary belongs to."""
        gap, patch = jnp.asarray(jnp.inf, x.x.dtype), jnp.asarray(0, jnp.int32)
        for i, surface in enumerate(self.surfaces(x)):
            nearer = jnp.abs(surface.distance) < gap
            gap = jnp.where(nearer, jnp.abs(surface.distance), gap)
            patch = jnp.where(nearer, i, patch)
        return patch

    def normal_at(self, x: Vec, patch: Int[Array, "*any"]) -> Vec:
        """The outward normal of the patch's surface."""
        surfaces = self.surfaces(x)
        normal = surfaces[0].normal
        for i, surface in enumerate(surfaces[1:], start=1):
            normal = select(patch == i, surface.normal, normal)
        return normal


class Convex(Solid):
    """A solid that a ray meets in one interval."""

    @abstractmethod
    def span(self, rays: Rays) -> Interval:
        """That interval."""

    def pieces(self, rays: Rays) -> list[Interval]:
        """The span alone."""
        return [self.span(rays)]

    def height(self, x: Vec) -> Float[Array, "*any"]:
        """The largest of the signed distances."""
        surfaces = self.surfaces(x)
        height = surfaces[0].distance
        for surface in surfaces[1:]:
            height = jnp.maximum(height, surface.distance)
        return height


class Sphere(Convex):
    """A ball.

    Attributes:
        centre: mm.
        radius: mm.
    """

    centre: Vector
    radius: Number

    def span(self, rays: Rays) -> Interval:
        """The roots of |m + t d|² = r²."""
        d = rays.direction
        m = subtract(rays.origin, vec(self.centre))
        miss, a = cross(m, d), dot(d, d)
        return _roots(a, dot(m, d), a * self.radius**2 - dot(miss, miss))

    def surfaces(self, x: Vec) -> list[Surface]:
        """The sphere."""
        m = subtract(x, vec(self.centre))
        return [Surface(jnp.sqrt(dot(m, m)) - self.radius, scale(m, 1 / self.radius))]

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Sphere":
        """The centre moves."""
        return Sphere(R @ self.centre + translation, self.radius)


class Cylinder(Convex):
    """A cylinder with two flat ends.

    Attributes:
        base: centre of the end at height 0, mm.
        axis: unit vector from the base to the other end.
        radius: mm.
        length: mm.
    """

    base: Vector
    axis: Vector
    radius: Number
    length: Number

    def span(self, rays: Rays) -> Interval:
        """The span of the endless cylinder cut by that of the slab between the ends."""
        d, axis = rays.direction, vec(self.axis)
        m = subtract(rays.origin, vec(self.base))
        d_across, m_across = cross(d, axis), cross(m, axis)
        a = jnp.maximum(dot(d_across, d_across), _TINY)
        side = _roots(a, dot(m_across, d_across), a * self.radius**2 - dot(axis, cross(m, d)) ** 2)
        return both(side, slab(dot(m, axis), dot(d, axis), 0.0, self.length))

    def surfaces(self, x: Vec) -> list[Surface]:
        """Side, base, far end."""
        axis = vec(self.axis)
        p = subtract(x, vec(self.base))
        along = dot(p, axis)
        radial = subtract(p, scale(axis, along))
        return [
            Surface(jnp.sqrt(dot(radial, radial)) - self.radius, scale(radial, 1 / self.radius)),
            Surface(-along, scale(axis, -1)),
            Surface(along - self.length, axis),
        ]

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Cylinder":
        """Base and axis move."""
        return Cylinder(R @ self.base + translation, R @ self.axis, self.radius, self.length)


class Box(Convex):
    """A box.

    Attributes:
        centre: mm.
        axes: its three unit axes, as rows.
        half: half its lengths along them, mm.
    """

    centre: Vector
    axes: Matrix
    half: Vector

    def span(self, rays: Rays) -> Interval:
        """The intersection of three slabs."""
        m = subtract(rays.origin, vec(self.centre))

        def between(i: int) -> Interval:
            axis = vec(self.axes[i])
            return slab(dot(m, axis), dot(rays.direction, axis), -self.half[i], self.half[i])

        return both(both(between(0), between(1)), between(2))

    def surfaces(self, x: Vec) -> list[Surface]:
        """Six planes."""
        p = subtract(x, vec(self.centre))
        planes = []
        for i in range(3):
            axis = vec(self.axes[i])
            along = dot(p, axis)
            planes += [Surface(along - self.half[i], axis), Surface(-along - self.half[i], scale(axis, -1))]
        return planes

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Box":
        """Centre and axes move."""
        return Box(R @ self.centre + translation, self.axes @ R.T, self.half)


class HalfSpace(Convex):
    """The points with normal · x ≤ offset.

    Attributes:
        normal: unit vector, outwards.
        offset: mm.
    """

    normal: Vector
    offset: Number

    def span(self, rays: Rays) -> Interval:
        """From the plane to infinity, on one side."""
        normal = vec(self.normal)
        fall = nonzero(dot(rays.direction, normal))
        t = (self.offset - dot(rays.origin, normal)) / fall
        return jnp.where(fall < 0, t, -jnp.inf), jnp.where(fall < 0, jnp.inf, t)

    def surfaces(self, x: Vec) -> list[Surface]:
        """The plane."""
        return [Surface(dot(x, vec(self.normal)) - self.offset, vec(self.normal))]

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "HalfSpace":
        """The plane moves."""
        normal = R @ self.normal
        return HalfSpace(normal, self.offset + normal @ translation)


class Intersection(Convex):
    """What two convex solids have in common."""

    a: Convex
    b: Convex

    def span(self, rays: Rays) -> Interval:
        """The intersection of the spans."""
        return both(self.a.span(rays), self.b.span(rays))

    def surfaces(self, x: Vec) -> list[Surface]:
        """Those of both."""
        return self.a.surfaces(x) + self.b.surfaces(x)

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Intersection":
        """Both move."""
        return Intersection(self.a.moved(R, translation), self.b.moved(R, translation))


class Difference(Solid):
    """A convex solid `a` without a convex solid `b`."""

    a: Convex
    b: Convex

    def pieces(self, rays: Rays) -> list[Interval]:
        """Before `b` and behind it."""
        (a_in, a_out), (b_in, b_out) = self.a.span(rays), self.b.span(rays)
        touches = b_out >= b_in
        before = a_in, jnp.where(touches, jnp.minimum(a_out, b_in), a_out)
        behind = jnp.where(touches, jnp.maximum(a_in, b_out), jnp.inf), a_out
        return [before, behind]

    def surfaces(self, x: Vec) -> list[Surface]:
        """Those of `a`, and those of `b` turned round."""
        turned = [Surface(-distance, scale(normal, -1)) for distance, normal in self.b.surfaces(x)]
        return self.a.surfaces(x) + turned

    def height(self, x: Vec) -> Float[Array, "*any"]:
        """Inside `a` and not inside `b`."""
        return jnp.maximum(self.a.height(x), -self.b.height(x))

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Difference":
        """Both move."""
        return Difference(self.a.moved(R, translation), self.b.moved(R, translation))


class Union(Solid):
    """Two solids taken together."""

    a: Solid
    b: Solid

    def pieces(self, rays: Rays) -> list[Interval]:
        """Those of both; where they overlap they are not joined."""
        return self.a.pieces(rays) + self.b.pieces(rays)

    def surfaces(self, x: Vec) -> list[Surface]:
        """Those of both."""
        return self.a.surfaces(x) + self.b.surfaces(x)

    def height(self, x: Vec) -> Float[Array, "*any"]:
        """Outside of both."""
        return jnp.minimum(self.a.height(x), self.b.height(x))

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Union":
        """Both move."""
        return Union(self.a.moved(R, translation), self.b.moved(R, translation))


def _roots(a: Number, b: Number, discriminant: Number) -> Interval:
    """The roots of a t² + 2 b t + c with b² − a c given; an empty interval where there are none."""
    real = discriminant > 0
    root = jnp.sqrt(jnp.where(real, discriminant, 0.0))
    return jnp.where(real, (-b - root) / a, jnp.inf), jnp.where(real, (-b + root) / a, -jnp.inf)


def slab(start: Number, slope: Number, low: Number, high: Number) -> Interval:
    """Where low ≤ start + t · slope ≤ high."""
    slope = nonzero(slope)
    a, b = (low - start) / slope, (high - start) / slope
    return jnp.minimum(a, b), jnp.maximum(a, b)


def both(a: Interval, b: Interval) -> Interval:
    """The intersection of two intervals."""
    return jnp.maximum(a[0], b[0]), jnp.minimum(a[1], b[1])


def nonzero(x: Number) -> Number:
    """The number itself, or a tiny one in place of zero."""
    return jnp.where(jnp.abs(x) < _TINY, _TINY, x)
