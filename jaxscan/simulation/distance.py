"""The distance of points from the true surface of a scene: the nearest piece of any body's boundary, in closed form.

The nearest boundary point of a solid lies within one of its surfaces, or on an edge where two of them meet, or at a
corner. Candidates for all of these are computed, those that are no boundary points (outside the solid, cut away, or
buried within another body) are dropped, and the nearest of the rest is it.

- On one surface with signed distance f and unit normal n: p − f n, exact for planes, spheres and cylinders.
- On an edge, f₁ = f₂ = 0: Newton's method on the two constraints, started at p, each step the point nearest to p on
  their linearisations, x ← p − Nᵀ (N Nᵀ)⁻¹ (f(x) + N (p − x)), rows of N the normals. It converges to 1e-9 mm for
  points nearer to the edge than about a third of its radius of curvature; no wrong point can come of it further away,
  for what is not on the boundary is dropped. An edge is no nearer than either of its surfaces, so only those are tried
  whose surfaces are both nearer than what has been found.
- Where two bodies meet in a crease, the same between a surface of the one and a surface of the other: seen from within,
  the nearest points of both may be buried.
- Boxes, plates and meshes have candidates of their own, which include their corners.
"""

from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscan.kept_programs import compiled
from jaxscan.precision import float64
from jaxscan.simulation.mesh import Mesh
from jaxscan.simulation.plate import Plate
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.solids import Box, Shape, Solid, Union
from jaxscan.simulation.vector import Vec

# A candidate further than this from the boundary is none, mm.
_ON_BOUNDARY_MM = 1e-6
_NEWTON_STEPS = 20
# Normals whose squared sine is smaller make no edge.
_PARALLEL = 1e-9
_POINTS_AT_ONCE = 1 << 13


