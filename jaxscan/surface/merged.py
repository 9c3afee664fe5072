"""All sides as one surface, on which every point weighs by its own σ.

The surface is where f(x) = 0,

    f(x) = Σ wᵢ nᵢ′ · (x − pᵢ) / Σ wᵢ,    wᵢ = exp(−tᵢ² / h² − aᵢ² / (h² + 9 σᵢ²)) / σᵢ²,

over the points of all sides around x that face as the nearest one does (R. Kolluri, "Provably good moving least
squares", 2005), with aᵢ the part of x − pᵢ along pᵢ's normal and tᵢ that across it. Where two sides err in opposite
directions, as beside the edge of a dark patch, they lie in two layers. Were distances alike in all directions, f would
be zero on each of them, and the surface a pile of flakes. nᵢ′ halves the angle between pᵢ's normal and their weighted
mean: with pᵢ's own normal alone f would be off by h²/2r on a surface of radius r, so it is right to the second order.

f is sampled on the cubes around the points, and each cube in which it changes its sign gets a vertex (S. Gibson,
"Constrained elastic surface nets", 1998), which then moves along the normal to where f is zero. A vertex without points
on all sides of it lies beyond the rim of what was seen, and is left out: nothing is invented.

σ of a vertex is what its points say, widened by what the sides say of one another: χ² = Σ (fₛ − f̄)² / σₛ² over the
sides around it, with fₛ and σₛ by the points of one side. Errors that neighbours share, as beside paint, under a rough
patch or by a registration that is a little off, do not become less in a mean, and show there alone (R. T. Birge 1932).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import KDTree

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud
from jaxscan.geometry import Pose
from jaxscan.surface.mean_sigma import mean_sigma
from jaxscan.surface.scattered import poisson_surface
from jaxscan.surface.side import Side

# h, and where points end to count, in spacings of the sides.
_WIDTH, _REACH = 0.5, 1.2
_MOST_AROUND: Final = 64
# Points whose normals differ by more than 16° are across a crease, unless their σ tilt a line over a spacing as far.
_SAME_WAY: Final = np.radians(16.0)
# Along its normal a point is as near as it is within this number of σ: two layers of one surface are no two surfaces.
_SIGMAS: Final = 3.0
# Distance of the vertices, in spacings.
_CUBE: Final = 0.7
# A vertex of Poisson's surface is on what was seen where their normals differ by less than 60°.
_ALIKE: Final = 0.5
# Points further from their common surface than this, in units of σ, count less and less (Tukey).
_TUKEY: Final = 4.685
# Points around a place leave no gap of more than this, as seen from it, where it is not beyond their rim.
_LARGEST_GAP: Final = np.pi
# Between neighbours in the grid f changes by no more than this part of their distance, where it is the same surface.
_STEEPEST: Final = 1.5
_ROUNDS: Final = 2
# Sides disagree where each has this much of a point; χ² is taken from this number of vertices around, and from all as
# if there were as many more as the second says; no side counts for more than this χ².
_PRESENT, _VERTICES, _OF_ALL, _LARGEST = 0.5, 40, 10.0, 25.0
# Floors are the same where their normals differ by no more than 5°.
_SAME_FLOOR: Final = np.cos(np.radians(5.0))
# Poisson's octree is this number of levels finer than the spacing, within limits.
_FINER: Final = 1
_DEPTHS: Final = (5, 10)
# Walls that were not seen bulge.
_ROOM: Final = 1.5
_AT_ONCE: Final = 1 << 14
_MOST_CUBES: Final = 1 << 26


@dataclass(frozen=True)
class Merged:
    """A surface of several sides.

    Attributes:
        mesh: in the first side's frame, mm.
        sigma: of each vertex along its normal, of rig and pixel together, mm, by the points it comes of; NaN where
            nothing was seen, or the rig's part is not known.
        sigma_pixel: the pixel's part of it, mm; NaN where nothing was seen.
        sides: how many sides have points there.
        disagreement: how far sides are apart, in units of what the σ of their points lets expect; `sigma_pixel` is
            widened by it, part by part, where it is more than 1. None where no place was seen from two sides.
    """

    mesh: trimesh.Trimesh
    sigma: Float[np.ndarray, "vertices"]
    sigma_pixel: Float[np.ndarray, "vertices"]
    sides: Int[np.ndarray, "vertices"]
    disagreement: float | None = None

    def cloud(self) -> Cloud:
        """The vertices with the parts of σ that are known of all of them."""
        parts = [part.astype(np.float32) for part in (self.sigma, self.sigma_pixel)]
        known = (part if np.isfinite(part).all() else None for part in parts)
        return Cloud(np.asarray(self.mesh.vertices, np.float32), *known)


@dataclass(frozen=True)
class _At:
    """What the points say at some places."""

    f: Float[np.ndarray, "places"]
    normal: Float[np.ndarray, "places 3"]
    seen: Bool[np.ndarray, "places"]
    sigma: Float[np.ndarray, "places"]
    sigma_pixel: Float[np.ndarray, "places"]
    sides: Int[np.ndarray, "places"]


class _Around(NamedTuple):
    """The points around some places.

    Attributes:
        nearest: how far the nearest one is, mm.
        which: their numbers.
        there: whether they count.
        weight: by how much.
        distance: of the place from each one's plane, with its sign, mm.
        offset: from each to the place, mm.
        normal: the mean of their normals.
    """

    nearest: Float[np.ndarray, "places"]
    which: Int[np.ndarray, "places points"]
    there: Bool[np.ndarray, "places points"]
    weight: Float[np.ndarray, "places points"]
    distance: Float[np.ndarray, "places points"]
    offset: Float[np.ndarray, "places points 3"]
    normal: Float[np.ndarray, "places 3"]


class _Points:
    """The points of all sides in the common frame."""

    def __init__(self, sides: Sequence[Side], poses: Sequence[Pose]):
        self.points = np.concatenate([T.apply(side.points) for side, T in zip(sides, poses, strict=True)])
        self.normals = np.concatenate([side.normals @ T.matrix().T for side, T in zip(sides, poses, strict=True)])
        self.sigma = np.concatenate([side.sigma for side in sides])
        self.sigma_rig = np.concatenate(
            [np.full(len(side.points), np.nan) if side.sigma_rig is None else side.sigma_rig for side in sides]
        )
        self.side = np.repeat(np.arange(len(sides)), [len(side.points) for side in sides])
        self.spacing = float(np.median([side.spacing_mm for side in sides]))
        self.count = len(sides)
        self.tree = KDTree(self.points)

    def at(self, places: Float[np.ndarray, "places 3"]) -> _At:
        """F and what goes with it."""
        lots = [self._at(places[start : start + _AT_ONCE]) for start in range(0, len(places), _AT_ONCE)]
        return _At(*(np.concatenate([getattr(lot, name) for lot in lots]) for name in _At.__dataclass_fields__))

    def _at(self, x: Float[np.ndarray, "places 3"]) -> _At:
        nearest, index, there, weight, distance, offset, mean = self._around(x)
        sigma = self.sigma[index]
        # Twice: with all points, and without those that are off the surface of the others.
        f = np.zeros(len(x))
        for _ in range(2):
            total = np.maximum(weight.sum(axis=1), 1e-300)
            f = (weight * distance).sum(axis=1) / total
            u = (distance - f[:, None]) / (_TUKEY * np.hypot(sigma, 0.1 * self.spacing))
            weight = weight * np.clip(1 - u**2, 0, None) ** 2
        total = weight.sum(axis=1)
        safe = np.maximum(total, 1e-300)
        seen = (total > 0) & (nearest <= self.spacing) & (_gap(offset, mean, there) < _LARGEST_GAP)
        present = np.zeros((len(x), self.count), bool)
        np.logical_or.at(present, (np.arange(len(x))[:, None], self.side[index]), there)
        error = mean_sigma(weight / safe[:, None], sigma, self.sigma_rig[index])
        return _At(np.where(total > 0, f, np.nan), mean, seen, *error, present.sum(axis=1))

    def _around(self, x: Float[np.ndarray, "places 3"]) -> _Around:
        reach, h = _REACH * self.spacing, _WIDTH * self.spacing
        away, index = self.tree.query(x, _MOST_AROUND, distance_upper_bound=reach)
        there = np.isfinite(away)
        index = np.where(there, index, 0)
        normal = self.normals[index]
        offset = x[:, None] - self.points[index]
        sigma = self.sigma[index]
        tilt = np.minimum(np.hypot(sigma, sigma[:, :1]) / self.spacing, 1.0)
        there &= (normal * normal[:, :1]).sum(axis=2) > np.cos(np.hypot(_SAME_WAY, tilt))
        squared = np.where(there, away, 0.0) ** 2
        along = np.minimum((normal * offset).sum(axis=2) ** 2, squared)
        squared = (squared - along) / h**2 + along / (h**2 + (_SIGMAS * sigma) ** 2)
        weight = np.where(there, np.exp(-squared) / sigma**2, 0.0)
        mean = (weight[..., None] * normal).sum(axis=1)
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        half = normal + mean[:, None]
        half /= np.maximum(np.linalg.norm(half, axis=2, keepdims=True), 1e-300)
        return _Around(away[:, 0], index, there, weight, (half * offset).sum(axis=2), offset, mean)

    def disagreement(
        self, places: Float[np.ndarray, "places 3"]
    ) -> tuple[Float[np.ndarray, "places"], Float[np.ndarray, "places"]]:
        """χ² of the sides around each place, and how many more than one there are."""
        lots = [self._disagreement(places[start : start + _AT_ONCE]) for start in range(0, len(places), _AT_ONCE)]
        chi2, freedom = (np.concatenate(parts) for parts in zip(*lots, strict=True))
        return chi2, freedom

    def _disagreement(
        self, x: Float[np.ndarray, "places 3"]
    ) -> tuple[Float[np.ndarray, "places"], Float[np.ndarray, "places"]]:
        around = self._around(x)
        weight, sigma, side = around.weight, self.sigma[around.which], self.side[around.which]
        f, precision = np.zeros((2, self.count, len(x)))
        for k in range(self.count):
            own = np.where(side == k, weight, 0.0)
            total = own.sum(axis=1)
            enough = (own * sigma**2).sum(axis=1) >= _PRESENT
            f[k] = (own * around.distance).sum(axis=1) / np.maximum(total, 1e-300)
            precision[k] = np.where(enough, total**2 / np.maximum(((own * sigma) ** 2).sum(axis=1), 1e-300), 0.0)
        middle = (precision * f).sum(axis=0) / np.maximum(precision.sum(axis=0), 1e-300)
        chi2 = np.minimum(precision * (f - middle) ** 2, _LARGEST).sum(axis=0)
        return chi2, np.maximum((precision > 0).sum(axis=0) - 1.0, 0.0)

    def settled(self, places: Float[np.ndarray, "places 3"]) -> tuple[Float[np.ndarray, "places 3"], _At]:
        """Places moved along the normal to where f is zero; where nothing was seen they stay."""
        found = self.at(places)
        for _ in range(_ROUNDS):
            step = np.clip(np.nan_to_num(found.f), -self.spacing, self.spacing)
            places = places - step[:, None] * found.normal
            found = self.at(places)
        return places, found


def merge(sides: Sequence[Side], poses: Sequence[Pose], *, cube_mm: float | None = None) -> Merged:
    """The open surface of all sides, only where it was seen.

    Args:
        sides: registered.
        poses: T_first_side of each.
        cube_mm: distance of the vertices; by default 0.7 of the sides' spacing.

    Raises:
        InputError: the size is not positive, makes too many cubes, or gives no surface.
    """
    points = _Points(sides, poses)
    size = _CUBE * points.spacing if cube_mm is None else cube_mm
    if not size > 0:
        raise InputError(f"cubes of {size:g} mm: give a size that is more than 0")
    vertices, quads = _nets(points, size)
    vertices, found = points.settled(vertices)
    good = found.seen & np.isfinite(found.f) & (np.abs(found.f) < 0.5 * size)
    faces = _triangles(vertices, quads, good)
    if not len(faces):
        raise InputError("these points give no surface: give a larger --cube")
    used, faces = np.unique(faces, return_inverse=True)
    mesh = trimesh.Trimesh(vertices[used], faces.reshape(-1, 3), process=False)
    apart, sigma, pixel = _widened(points, vertices[used], found.sigma[used], found.sigma_pixel[used])
    return Merged(mesh, sigma, pixel, found.sides[used], apart)


def _widened(
    points: _Points,
    vertices: Float[np.ndarray, "vertices 3"],
    sigma: Float[np.ndarray, "vertices"],
    pixel: Float[np.ndarray, "vertices"],
) -> tuple[float | None, Float[np.ndarray, "vertices"], Float[np.ndarray, "vertices"]]:
    """How far the sides are apart over all, and the σ of the vertices, widened by it in part and whole."""
    chi2, freedom = points.disagreement(vertices)
    shared = freedom > 0
    if shared.sum() < _VERTICES:
        return None, sigma, pixel
    of_all = chi2[shared].sum() / freedom[shared].sum()
    _, near = KDTree(vertices[shared]).query(vertices, _VERTICES)
    sums, counts = chi2[shared][near].sum(axis=1), freedom[shared][near].sum(axis=1)
    factor2 = np.maximum((sums + _OF_ALL * of_all) / (counts + _OF_ALL), 1.0)
    wider = pixel * np.sqrt(factor2)
    return float(np.sqrt(of_all)), np.sqrt(sigma**2 + wider**2 - pixel**2), wider


def merge_closed(sides: Sequence[Side], poses: Sequence[Pose]) -> Merged:
    """A closed surface of all sides: screened Poisson, and where it was seen moved to where f is zero.

    Where all sides stood on one face of the object, that face is the floor's plane under it, for it was never seen.

    Raises:
        InputError: as `poisson_surface`.
    """
    points = _Points(sides, poses)
    places, found = points.settled(points.points)
    good = found.seen & np.isfinite(found.f)
    cap, down = _underside(sides, poses, places[good], points.spacing)
    places, normals = np.concatenate([places[good], cap]), np.concatenate([found.normal[good], down])
    depth = int(np.ceil(np.log2(np.ptp(places, axis=0).max() / points.spacing))) + _FINER
    mesh = poisson_surface(places, normals, int(np.clip(depth, *_DEPTHS)), _ROOM)
    vertices, found = points.settled(np.asarray(mesh.vertices))
    seen = found.seen & np.isfinite(found.f) & ((found.normal * mesh.vertex_normals).sum(axis=1) > _ALIKE)
    vertices = np.where(seen[:, None], vertices, mesh.vertices)
    mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
    sigma, pixel = (np.where(seen, part, np.nan) for part in (found.sigma, found.sigma_pixel))
    apart, sigma[seen], pixel[seen] = _widened(points, vertices[seen], sigma[seen], pixel[seen])
    return Merged(mesh, sigma, pixel, np.where(seen, found.sides, 0), apart)


def _underside(
    sides: Sequence[Side], poses: Sequence[Pose], places: Float[np.ndarray, "points 3"], spacing: float
) -> tuple[Float[np.ndarray, "cap 3"], Float[np.ndarray, "cap 3"]]:
    """Points of the floor under the object, and their normals, downwards; none where the floor was not the same."""
    none = np.zeros((0, 3)), np.zeros((0, 3))
    first = sides[0].floor
    if first is None:
        return none
    for side, T in zip(sides, poses, strict=True):
        if side.floor is None or (T.matrix() @ side.floor.up) @ first.up < _SAME_FLOOR:
            return none
        if abs(first.height(T.apply(side.floor.frame.translation))) > spacing + first.tolerance_mm:
            return none
    flat = first.frame.inverse().apply(places)[:, :2]
    low = flat.min(axis=0)
    at = np.round((flat - low) / spacing).astype(int) + 2
    covered = np.zeros(at.max(axis=0) + 3, bool)
    covered[tuple(at.T)] = True
    covered = np.asarray(ndimage.binary_fill_holes(ndimage.binary_closing(covered, iterations=2)))
    x, y = (low + spacing * (np.argwhere(covered) - 2)).T
    cap = first.frame.apply(np.stack([x, y, np.zeros_like(x)], axis=1))
    return cap, np.broadcast_to(-first.up, cap.shape)


def _gap(
    offset: Float[np.ndarray, "places points 3"],
    normal: Float[np.ndarray, "places 3"],
    there: Bool[np.ndarray, "places points"],
) -> Float[np.ndarray, "places"]:
    """The widest angle without a point around each place, as seen along the normal, radians."""
    start = np.where(np.abs(normal[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    u = np.cross(normal, start)
    v = np.cross(normal, u)
    angle = np.arctan2((offset * v[:, None]).sum(axis=2), (offset * u[:, None]).sum(axis=2))
    # u and v are of one length; places without a point repeat the first one's direction.
    angle = np.sort(np.where(there, angle, angle[:, :1]), axis=1)
    return np.maximum(np.diff(angle, axis=1).max(axis=1), angle[:, 0] + 2 * np.pi - angle[:, -1])


def _nets(points: _Points, size: float) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "quads 4"]]:
    """A vertex in each cube that f = 0 goes through, and a quadrilateral around each side of a cube that it crosses."""
    low = points.points.min(axis=0) - 3 * size
    along = np.ceil((points.points.max(axis=0) + 3 * size - low) / size) + 1
    # In floating point, where what is too large for whole numbers is large still.
    if along.prod() > 2.0**62:
        raise InputError(f"cubes of {size:g} mm are too many: give larger ones")
    shape = along.astype(np.int64)
    stride = np.array([shape[1] * shape[2], shape[2], 1])
    cell = np.unique(np.floor((points.points - low) / size).astype(np.int64) @ stride)
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3) @ stride
    cell = np.unique((cell[:, None] + around).ravel())
    corner = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    node = np.unique((cell[:, None] + corner @ stride).ravel())
    if len(node) > _MOST_CUBES:
        raise InputError(f"cubes of {size:g} mm are too many, {len(cell)}: give larger ones")
    place = low + size * np.stack(np.unravel_index(node, tuple(shape)), axis=1)
    f = points.at(place).f
    # A vertex for each cube: the mean of where its sides are crossed.
    at = np.searchsorted(node, cell[:, None] + corner @ stride)
    value = f[at]
    total, count = np.zeros((len(cell), 3)), np.zeros(len(cell))
    for i, j in np.argwhere(np.abs(corner[:, None] - corner).sum(axis=2) == 1):
        crossed = _crossed(value[:, i], value[:, j], size)
        part = value[:, i] / np.where(crossed, value[:, i] - value[:, j], 1.0)
        on = corner[i] + part[:, None] * (corner[j] - corner[i])
        total += np.where(crossed[:, None], on, 0.0)
        count += crossed
    has = count > 0
    number = np.where(has, np.cumsum(has) - 1, -1)
    base = low + size * np.stack(np.unravel_index(cell[has], tuple(shape)), axis=1)
    vertices = base + size * total[has] / count[has, None]
    quads = []
    for axis in range(3):
        u, v = stride[(axis + 1) % 3], stride[(axis + 2) % 3]
        beyond = np.minimum(np.searchsorted(node, node + stride[axis]), len(node) - 1)
        crossed = (node[beyond] == node + stride[axis]) & _crossed(f, f[beyond], size)
        start = node[crossed]
        ring = np.stack([start - u - v, start - v, start, start - u], axis=1)
        place_in = np.minimum(np.searchsorted(cell, ring), len(cell) - 1)
        four = np.where(cell[place_in] == ring, number[place_in], -1)
        # Anticlockwise as seen from where f is positive.
        four = np.where((f[crossed] > 0)[:, None], four[:, ::-1], four)
        quads.append(four[(four >= 0).all(axis=1)])
    return vertices, np.concatenate(quads)


def _triangles(
    vertices: Float[np.ndarray, "vertices 3"], quads: Int[np.ndarray, "quads 4"], good: Bool[np.ndarray, "vertices"]
) -> Int[np.ndarray, "triangles 3"]:
    """Two of each quadrilateral along its shorter diagonal, one where a corner of it is not good."""
    count = good[quads].sum(axis=1)
    whole, cut = quads[count == 4], quads[count == 3]
    a, b, c, d = (vertices[whole[:, i]] for i in range(4))
    other = np.linalg.norm(a - c, axis=1) > np.linalg.norm(b - d, axis=1)
    one = np.where(other[:, None], whole[:, [0, 1, 3]], whole[:, [0, 1, 2]])
    two = np.where(other[:, None], whole[:, [1, 2, 3]], whole[:, [0, 2, 3]])
    after = (np.argmin(good[cut], axis=1)[:, None] + [1, 2, 3]) % 4
    return np.concatenate([one, two, np.take_along_axis(cut, after, axis=1)])


def _crossed(f: Float[np.ndarray, "edges"], g: Float[np.ndarray, "edges"], size: float) -> Bool[np.ndarray, "edges"]:
    """Whether one surface passes between neighbours of the grid."""
    with np.errstate(invalid="ignore"):
        return ((f > 0) != (g > 0)) & (np.abs(f - g) <= _STEEPEST * size)
