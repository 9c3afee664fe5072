"""A flat rectangular plate without thickness, with a pattern printed on it: calibration boards, floors, walls."""

from abc import abstractmethod
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscan.simulation.solids import Interval, Number, Solid, Surface, Vector
from jaxscan.simulation.vector import Rays, Vec, cross, dot, subtract, vec


class Pattern(eqx.Module):
    """What is printed on a plate."""

    @abstractmethod
    def dark(self, x: Float[Array, "*any"], y: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """1 where a point of the plate (mm) is dark, else 0."""


class Plain(Pattern):
    """Nothing."""

    def dark(self, x: Float[Array, "*any"], y: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """Nowhere."""
        return jnp.zeros_like(x)


class Checks(Pattern):
    """A checkerboard with its first inner corner at the origin and a dark square in each odd place from there.

    Attributes:
        counts: inner corners in a row and in a column.
        pitch: side of a square, mm.
    """

    counts: Vector
    pitch: Number

    def dark(self, x: Float[Array, "*any"], y: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """The albedo by the parity of the square, which is dark where x and y are both before the first corner."""
        i, j = jnp.floor(x / self.pitch) + 1, jnp.floor(y / self.pitch) + 1
        inside = (i >= 0) & (i <= self.counts[0]) & (j >= 0) & (j <= self.counts[1])
        odd = jnp.mod(i + j, 2)
        return jnp.where(inside, 1 - odd, 0)


class Circles(Pattern):
    """Dark discs on a grid, the first centred at the origin.

    Attributes:
        counts: discs in a row and in a column.
        pitch: distance of their centres, mm.
        radius: mm.
    """

    counts: Vector
    pitch: Number
    radius: Number

    def dark(self, x: Float[Array, "*any"], y: Float[Array, "*any"]) -> Float[Array, "*any"]:
        """Within the radius of the nearest centre."""
        dx = x - self.pitch * jnp.clip(jnp.round(x / self.pitch), 0, self.counts[0] - 1)
        dy = y - self.pitch * jnp.clip(jnp.round(y / self.pitch), 0, self.counts[1] - 1)
        return jnp.where(dx**2 + dy**2 < self.radius**2, 1.0, 0.0)


class Plate(Solid):
    """A rectangle; both faces carry the pattern.

    Attributes:
        origin: of the plate's own coordinates, mm.
        x_axis: unit vector along the columns of the pattern.
        y_axis: unit vector along its rows.
        low: smallest x and y on the plate, mm.
        high: largest x and y, mm.
        pattern: what is printed on it.
        ink: how bright the dark parts are, as a factor on the body's albedo.
    """

    origin: Vector
    x_axis: Vector
    y_axis: Vector
    low: Vector
    high: Vector
    pattern: Pattern = Plain()
    ink: Number = 1.0

    def _local(self, x: Vec) -> Vec:
        p = subtract(x, vec(self.origin))
        return Vec(dot(p, vec(self.x_axis)), dot(p, vec(self.y_axis)), dot(p, self._normal()))

    def _normal(self) -> Vec:
        return cross(vec(self.x_axis), vec(self.y_axis))

    def _crossing(self, rays: Rays) -> Float[Array, "*any"]:
        """The ray parameter where rays cross the plate, or where they would if it went on."""
        normal = self._normal()
        return dot(subtract(vec(self.origin), rays.origin), normal) / dot(rays.direction, normal)

    def _paper(self, x: Vec) -> Vec:
        """Where points are on the flat paper, x and y, and their height above the plate."""
        return self._local(x)

    def pieces(self, rays: Rays) -> list[Interval]:
        """One point, where the ray crosses the rectangle."""
        t = self._crossing(rays)
        p = self._paper(rays.at(t))
        inside = (p.x >= self.low[0]) & (p.x <= self.high[0]) & (p.y >= self.low[1]) & (p.y <= self.high[1])
        return [(jnp.where(inside, t, jnp.inf), jnp.where(inside, t, -jnp.inf))]

    def patch(self, x: Vec) -> Int[Array, "*any"]:
        """1 where the pattern is dark, else 0."""
        p = self._paper(x)
        return self.pattern.dark(p.x, p.y).astype(jnp.int32)

    def tone(self, patch: Int[Array, "*any"]) -> Number:
        """The ink's brightness where it is dark."""
        return jnp.where(patch == 1, self.ink, 1.0)

    def normal_at(self, x: Vec, patch: Int[Array, "*any"]) -> Vec:
        """The same everywhere."""
        return self._normal()

    def surfaces(self, x: Vec) -> list[Surface]:
        """The rectangle, as the unsigned distance from it: there is no inside."""
        distance = self.height(x)
        return [Surface(distance, self._normal())]

    def height(self, x: Vec) -> Float[Array, "*any"]:
        """The distance from the rectangle."""
        p = self._paper(x)
        beyond_x = jnp.maximum(jnp.maximum(self.low[0] - p.x, p.x - self.high[0]), 0)
        beyond_y = jnp.maximum(jnp.maximum(self.low[1] - p.y, p.y - self.high[1]), 0)
        return jnp.sqrt(beyond_x**2 + beyond_y**2 + p.z**2)

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Plate":
        """Origin and axes move."""
        return replace(self, origin=R @ self.origin + translation, x_axis=R @ self.x_axis, y_axis=R @ self.y_axis)
