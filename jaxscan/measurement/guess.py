"""Where a shape may stand: few points drawn at random, judged by the median distance of all.

The least median of squares (P. J. Rousseeuw, 1984) holds up to where half of the points are of something else.
Cylinders and cones are drawn from points with normals, which are those of the planes through the points around each.
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxscan.errors import InputError
from jaxscan.geometry.robust_plane import planes_through
from jaxscan.measurement.shapes import Ball, Circle, Cone, Cylinder, Line, Plane, Points, Shape, Vector, across

_TRIALS: Final = 150
_SAMPLE: Final = 800
_SEED: Final = 2003
_AROUND: Final = 30
# A cone with half an opening angle below this is a cylinder, above its complement a plane.
_LEAST_ANGLE: Final = np.radians(0.5)
_NO_AXIS: Final = np.array([0.0, 0.0, 1.0])


def guess(kind: str, x: Points, normal: Vector | None = None) -> Shape:
    """A shape of a kind that at least half of the points lie near.

    Args:
        kind: plane, ball, cylinder, cone, circle or line.
        x: mm.
        normal: of the plane in which a circle or a line lies.

    Raises:
        InputError: the points determine none.
    """
    random = np.random.default_rng(_SEED)
    sample = x[random.permutation(len(x))[:_SAMPLE]]
    middle = sample.mean(axis=0)
    size = max(float(np.linalg.norm(np.ptp(sample, axis=0))), 1e-9)
    # About the middle, in units of the size: what is solved below is then well scaled.
    y = (sample - middle) / size
    best, least = None, np.inf
    for trial in candidates(kind, y, random, normal):
        off = float(np.median(np.abs(trial.distances(y))))
        if off < least:
            best, least = trial, off
    if best is None:
        raise InputError(f"its points determine no {kind}: they may lie on a line, or in one place; enlarge the region")
    scaled = {name: size * getattr(best, name) for name in ("radius",) if hasattr(best, name)}
    shape = type(best)(**{**vars(best), "point": middle + size * best.point, "size": size, **scaled})
    return shape.placed(sample)


def candidates(kind: str, y: Points, random: np.random.Generator, normal: Vector | None = None) -> list[Shape]:
    """Shapes of a kind, each through the fewest points that determine it, drawn at random.

    Args:
        kind: plane, ball, cylinder, cone, circle or line.
        y: scaled so that they are about 1 apart.
        random: draws them.
        normal: of the plane in which a circle or a line lies.
    """
    if kind in ("circle", "line"):
        assert normal is not None
        return (_circles if kind == "circle" else _lines)(y, normal, random)
    if kind in ("cylinder", "cone"):
        return (_cylinders if kind == "cylinder" else _cones)(y, _normals(y), random)
    return (_planes if kind == "plane" else _balls)(y, random)


def _drawn(y: Points, random: np.random.Generator, count: int) -> list[Points]:
    return [y[random.integers(len(y), size=_TRIALS)] for _ in range(count)]


def _planes(y: Points, random: np.random.Generator) -> list[Shape]:
    centres, normals = planes_through(*_drawn(y, random, 3))
    return [Plane(c, n, 1.0) for c, n in zip(centres, normals, strict=True)]


def _balls(y: Points, random: np.random.Generator) -> list[Shape]:
    """Through four points each: 2 (xᵢ − x₀) · c = |xᵢ|² − |x₀|²."""
    a, *others = _drawn(y, random, 4)
    A = 2 * np.stack([b - a for b in others], axis=1)
    right = np.stack([(b**2).sum(axis=1) - (a**2).sum(axis=1) for b in others], axis=1)
    proper = np.abs(np.linalg.det(A)) > 1e-9
    centres = np.linalg.solve(A[proper], right[proper][..., None])[..., 0]
    radii = np.linalg.norm(a[proper] - centres, axis=1)
    return [Ball(c, _NO_AXIS, 1.0, float(r)) for c, r in zip(centres, radii, strict=True)]


def _circles(y: Points, normal: Vector, random: np.random.Generator) -> list[Shape]:
    """Through three points each, in the plane."""
    u, v = across(normal)
    flat = np.stack([y @ u, y @ v], axis=1)
    chosen = random.integers(len(y), size=(3, _TRIALS))
    a, *others = flat[chosen]
    A = 2 * np.stack([b - a for b in others], axis=1)
    right = np.stack([(b**2).sum(axis=1) - (a**2).sum(axis=1) for b in others], axis=1)
    proper = np.abs(np.linalg.det(A)) > 1e-9
    centres = np.linalg.solve(A[proper], right[proper][..., None])[..., 0]
    radii = np.linalg.norm(a[proper] - centres, axis=1)
    out = normal * float(np.mean(y @ normal))
    return [Circle(out + c[0] * u + c[1] * v, normal, 1.0, float(r)) for c, r in zip(centres, radii, strict=True)]


def _lines(y: Points, normal: Vector, random: np.random.Generator) -> list[Shape]:
    """Through two points each."""
    a, b = _drawn(y, random, 2)
    length = np.linalg.norm(b - a, axis=1)
    proper = length > 1e-6
    axes = (b - a)[proper] / length[proper, None]
    return [Line(c, axis, 1.0, normal) for c, axis in zip(a[proper], axes, strict=True)]


def _cylinders(y: Points, normals: Points, random: np.random.Generator) -> list[Shape]:
    """The axis at right angles to two normals, and where the two meet as seen along it."""
    i, j = random.integers(len(y), size=(2, _TRIALS))
    axes = np.cross(normals[i], normals[j])
    length = np.linalg.norm(axes, axis=1)
    found: list[Shape] = []
    for k in np.flatnonzero(length > 0.05):
        axis = axes[k] / length[k]
        u, v = across(axis)
        flat = np.stack([u, v])
        A = np.stack([flat @ normals[i[k]], -(flat @ normals[j[k]])], axis=1)
        if abs(np.linalg.det(A)) < 1e-3:
            continue
        t = np.linalg.solve(A, flat @ (y[j[k]] - y[i[k]]))[0]
        point = y[i[k]] + t * normals[i[k]]
        radius = float(np.median(np.linalg.norm(np.cross(y - point, axis), axis=1)))
        found.append(Cylinder(point, axis, 1.0, radius))
    return found


def _cones(y: Points, normals: Points, random: np.random.Generator) -> list[Shape]:
    """The tip where three tangent planes meet; the axis at right angles to the differences of unit vectors from it."""
    i = random.integers(len(y), size=(_TRIALS, 3))
    N = normals[i]
    proper = np.abs(np.linalg.det(N)) > 1e-3
    tips = np.linalg.solve(N[proper], (N[proper] * y[i[proper]]).sum(axis=2)[..., None])[..., 0]
    found: list[Shape] = []
    for tip, chosen in zip(tips, i[proper], strict=True):
        away = y[chosen] - tip
        length = np.linalg.norm(away, axis=1, keepdims=True)
        if length.min() < 1e-3:
            continue
        a, b, c = away / length
        axis = np.cross(b - a, c - a)
        if np.linalg.norm(axis) < 1e-9:
            continue
        axis /= np.linalg.norm(axis)
        axis = -axis if axis @ a < 0 else axis
        angle = float(np.arccos(np.clip(axis @ a, -1.0, 1.0)))
        if _LEAST_ANGLE < angle < np.pi / 2 - _LEAST_ANGLE:
            along = float(axis @ (y.mean(axis=0) - tip))
            found.append(Cone(tip + along * axis, axis, 1.0, along * np.tan(angle), angle))
    return found


def _normals(y: Points) -> Float[np.ndarray, "points 3"]:
    """The unit normal of the plane through the points around each."""
    index = KDTree(y).query(y, min(_AROUND, len(y)))[1]
    near = y[index] - y[index].mean(axis=1, keepdims=True)
    return np.linalg.eigh(near.swapaxes(1, 2) @ near)[1][:, :, 0]
