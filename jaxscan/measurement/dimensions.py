"""Dimensions between shapes: functions of the shapes alone, so that their derivatives follow by moving these.

A plane stands for itself at the middle of its points, a ball and a circle for their centre, a cylinder and a cone for
their axis, an edge for the line in which two planes meet, a slot for the plane midway between two.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.files.part_file import Dimension, Feature
from jaxscan.measurement.shapes import Ball, Circle, Cone, Plane, Shape, Vector

# Axes at a larger angle have a common perpendicular; others are compared at the middle of the second.
_SKEW: Final = np.radians(10.0)
# Planes at a smaller angle have no edge, at a larger one no width, between them.
_PARALLEL: Final = np.radians(5.0)
_FACING: Final = np.radians(30.0)


@dataclass(frozen=True)
class Place:
    """What a feature stands for: a point, a line or a plane.

    Attributes:
        point: on it, mm.
        direction: of a line; None for a point and a plane.
        normal: of a plane; None for a point and a line.
    """

    point: Vector
    direction: Vector | None = None
    normal: Vector | None = None

    @property
    def way(self) -> Vector:
        """The direction of a line, or the normal of a plane."""
        way = self.direction if self.direction is not None else self.normal
        assert way is not None
        return way


def place_of(shape: Shape) -> Place:
    """The point of a fitted shape, with its direction or its normal."""
    if isinstance(shape, Plane):
        return Place(shape.point, normal=shape.axis)
    return Place(shape.point) if isinstance(shape, Ball | Circle) else Place(shape.point, direction=shape.axis)


def edge_of(a: Plane, b: Plane) -> Place:
    """The line in which two planes meet, at its point nearest to the middle between theirs.

    Raises:
        InputError: they are nearly parallel.
    """
    if np.linalg.norm(np.cross(a.axis, b.axis)) < np.sin(_PARALLEL):
        raise InputError("its two planes are parallel within 5°, so that they have no edge: name two that meet")
    direction = np.cross(a.axis, b.axis)
    direction /= np.linalg.norm(direction)
    middle = (a.point + b.point) / 2
    A = np.stack([a.axis, b.axis, direction])
    point = np.linalg.solve(A, [a.axis @ a.point, b.axis @ b.point, direction @ middle])
    return Place(point, direction=direction)


def slot_of(a: Plane, b: Plane) -> Place:
    """The plane midway between two that face each other, or are the two sides of a rib.

    Raises:
        InputError: they are not parallel within 30°.
    """
    if np.linalg.norm(np.cross(a.axis, b.axis)) > np.sin(_FACING):
        raise InputError("its two planes are at more than 30° to each other: name the two sides of one slot or rib")
    other = b.axis if a.axis @ b.axis > 0 else -b.axis
    normal = a.axis + other
    return Place((a.point + b.point) / 2, normal=normal / np.linalg.norm(normal))


def width_of(a: Plane, b: Plane) -> float:
    """From the middle of one side to that of the other, along the normal midway, mm."""
    normal = slot_of(a, b).normal
    assert normal is not None
    # Each side is taken where the line along the normal through the middle of all points meets it.
    middle = (a.point + b.point) / 2
    ends = [float((each.point - middle) @ each.axis / (normal @ each.axis)) for each in (a, b)]
    return abs(ends[1] - ends[0])


def distance_between(a: Place, b: Place) -> float:
    """The distance of two places, mm, at the middle of the second where they are parallel."""
    if skew(a, b):
        assert a.direction is not None
        assert b.direction is not None
        common = np.cross(a.direction, b.direction)
        return abs(float((b.point - a.point) @ common / np.linalg.norm(common)))
    return gap_between(a, b)


def gap_between(a: Place, b: Place) -> float:
    """From the middle of the second to the first, mm; where one is a plane, to the plane."""
    if a.normal is not None:
        return abs(float((b.point - a.point) @ a.normal))
    if b.normal is not None:
        return abs(float((a.point - b.point) @ b.normal))
    return float(np.linalg.norm(across(a, b)))


def across(a: Place, b: Place) -> Vector:
    """From the one place to the middle of the other, mm: across a line where one of them is."""
    apart = b.point - a.point
    direction = a.direction if a.direction is not None else b.direction
    return apart if direction is None else apart - (apart @ direction) * direction


def skew(a: Place, b: Place) -> bool:
    """Whether two lines are so far from parallel that their distance is that along the common perpendicular."""
    if a.direction is None or b.direction is None:
        return False
    return bool(np.linalg.norm(np.cross(a.direction, b.direction)) > np.sin(_SKEW))


def angle_between(a: Place, b: Place) -> float:
    """The angle of two planes, as they face, 0° to 180°; of two lines, or a line and a plane, 0° to 90°."""
    first, second = a.way, b.way
    cosine = float(first @ second)
    cosine = cosine if a.direction is None and b.direction is None else abs(cosine)
    # By sine and cosine both: a right angle and none are told as well as any.
    angle = float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), cosine)))
    return angle if (a.direction is None) == (b.direction is None) else 90.0 - angle


def step_between(a: Place, b: Place) -> float:
    """How high the middle of the second plane is over the first, mm."""
    assert a.normal is not None
    return float((b.point - a.point) @ a.normal)


def flush_between(a: Plane, b: Plane, seam: Vector) -> float:
    """How high the second plane is over the first at a place between them, along the first's normal, mm."""
    on_first = float((a.point - seam) @ a.axis)
    on_second = float((b.point - seam) @ b.axis) / float(a.axis @ b.axis)
    return on_second - on_first


