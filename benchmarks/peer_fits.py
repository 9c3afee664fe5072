"""Dimensions as a user of pyRANSAC-3D or Open3D measures them: shapes by RANSAC, then unweighted least squares.

Each feature gets the points of its region, as ours does; one that grows gets the whole cloud. RANSAC takes the shape
with the most points within a distance that the user sets (M. A. Fischler and R. C. Bolles, 1981). pyRANSAC-3D itself is
asked for planes and balls where it is installed (`pip install pyransac3d`; its cylinders, it says itself, are not good
on real points). Otherwise shapes are drawn from the fewest points that determine them, cylinders and cones with
normals, as PCL does. The peers have no sections.
"""

import importlib
import random as python_random
from importlib.util import find_spec
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from jaxscan.files.part_file import FITTED, OF_TWO_PLANES, Dimension, Part
from jaxscan.measurement.dimensions import Shapes
from jaxscan.measurement.guess import candidates
from jaxscan.measurement.shapes import Ball, Plane, Points, Shape, Vector

_KINDS: Final = ("radius", "distance", "step", "angle", "cone_angle", "width")
_TRIALS: Final = 1000
_SAMPLE: Final = 800


def peer_shapes(cloud: Points, part: Part, within: float, camera: Vector) -> Shapes:
    """The shapes of a part's features in a cloud, object frame, mm.

    Args:
        cloud: all points.
        part: what is to be measured.
        within: how near to a shape its points lie, mm.
        camera: planes face it.
    """
    fitted: dict[str, Shape] = {}
    for feature in part.features:
        if feature.kind in FITTED:
            assert feature.region is not None
            x = cloud if feature.grow else cloud[feature.region.holds(cloud)]
            fitted[feature.name] = _fitted(ransac(feature.kind, x, within), x, within, camera)
    made = {feature.name: feature for feature in part.features if feature.kind in OF_TWO_PLANES}
    return Shapes(fitted, made, {})


def has(shapes: Shapes, dimension: Dimension) -> bool:
    """Whether a peer measures this."""
    return dimension.kind in _KINDS and all(name in shapes.fitted for name in shapes.fitted_of(dimension.of))


def ransac(kind: str, x: Points, within: float) -> Shape:
    """The shape that the most points lie within a distance of, mm."""
    if kind in ("plane", "ball") and find_spec("pyransac3d") is not None:
        return _by_pyransac3d(kind, x, within)
    random = np.random.default_rng(0)
    sample = x[random.permutation(len(x))[:_SAMPLE]]
    middle = sample.mean(axis=0)
    size = float(np.linalg.norm(np.ptp(sample, axis=0)))
    y = (sample - middle) / size
    best = max(candidates(kind, y, random), key=lambda shape: int((np.abs(shape.distances(y)) <= within / size).sum()))
    radius = {"radius": size * best.radius} if hasattr(best, "radius") else {}  # type: ignore[attr-defined]
    return type(best)(**{**vars(best), "point": middle + size * best.point, "size": size, **radius})


def _by_pyransac3d(kind: str, x: Points, within: float) -> Shape:
    peer = importlib.import_module("pyransac3d")
    # It draws by Python's own generator.
    python_random.seed(0)
    with np.errstate(all="ignore"):
        if kind == "plane":
            a, b, c, d = peer.Plane().fit(x, within, _TRIALS)[0]
            return Plane(-d * np.array([a, b, c]), np.array([a, b, c]), 1.0)
        centre, radius = peer.Sphere().fit(x, within, _TRIALS)[:2]
        return Ball(np.asarray(centre), np.array([0.0, 0.0, 1.0]), 1.0, float(radius))


def _fitted(shape: Shape, x: Points, within: float, camera: Vector) -> Shape:
    """Least squares of the distances of the points that lie near the shape."""
    near = x[np.abs(shape.distances(x)) <= within]
    shape = shape.placed(near)
    found = least_squares(lambda by: shape.moved(by).distances(near), np.zeros(shape.numbers), x_scale="jac")
    shape = shape.moved(found.x).placed(near)
    if isinstance(shape, Plane) and shape.axis @ (camera - shape.point) < 0:
        shape = Plane(shape.point, -shape.axis, shape.size)
    return shape


PEER: Final = "pyRANSAC-3D" if find_spec("pyransac3d") else "RANSAC"
