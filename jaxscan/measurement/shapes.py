"""Shapes that are fitted: signed distances of points from each, and how they change with its numbers.

Each shape has numbers of its own about where it stands, all in mm (turns are times a length `size`, about that of its
points), so that the normal equations of a fit are well conditioned. `moved` takes them from 0. With a the axis, d from
a point of it to x, h = a · d, ρ = |d − h a| and w = (d − h a) / ρ, the distances are

    plane n · d    ball |d| − R    cylinder ρ − R    cone (ρ − R) cos φ − h sin φ    circle ρ − R    line m · d

(C. M. Shakarji, "Least-squares fitting algorithms of the NIST algorithm testing system", 1998). Circle and line lie in
a plane that is given.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "points 3"]
Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class Shape:
    """A shape.

    Attributes:
        point: of a plane or line a point on it, of a ball or circle the centre, of the others a point of the axis, mm.
        axis: unit: a plane's normal, a cylinder's or cone's axis (of a cone that in which it widens), the normal of a
            circle's plane, a line's direction. Of a ball it says nothing.
        size: about that of its points, mm.
    """

    # How many numbers it has, and how many points determine them.
    numbers: ClassVar[int]
    point: Vector
    axis: Vector
    size: float

    @abstractmethod
    def at(self, x: Points) -> tuple[Float[np.ndarray, "points"], Points]:
        """Signed distances of points, mm, and how they change with the points: unit vectors."""

    def distances(self, x: Points) -> Float[np.ndarray, "points"]:
        """Signed distances of points, mm."""
        return self.at(x)[0]

    def gradient(self, x: Points) -> Points:
        """How the distances change with the points: unit vectors."""
        return self.at(x)[1]

    @abstractmethod
    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """How the distances change with the numbers."""

    @abstractmethod
    def moved(self, by: Float[np.ndarray, "numbers"]) -> Self:
        """The shape with its numbers changed."""

    def curvature(self, x: Points) -> Float[np.ndarray, "points"]:
        """The largest at points, 1/mm; 0 of what is straight."""
        return np.zeros(len(x))

    def placed(self, x: Points) -> Self:
        """The same with its own point in the middle of these points, and their size."""
        middle = x.mean(axis=0)
        size = max(float(np.sqrt(((x - middle) ** 2).sum(axis=1).mean())), 1e-9)
        return replace(self, size=size, **self._with_middle(middle))

    def _with_middle(self, middle: Vector) -> dict[str, Any]:
        return {"point": self.point + self.axis * float(self.axis @ (middle - self.point))}

    def _turned(self, by: Float[np.ndarray, "2"]) -> Vector:
        u, v = across(self.axis)
        axis = self.axis + (by[0] * u + by[1] * v) / self.size
        return axis / np.linalg.norm(axis)

    def _about_axis(self, x: Points) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"], Points]:
        """h, ρ and w."""
        d = x - self.point
        h = d @ self.axis
        w = d - h[:, None] * self.axis
        rho = lengths(w)
        w /= np.maximum(rho, 1e-300)[:, None]
        return h, rho, w

    def turned_by(self, x: Points) -> Float[np.ndarray, "points 2"]:
        """The parts of w along the two directions across the axis."""
        return self._about_axis(x)[2] @ np.stack(across(self.axis), axis=1)


@dataclass(frozen=True)
class Plane(Shape):
    """A plane; its numbers: two turns, and how far it is moved along its normal."""

    numbers: ClassVar[int] = 3

    @classmethod
    def through(cls, x: Points) -> "Plane":
        """The plane with the least sum of squared distances to some points."""
        middle = x.mean(axis=0)
        size = float(np.linalg.norm(np.ptp(x, axis=0)))
        return cls(middle, np.linalg.svd(x - middle, full_matrices=False)[2][2], size)

    def at(self, x: Points) -> tuple[Float[np.ndarray, "points"], Points]:
        """Along the normal; the normal."""
        return (x - self.point) @ self.axis, np.broadcast_to(self.axis, x.shape)

    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """The derivatives of distances by the numbers."""
        u, v = across(self.axis)
        d = x - self.point
        return np.stack([d @ u / self.size, d @ v / self.size, np.full(len(x), -1.0)], axis=1)

    def moved(self, by: Float[np.ndarray, "numbers"]) -> "Plane":
        """Turned about its point, then moved."""
        return Plane(self.point + by[2] * self.axis, self._turned(by[:2]), self.size)

    def _with_middle(self, middle: Vector) -> dict[str, Any]:
        return {"point": middle - self.axis * float(self.axis @ (middle - self.point))}


@dataclass(frozen=True)
class Ball(Shape):
    """A ball; its numbers: of the centre, then the radius."""

    numbers: ClassVar[int] = 4
    radius: float = 0.0

    def at(self, x: Points) -> tuple[Float[np.ndarray, "points"], Points]:
        """From its surface, positive outside; away from the centre."""
        d = x - self.point
        away = lengths(d)
        return away - self.radius, d / np.maximum(away, 1e-300)[:, None]

    def curvature(self, x: Points) -> Float[np.ndarray, "points"]:
        """1 / R."""
        return np.full(len(x), 1 / self.radius)

    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """The derivatives of distances by the numbers."""
        return np.concatenate([-self.gradient(x), np.full((len(x), 1), -1.0)], axis=1)

    def moved(self, by: Float[np.ndarray, "numbers"]) -> "Ball":
        """Moved, and grown."""
        return Ball(self.point + by[:3], self.axis, self.size, self.radius + by[3])

    def _with_middle(self, middle: Vector) -> dict[str, Any]:
        return {}


@dataclass(frozen=True)
class _Round(Shape):
    """What is round about an axis at one radius: a cylinder in space, a circle in its plane.

    Attributes:
        radius: mm.
    """

    radius: float = 0.0

    def at(self, x: Points) -> tuple[Float[np.ndarray, "points"], Points]:
        """From its surface, positive outside; away from the axis."""
        _, rho, w = self._about_axis(x)
        return rho - self.radius, w

    def curvature(self, x: Points) -> Float[np.ndarray, "points"]:
        """1 / R, around the axis."""
        return np.full(len(x), 1 / self.radius)


@dataclass(frozen=True)
class Cylinder(_Round):
    """A cylinder; its numbers: two of its place, two turns, the radius."""

    numbers: ClassVar[int] = 5

    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """The derivatives of distances by the numbers."""
        h, parts = (x - self.point) @ self.axis, self.turned_by(x)
        return np.concatenate([-parts, -parts * h[:, None] / self.size, np.full((len(x), 1), -1.0)], axis=1)

    def moved(self, by: Float[np.ndarray, "numbers"]) -> "Cylinder":
        """Moved across its axis, turned, and grown."""
        u, v = across(self.axis)
        return Cylinder(self.point + by[0] * u + by[1] * v, self._turned(by[2:4]), self.size, self.radius + by[4])


@dataclass(frozen=True)
class Cone(Shape):
    """A cone; its numbers: two of its place, two turns, the radius at its point, and half its opening angle."""

    numbers: ClassVar[int] = 6
    radius: float = 0.0
    half_angle: float = 0.0

    def at(self, x: Points) -> tuple[Float[np.ndarray, "points"], Points]:
        """From its surface, positive outside; across it, outwards."""
        h, rho, w = self._about_axis(x)
        c, s = np.cos(self.half_angle), np.sin(self.half_angle)
        return (rho - self.radius) * c - h * s, c * w - s * self.axis

    def curvature(self, x: Points) -> Float[np.ndarray, "points"]:
        """Cos φ / ρ, around the axis."""
        return np.cos(self.half_angle) / np.maximum(self._about_axis(x)[1], 1e-3 * self.size)

    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """The derivatives of distances by the numbers."""
        h, rho, _ = self._about_axis(x)
        parts = self.turned_by(x)
        c, s = np.cos(self.half_angle), np.sin(self.half_angle)
        turns = -parts * ((h * c + rho * s) / self.size)[:, None]
        by_angle = (-(rho - self.radius) * s - h * c) / self.size
        return np.concatenate([-c * parts, turns, np.stack([np.full(len(x), -c), by_angle], axis=1)], axis=1)

    def moved(self, by: Float[np.ndarray, "numbers"]) -> "Cone":
        """Moved across its axis, turned, grown, and opened."""
        u, v = across(self.axis)
        point, angle = self.point + by[0] * u + by[1] * v, self.half_angle + by[5] / self.size
        return Cone(point, self._turned(by[2:4]), self.size, self.radius + by[4], angle)

    def placed(self, x: Points) -> "Cone":
        """With its radius at the new point, and its axis so that it widens along it."""
        placed = super().placed(x)
        along = float(self.axis @ (placed.point - self.point))
        way = -1.0 if self.half_angle < 0 else 1.0
        radius = self.radius + along * np.tan(self.half_angle)
        return replace(placed, axis=way * self.axis, radius=radius, half_angle=way * self.half_angle)

    @property
    def apex(self) -> Vector:
        """Its tip, mm."""
        return self.point - self.axis * (self.radius / np.tan(self.half_angle))


@dataclass(frozen=True)
class Circle(_Round):
    """A circle in a plane that is given; its numbers: two of the centre, the radius."""

    numbers: ClassVar[int] = 3

    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """The derivatives of distances by the numbers."""
        return np.concatenate([-self.turned_by(x), np.full((len(x), 1), -1.0)], axis=1)

    def moved(self, by: Float[np.ndarray, "numbers"]) -> "Circle":
        """Moved in the plane, and grown."""
        u, v = across(self.axis)
        return Circle(self.point + by[0] * u + by[1] * v, self.axis, self.size, self.radius + by[2])


@dataclass(frozen=True)
class Line(Shape):
    """A line in a plane that is given; its numbers: how far it is moved in the plane, and a turn.

    Attributes:
        normal: of the plane.
    """

    numbers: ClassVar[int] = 2
    normal: Vector = None  # type: ignore[assignment]  # a line without one is not made

    @property
    def aside(self) -> Vector:
        """Across the line, in the plane."""
        return _cross(self.normal, self.axis)

    def at(self, x: Points) -> tuple[Float[np.ndarray, "points"], Points]:
        """In the plane; across the line."""
        return (x - self.point) @ self.aside, np.broadcast_to(self.aside, x.shape)

    def jacobian(self, x: Points) -> Float[np.ndarray, "points numbers"]:
        """The derivatives of distances by the numbers."""
        return np.stack([np.full(len(x), -1.0), -((x - self.point) @ self.axis) / self.size], axis=1)

    def moved(self, by: Float[np.ndarray, "numbers"]) -> "Line":
        """Moved across itself, and turned in the plane."""
        axis = self.axis + by[1] / self.size * self.aside
        return Line(self.point + by[0] * self.aside, axis / np.linalg.norm(axis), self.size, self.normal)


def across(axis: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors at right angles to an axis and to each other."""
    u = _cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.sqrt(u @ u)
    return u, _cross(axis, u)


def _cross(a: Vector, b: Vector) -> Vector:
    """The cross product; ten times as fast as `np.cross` of two vectors."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def lengths(vectors: Points) -> Float[np.ndarray, "points"]:
    """The lengths of vectors; three times as fast as `np.linalg.norm`, which reduces three numbers at a time."""
    return np.sqrt(np.einsum("pi,pi->p", vectors, vectors))


def total(a: Float[np.ndarray, "n"], b: Float[np.ndarray, "n"]) -> float:
    """Σ aᵢ bᵢ, by one thread: BLAS starts threads for long vectors, which cost a hundred times what they save."""
    return float(np.einsum("p,p->", a, b))
