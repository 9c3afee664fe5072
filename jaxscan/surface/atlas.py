"""Where each triangle of a mesh lies on a picture: the atlas of a texture.

Triangles that face alike are a *chart*: each triangle goes to the one of six directions that it faces most, after the
normals are smoothed, so that noise makes no charts. A chart is seen straight along its direction, so lengths on it are
at most about twice too short. Where a chart covers itself, as a spiral does, the triangles that lie behind become a
chart of their own. The rectangles around the charts are packed from the bottom up, each as low as it fits (the skyline
method: J. Jylänki, "A thousand ways to pack the bin", 2010).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.ndimage import maximum_filter1d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

# Texels around each chart that belong to no other.
GUTTER: Final = 4
# Rounds of smoothing, of normals and of the charts' borders.
_ROUNDS: Final = 4
# Charts of fewer triangles become part of a neighbour where they can.
_FEW: Final = 16
# A triangle belongs to no chart whose direction it faces less than this (cosine).
_LEAST_FACING: Final = 0.3
# Pieces that cover a chart are taken out of it in this number of rounds; then each triangle that still does is alone.
_UNFOLDED: Final = 6
# Texels that are looked at together.
_AT_ONCE: Final = 1 << 22
# A texel's centre is within a triangle that it is this far inside (barycentric).
_INSIDE: Final = 1e-5
# Charts of a texel each, with their gutters, may fill this part of the picture.
_MOST_FILLED: Final = 0.7
# By how much texels grow until all charts fit.
_GROWTH: Final = 1.06


@dataclass(frozen=True)
class Atlas:
    """Charts on a picture.

    Attributes:
        place: which vertex of the mesh each corner is; a vertex at a seam is a corner of each chart.
        triangles: three corners each, in the order of the mesh.
        pixels: of each corner, (u, v) on the picture, texels; (0, 0) is the centre of the top left one.
        size: columns and rows of the picture.
        texel_mm: side of a texel.
        charts: how many there are.
    """

    place: Int[np.ndarray, "corners"]
    triangles: Int[np.ndarray, "triangles 3"]
    pixels: Float[np.ndarray, "corners 2"]
    size: tuple[int, int]
    texel_mm: float
    charts: int


@dataclass(frozen=True)
class Texels:
    """The texels of an atlas that show the surface.

    Attributes:
        at: column and row of each.
        triangle: which one it shows.
        weights: of the triangle's three corners; they sum to 1.
    """

    at: Int[np.ndarray, "texels 2"]
    triangle: Int[np.ndarray, "texels"]
    weights: Float[np.ndarray, "texels 3"]


def make_atlas(mesh: trimesh.Trimesh, texel_mm: float, most_px: int) -> Atlas | None:
    """The charts of a mesh, packed.

    Args:
        mesh: its vertices in mm.
        texel_mm: side of a texel; it becomes larger where the picture would be too large.
        most_px: no side of the picture is longer.

    Returns:
        The atlas; None for a surface so rough that its charts do not fit, however small they are drawn.
    """
    vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    normals = np.asarray(mesh.face_normals, np.float64)
    axes = _axes(normals, np.asarray(mesh.area_faces))
    pairs = np.asarray(mesh.face_adjacency).reshape(-1, 2)
    direction = _directions(mesh, normals, axes, pairs)
    flat = _seen_along(vertices[triangles], axes, direction)
    # No smaller than that they would just fill the picture.
    edge = flat[:, 1:, :2] - flat[:, :1, :2]
    area = 0.5 * np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]).sum()
    texel_mm = max(texel_mm, float(np.sqrt(area)) / most_px)
    chart = _unfolded(flat, direction, pairs, texel_mm)
    low, high = _boxes(flat[..., :2], chart)
    if len(low) * (2 + 2 * GUTTER) ** 2 > _MOST_FILLED * most_px**2:
        return None
    while True:
        sizes = np.ceil((high - low) / texel_mm).astype(int) + 1 + 2 * GUTTER
        corner, size = _packed(sizes, most_px)
        if size is not None:
            break
        texel_mm *= _GROWTH
    # Within its rectangle the chart is in the middle of what is left of the last texel.
    spare = (sizes - 1 - 2 * GUTTER - (high - low) / texel_mm) / 2
    pixels = (flat[..., :2] - low[chart][:, None]) / texel_mm + (corner + GUTTER + spare)[chart][:, None]
    key = chart.astype(np.int64)[:, None] * len(vertices) + triangles
    _, first, number = np.unique(key.ravel(), return_index=True, return_inverse=True)
    place = triangles.ravel()[first]
    return Atlas(place, number.reshape(-1, 3), pixels.reshape(-1, 2)[first], size, float(texel_mm), len(low))


def texels_of(atlas: Atlas) -> Texels:
    """The texels whose centre is on a triangle, and those of the corners of triangles between such centres."""
    triangle, at, weights = _covered(atlas.pixels[atlas.triangles], -_INSIDE)
    columns = atlas.size[0]
    _, first = np.unique(at[:, 1] * columns + at[:, 0], return_index=True)
    at, triangle, weights = at[first], triangle[first], weights[first]
    taken = np.zeros((atlas.size[1], columns), bool)
    taken[at[:, 1], at[:, 0]] = True
    corner = np.rint(atlas.pixels[atlas.triangles]).astype(int).reshape(-1, 2)
    left = np.flatnonzero(~taken[corner[:, 1], corner[:, 0]])
    _, once = np.unique(corner[left, 1] * columns + corner[left, 0], return_index=True)
    left = left[once]
    return Texels(
        np.concatenate([at, corner[left]]),
        np.concatenate([triangle, left // 3]),
        np.concatenate([weights, np.eye(3)[left % 3]]),
    )


def _axes(normals: Float[np.ndarray, "triangles 3"], areas: Float[np.ndarray, "triangles"]) -> np.ndarray:
    """A frame whose third row is what the surface faces on the whole, or the axis that it faces most."""
    mean = (areas[:, None] * normals).sum(axis=0)
    moments = (areas[:, None, None] * normals[:, :, None] * normals[:, None, :]).sum(axis=0)
    z = mean if np.linalg.norm(mean) > 0.1 * areas.sum() else np.linalg.eigh(moments)[1][:, 2]
    z = z / max(np.linalg.norm(z), 1e-300) if np.any(z) else np.array([0.0, 0.0, 1.0])
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _directions(
    mesh: trimesh.Trimesh,
    normals: Float[np.ndarray, "triangles 3"],
    axes: np.ndarray,
    pairs: Int[np.ndarray, "pairs 2"],
) -> Int[np.ndarray, "triangles"]:
    """Which of the six directions ±x, ±y, ±z of the frame each triangle is seen along; 2 k and 2 k + 1 of axis k."""
    triangles, areas = np.asarray(mesh.faces), np.asarray(mesh.area_faces)
    n, count = len(mesh.vertices), len(triangles)
    smooth = normals
    for _ in range(_ROUNDS):
        at = np.stack([np.bincount(triangles.ravel(), np.repeat(areas * smooth[:, k], 3), n) for k in range(3)], axis=1)
        smooth = at[triangles].sum(axis=1)
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-300)
    own, facing = _six(normals @ axes.T), _six(smooth @ axes.T)
    each = np.arange(count)
    label = facing.argmax(axis=1)
    label = np.where(own[each, label] >= _LEAST_FACING, label, own.argmax(axis=1))
    for round_ in range(2 * _ROUNDS):
        votes = np.zeros((count, 6), np.int16)
        np.add.at(votes, (pairs[:, 0], label[pairs[:, 1]]), 1)
        np.add.at(votes, (pairs[:, 1], label[pairs[:, 0]]), 1)
        votes[own < _LEAST_FACING] = 0
        most = votes.argmax(axis=1)
        change = votes[each, most] >= 2
        if round_ >= _ROUNDS:
            # A small piece takes any neighbour's.
            _, piece = _pieces(count, pairs, label)
            few = np.bincount(piece)[piece] < _FEW
            votes[each, label] = 0
            most = np.where(few, votes.argmax(axis=1), most)
            change = np.where(few, votes[each, most] >= 1, change)
        label = np.where(change, most, label)
    return label


def _six(along: Float[np.ndarray, "triangles 3"]) -> Float[np.ndarray, "triangles 6"]:
    return np.stack([along, -along], axis=-1).reshape(len(along), 6)


def _seen_along(
    corners: Float[np.ndarray, "triangles 3 3"], axes: np.ndarray, direction: Int[np.ndarray, "triangles"]
) -> Float[np.ndarray, "triangles 3 3"]:
    """Each triangle's corners: right and down as seen against its direction, and towards the one who looks, mm."""
    P = corners @ axes.T
    flat = np.empty_like(P)
    for k in range(3):
        for sign in (0, 1):
            some = direction == 2 * k + sign
            right, up = P[some][..., (k + 1) % 3], P[some][..., (k + 2) % 3]
            ahead = P[some][..., k]
            flat[some] = np.stack([-right if sign else right, -up, -ahead if sign else ahead], axis=-1)
    return flat