@dataclass(frozen=True)
class Shapes:
    """The shapes that were fitted, and what is made of them.

    Attributes:
        fitted: by name.
        made: features of two planes, by name.
        seams: for each flush dimension, the place where it is taken.
    """

    fitted: dict[str, Shape]
    made: dict[str, Feature]
    seams: dict[str, Vector]

    def moved(self, name: str, by: Float[np.ndarray, "numbers"]) -> "Shapes":
        """With the numbers of one shape changed."""
        return replace(self, fitted={**self.fitted, name: self.fitted[name].moved(by)})

    def place(self, name: str) -> Place:
        """What a feature stands for."""
        if name in self.fitted:
            return place_of(self.fitted[name])
        feature = self.made[name]
        a, b = (self.plane(each) for each in feature.of)
        return edge_of(a, b) if feature.kind == "edge" else slot_of(a, b)

    def plane(self, name: str) -> Plane:
        """A feature that is a plane."""
        shape = self.fitted[name]
        assert isinstance(shape, Plane)
        return shape

    def fitted_of(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """The fitted shapes that features are made of."""
        parts = [self.made[name].of if name in self.made else (name,) for name in names]
        return tuple(dict.fromkeys(name for part in parts for name in part))

    def value(self, dimension: Dimension) -> float:
        """The value of a dimension that shapes alone determine: mm, ° or mm³."""
        kind, of = dimension.kind, dimension.of
        if kind in ("radius", "diameter"):
            radius = float(self.fitted[of[0]].radius)  # type: ignore[attr-defined]  # the reader has seen to the kind
            return radius if kind == "radius" else 2 * radius
        if kind == "cone_angle":
            cone = self.fitted[of[0]]
            assert isinstance(cone, Cone)
            return float(np.degrees(2 * cone.half_angle))
        if kind == "width":
            return width_of(*(self.plane(name) for name in self.made[of[0]].of))
        if kind == "flush":
            return flush_between(self.plane(of[0]), self.plane(of[1]), self.seams[dimension.name])
        a, b = (self.place(name) for name in of)
        of_two = {"angle": angle_between, "step": step_between, "gap": gap_between}
        return of_two.get(kind, distance_between)(a, b)


@dataclass(frozen=True)
class Fold:
    """Where errors turn a dimension back: a distance at 0, an angle at 0° and at its largest.

    Attributes:
        at: this value.
        sideways: for shapes near those that were fitted, their errors across the direction in which the dimension is
            measured, in its unit: none, one or two.
    """

    at: float
    sideways: Callable[[Shapes], Float[np.ndarray, "k"]]


def fold_of(shapes: Shapes, dimension: Dimension) -> Fold | None:
    """The fold that a dimension is nearest to; None for one that has a sign, or a size of its own."""
    none = Fold(0.0, lambda _: np.zeros(0))
    if dimension.kind == "width":
        return none
    if dimension.kind not in ("distance", "gap", "angle"):
        return None
    names = dimension.of
    a, b = (shapes.place(name) for name in names)
    if dimension.kind == "angle":
        return _fold_of_angle(names, a, b)
    if a.normal is not None or b.normal is not None or (dimension.kind == "distance" and skew(a, b)):
        return none
    v = across(a, b)
    direction = a.direction if a.direction is not None else b.direction
    basis = _beside(v, direction)
    return Fold(0.0, lambda moved: basis @ across(*(moved.place(name) for name in names)))


def _fold_of_angle(names: tuple[str, ...], a: Place, b: Place) -> Fold:
    first, second = a.way, b.way
    planes = (a.normal is not None) + (b.normal is not None)
    sign = 1.0 if first @ second >= 0 else -1.0
    if abs(first @ second) < np.sqrt(0.5):
        # Two lines never make more than 90°, a line and a plane never less than 0°; two planes have no fold there.
        return Fold(90.0 if planes == 0 else 0.0, lambda _: np.zeros(0))
    basis = _beside(sign * second - first, first)

    def tilt(moved: Shapes) -> Float[np.ndarray, "1"]:
        one, other = (moved.place(name).way for name in names)
        return np.degrees(basis @ (np.sign(one @ other) * other - one))

    return Fold(90.0 if planes == 1 else 180.0 if planes == 2 and sign < 0 else 0.0, tilt)


def _beside(v: Vector, direction: Vector | None) -> Float[np.ndarray, "k 3"]:
    """Unit vectors across v: two, or the one that is across a direction too."""
    given = [v] if direction is None else [v, direction]
    # Of no length at all, v has any direction.
    rows = np.stack([each / max(float(np.linalg.norm(each)), 1e-300) for each in given])
    return np.linalg.svd(rows)[2][len(given) :]