def distance(scene: Scene, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    """The distance of each point from the nearest surface of the scene at motor step 0.

    A mesh has no inside here: it buries nothing.

    Args:
        scene: what the points were measured on.
        points: object frame, mm. A point that is NaN has the distance NaN.

    Returns:
        Millimetres, float64, not negative.
    """
    points = np.asarray(points, np.float64)
    best = np.full(len(points), np.nan)
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    with float64():
        scene = scene.cast(np.float64)
        for some in _lots(finite):
            best[some] = _distance(scene, points[some])
    return best


def _distance(scene: Scene, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    """The same for one lot of points."""
    shapes = [body.shape for body in scene.bodies]
    others = [tuple(s for s in shapes if s is not own and isinstance(s, Solid)) for own in shapes]
    best = np.full(len(points), np.inf)
    for shape, rest in zip(shapes, others, strict=True):
        best = np.minimum(best, _on_faces(shape, rest, points))
    for shape, rest in zip(shapes, others, strict=True):
        if isinstance(shape, Solid) and not isinstance(shape, Plate | Box):
            _lower_by_edges(best, shape, rest, points)
    _lower_by_creases(best, [shape for shape in shapes if isinstance(shape, Solid)], points)
    return best


def _lower_by_creases(
    best: Float[np.ndarray, "points"], solids: list[Solid], points: Float[np.ndarray, "points 3"]
) -> None:
    """Put the distance to a line where two solids meet wherever it is less than what has been found.

    In such a crease the nearest points of either may lie within the other. As on an edge, none but solids that are both
    nearer than what has been found are tried.
    """
    lots = _lots(np.arange(len(points)))
    heights = [
        np.concatenate([np.asarray(_height(s, _filled(points[lot])))[: len(lot)] for lot in lots]) for s in solids
    ]
    for (i, a), (j, b) in combinations(enumerate(solids), 2):
        near = np.flatnonzero(np.maximum(np.abs(heights[i]), np.abs(heights[j])) < best)
        rest = tuple(solid for solid in solids if solid is not a and solid is not b)
        for some in _lots(near):
            lower = best[some]
            _lower_by_edges(lower, Union(a, b), rest, points[some])
            best[some] = lower


@compiled()
def _height(solid: Solid, x: Float[Array, "points 3"]) -> Float[Array, "points"]:
    return solid.height(Vec(x[:, 0], x[:, 1], x[:, 2]))


def _lots(items: Int[np.ndarray, "items"]) -> list[Int[np.ndarray, "some"]]:
    return [items[start : start + _POINTS_AT_ONCE] for start in range(0, len(items), _POINTS_AT_ONCE)]


def _filled(array: Array | np.ndarray) -> Array:
    """An array filled up to the lot's size with its first item, so that a second lot compiles nothing again."""
    return jnp.asarray(np.concatenate([array, np.repeat(array[:1], _POINTS_AT_ONCE - len(array), axis=0)]))


def _on_faces(
    shape: Shape, others: tuple[Solid, ...], points: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, "points"]:
    """The distance to the nearest point within a surface of one body."""
    lot = _filled(points)
    if isinstance(shape, Mesh):
        candidates, own = _filled(shape.closest(points))[None], ()
    else:
        candidates, own = _candidates(shape, lot), (shape,)
    return np.asarray(_nearest(own, others, candidates, lot))[: len(points)]


def _lower_by_edges(
    best: Float[np.ndarray, "points"], solid: Solid, others: tuple[Solid, ...], points: Float[np.ndarray, "points 3"]
) -> None:
    """Put the distance to an edge of the solid wherever it is less than what has been found."""
    heights = np.abs(np.asarray(_constraints(solid, _filled(points))[0]))[:, : len(points)]
    pairs = np.asarray(list(combinations(range(len(heights)), 2)), np.int32).reshape(-1, 2)
    pair, point = np.nonzero(np.maximum(heights[pairs[:, 0]], heights[pairs[:, 1]]) < best)
    for some in _lots(np.arange(len(point))):
        lot = _filled(points[point[some]])
        candidates = _on_edge(solid, lot, _filled(pairs[pair[some]]))[None]
        np.minimum.at(best, point[some], np.asarray(_nearest((solid,), others, candidates, lot))[: len(some)])


@compiled()
def _nearest(
    own: tuple[Solid, ...], others: tuple[Solid, ...], candidates: Float[Array, "candidates points 3"], points: Array
) -> Float[Array, "points"]:
    """The distance to the nearest candidate that is on the boundary of its own solid and not within another."""
    x = Vec(candidates[..., 0], candidates[..., 1], candidates[..., 2])
    there = jnp.ones(x.x.shape, bool)
    for solid in own:
        there = there & (jnp.abs(solid.height(x)) < _ON_BOUNDARY_MM)
    for solid in others:
        there = there & (solid.height(x) > -_ON_BOUNDARY_MM)
    away = jnp.sqrt(((candidates - points[None]) ** 2).sum(-1))
    return jnp.where(there, away, jnp.inf).min(0)


@compiled()
def _candidates(solid: Solid, points: Float[Array, "points 3"]) -> Float[Array, "candidates points 3"]:
    if isinstance(solid, Plate):
        return _on_plate(solid, points)
    if isinstance(solid, Box):
        return _on_box(solid, points)
    heights, normals = _constraints(solid, points)
    return points[None] - heights[..., None] * normals


@compiled()
def _constraints(
    solid: Solid, x: Float[Array, "points 3"]
) -> tuple[Float[Array, "surfaces points"], Float[Array, "surfaces points 3"]]:
    """Signed distances from a solid's surfaces, and unit normals."""
    surfaces = solid.surfaces(Vec(x[:, 0], x[:, 1], x[:, 2]))
    shape = x[:, 0].shape
    normals = jnp.stack([jnp.stack([jnp.broadcast_to(c, shape) for c in surface.normal], -1) for surface in surfaces])
    heights = jnp.stack([jnp.broadcast_to(surface.distance, shape) for surface in surfaces])
    length = jnp.linalg.norm(normals, axis=-1, keepdims=True)
    return heights, normals / jnp.where(length > 0, length, 1)


@compiled()
def _on_edge(solid: Solid, points: Float[Array, "points 3"], pairs: Int[Array, "points 2"]) -> Float[Array, "points 3"]:
    """The nearest point where two surfaces meet, for each point a pair of its own."""
    which = jnp.arange(points.shape[0])

    def step(_: int, x: Float[Array, "points 3"]) -> Float[Array, "points 3"]:
        heights, normals = _constraints(solid, x)
        (f, n), (g, m) = ((heights[pairs[:, i], which], normals[pairs[:, i], which]) for i in (0, 1))
        a = f + (n * (points - x)).sum(-1)
        b = g + (m * (points - x)).sum(-1)
        cosine = (n * m).sum(-1)
        sine2 = 1 - cosine**2
        safe = jnp.where(sine2 > _PARALLEL, sine2, 1)
        return points - ((a - cosine * b) / safe)[:, None] * n - ((b - cosine * a) / safe)[:, None] * m

    return jax.lax.fori_loop(0, _NEWTON_STEPS, step, points)


def _on_plate(plate: Plate, points: Float[Array, "points 3"]) -> Float[Array, "1 points 3"]:
    """The nearest point of the rectangle."""
    axes = jnp.stack([jnp.asarray(plate.x_axis), jnp.asarray(plate.y_axis)])
    local = jnp.clip((points - plate.origin[None]) @ axes.T, plate.low[None], plate.high[None])
    return (plate.origin[None] + local @ axes)[None]


def _on_box(box: Box, points: Float[Array, "points 3"]) -> Float[Array, "6 points 3"]:
    """The nearest point of each face."""
    local = jnp.clip((points - box.centre[None]) @ box.axes.T, -box.half[None], box.half[None])
    faces = [local.at[:, i].set(sign * box.half[i]) for i in range(3) for sign in (-1, 1)]
    return jnp.stack([box.centre[None] + face @ box.axes for face in faces])