def _pieces(
    count: int, pairs: Int[np.ndarray, "pairs 2"], label: Int[np.ndarray, "triangles"]
) -> tuple[int, Int[np.ndarray, "triangles"]]:
    """Connected triangles of one label: how many pieces, and which of them each triangle is in."""
    a, b = pairs[label[pairs[:, 0]] == label[pairs[:, 1]]].T
    return connected_components(coo_matrix((np.ones(len(a), np.int8), (a, b)), (count, count)), directed=False)


def _unfolded(
    flat: Float[np.ndarray, "triangles 3 3"],
    direction: Int[np.ndarray, "triangles"],
    pairs: Int[np.ndarray, "pairs 2"],
    texel_mm: float,
) -> Int[np.ndarray, "triangles"]:
    """The chart of each triangle: connected, of one direction, none covering itself at the centre of a texel."""
    count, label = len(direction), direction.astype(np.int64)
    pixels = flat[..., :2] / texel_mm
    pixels = pixels - pixels.reshape(-1, 2).min(axis=0)
    depth = flat[..., 2]
    triangle, at, weights = _covered(pixels, _INSIDE)
    ahead = (depth[triangle] * weights).sum(axis=1)
    place = at[:, 0] * (int(at[:, 1].max(initial=0)) + 1) + at[:, 1]
    for round_ in range(_UNFOLDED + 1):
        charts, chart = _pieces(count, pairs, label)
        key = place * charts + chart[triangle]
        order = np.lexsort((-ahead, key))
        behind = triangle[order[1:][key[order[1:]] == key[order[:-1]]]]
        if not len(behind):
            return chart
        if round_ < _UNFOLDED:
            label[np.unique(behind)] += 6
        else:
            alone = np.unique(behind)
            label[alone] = label.max() + 1 + np.arange(len(alone))
    return _pieces(count, pairs, label)[1]


def _boxes(
    flat: Float[np.ndarray, "triangles 3 2"], chart: Int[np.ndarray, "triangles"]
) -> tuple[Float[np.ndarray, "charts 2"], Float[np.ndarray, "charts 2"]]:
    """The least and the greatest (u, v) of each chart, mm."""
    count = int(chart.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, flat.min(axis=1))
    np.maximum.at(high, chart, flat.max(axis=1))
    return low, high


def _packed(
    sizes: Int[np.ndarray, "charts 2"], most_px: int
) -> tuple[Int[np.ndarray, "charts 2"], tuple[int, int] | None]:
    """The top left corner of each rectangle, and the picture's size; None for it where they do not fit."""
    columns = max(int(np.ceil(np.sqrt(1.1 * sizes.prod(axis=1).sum()))), int(sizes[:, 0].max()))
    corner = np.zeros_like(sizes)
    if columns > most_px:
        return corner, None
    filled = np.zeros(columns, int)
    for i in np.lexsort((-sizes[:, 0], -sizes[:, 1])):
        wide, high = (int(n) for n in sizes[i])
        # Of each first column the highest of `wide` columns.
        top = maximum_filter1d(filled, wide, origin=-(wide // 2), mode="nearest")[: columns - wide + 1]
        x = int(top.argmin())
        corner[i] = x, top[x]
        filled[x : x + wide] = top[x] + high
        if top[x] + high > most_px:
            return corner, None
    return corner, (columns, int(filled.max()))


def _covered(
    pixels: Float[np.ndarray, "triangles 3 2"], inside: float
) -> tuple[Int[np.ndarray, "texels"], Int[np.ndarray, "texels 2"], Float[np.ndarray, "texels 3"]]:
    """Triangle, (column, row) and barycentric weights of every texel whose centre is within a triangle.

    Args:
        pixels: of the triangles' corners, texels.
        inside: least weight.
    """
    low = np.ceil(pixels.min(axis=1) - 1e-6).astype(int)
    wide = np.maximum(np.floor(pixels.max(axis=1) + 1e-6).astype(int) - low + 1, 0)
    each = wide.prod(axis=1)
    a, b, c = (pixels[:, i] for i in range(3))
    double = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    each[double == 0] = 0
    done = np.cumsum(each)
    ends = np.searchsorted(done, np.arange(0, (done[-1] if len(done) else 0) + _AT_ONCE, _AT_ONCE), side="right")
    found = []
    for start, stop in zip([0, *ends], [*ends, len(each)], strict=True):
        which = np.repeat(np.arange(start, stop), each[start:stop])
        if not len(which):
            continue
        first = np.cumsum(each[start:stop]) - each[start:stop]
        nth = np.arange(len(which)) - first[which - start]
        at = low[which] + np.stack([nth % wide[which, 0], nth // wide[which, 0]], axis=1)
        to_b, to_c, to_p = b[which] - a[which], c[which] - a[which], at - a[which]
        beta = (to_p[:, 0] * to_c[:, 1] - to_p[:, 1] * to_c[:, 0]) / double[which]
        gamma = (to_b[:, 0] * to_p[:, 1] - to_b[:, 1] * to_p[:, 0]) / double[which]
        weights = np.stack([1 - beta - gamma, beta, gamma], axis=1)
        kept = (weights >= inside).all(axis=1)
        found.append((which[kept], at[kept], weights[kept]))
    if not found:
        return np.zeros(0, int), np.zeros((0, 2), int), np.zeros((0, 3))
    triangle, at, weights = (np.concatenate(each) for each in zip(*found, strict=True))
    return triangle, at, weights
