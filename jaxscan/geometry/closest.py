"""The nearest point of a set of triangles to each of many points.

Triangles that are large beside the others, or long, are cut in two across their longest side until they are not. A tree
of boxes holds the pieces, eight boxes in a node (a bounding volume hierarchy: J. Goldsmith and J. Salmon, Automatic
creation of object hierarchies for ray tracing, 1987; here halved at the median of the widest direction). The boxes of a
node lie along the plane through its pieces (S. Gottschalk, M. Lin, D. Manocha, OBBTree, 1996): they are as thin as the
surface is flat there, so that a far point distinguishes them. Points descend, many at a time, into the boxes that are
nearer than the piece with the nearest centre.

In the plane of a piece, x goes along its longest side from a corner of it and y to the corner (c, h) opposite, so that
0 ≤ c ≤ length. The nearest point to one below that side is on the side; else it is the point itself, if that is inside,
or on one of the two other sides. No digits are lost where a triangle is a needle, a line or a point.
"""

from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

# Points begun together, and pairs of a point and a node that are looked at together.
_POINTS_AT_ONCE, _PAIRS_AT_ONCE = 1 << 15, 1 << 16
# For so few it takes longer to begin threads than to search: 0.6 ms for 250 points and not 0.1.
_FEW_POINTS: Final = 4096
# Boxes in a node, and how many of a level are followed down for a first guess.
_FAN: Final = 8
_BEAM: Final = 8
# A point is far if its distance from all centres exceeds this multiple of the root of the mean area.
_NEAR: Final = 8.0
# A side longer than this multiple of the root of the mean area is cut, while there are no more pieces than twice the
# triangles plus this number.
_LONG: Final = 4.0
_MOST_MORE: Final = 50_000

# Of each node of a level: its axes, as columns, and its children's lowest and highest coordinates along them.
_Level = tuple[Float[np.ndarray, "nodes 3 3"], Float[np.ndarray, "nodes 3 fan"], Float[np.ndarray, "nodes 3 fan"]]


class ClosestOnTriangles:
    """Triangles, made ready to be asked.

    Attributes:
        looked_at: how many pairs of a point and a piece of a triangle were measured until now.
    """

    def __init__(self, corners: Float[np.ndarray, "triangles 3 3"]):
        pieces, owner = _cut(np.asarray(corners, np.float64))
        order = _in_order(pieces.mean(axis=1))
        real = order < len(pieces)
        order = np.minimum(order, len(pieces) - 1)
        pieces = pieces[order]
        self.looked_at = 0
        self._levels = _levels(pieces, real)
        self._frames, self._owner = _frames(pieces), owner[order]
        self._leaf = np.flatnonzero(real)
        self._centres = KDTree(pieces[real].mean(axis=1))
        self._reach = _NEAR * np.sqrt(_mean_area(pieces[real]))

    def __call__(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "points"]]:
        """The nearest point of the triangles to each point, and the triangle that it lies on."""
        nearest, triangle = np.empty((len(points), 3)), np.empty(len(points), int)
        for start in range(0, len(points), _POINTS_AT_ONCE):
            here = slice(start, start + _POINTS_AT_ONCE)
            nearest[here], piece = self._nearest(np.asarray(points[here], np.float64))
            triangle[here] = self._owner[piece]
        return nearest, triangle

    def _nearest(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "points"]]:
        """The nearest point to each, and its piece."""
        every = np.arange(len(points))
        best = self._first(points)
        nearest = self._on(points, best)
        square = _squares(points - nearest)
        # The last that was put there is taken first, so that what is known of the first points bounds the next.
        waiting = [(0, every, np.zeros_like(every))]
        while waiting:
            level, point, node = waiting.pop()
            if len(point) > _PAIRS_AT_ONCE:
                half = len(point) // 2
                waiting += [(level, point[half:], node[half:]), (level, point[:half], node[:half])]
            elif level < len(self._levels):
                axes, low, high = self._levels[level]
                p = np.einsum("ni,nij->nj", points[point], axes[node])[:, :, None]
                gap = np.maximum(low[node] - p, p - high[node])
                np.maximum(gap, 0.0, out=gap)
                pair, child = np.nonzero(np.einsum("ijk,ijk->ik", gap, gap) < square[point][:, None])
                if len(pair):
                    waiting.append((level + 1, point[pair], node[pair] * low.shape[2] + child))
            else:
                on = self._on(points[point], node)
                away = _squares(points[point] - on)
                # Pairs stand in the order of their points.
                first = np.flatnonzero(np.diff(point, prepend=-1))
                least = np.minimum.reduceat(away, first)
                hits = np.flatnonzero(away == np.repeat(least, np.diff(first, append=len(point))))
                at = hits[np.searchsorted(hits, first)]
                at = at[least < square[point[first]]]
                best[point[at]], nearest[point[at]], square[point[at]] = node[at], on[at], away[at]
        return nearest, best

    def _first(self, points: Float[np.ndarray, "points 3"]) -> Int[np.ndarray, "points"]:
        """A piece near each point: that with the nearest centre, or for a far one that of the tree's nearest boxes.

        Seen from afar all centres are about as near, and a search for the nearest looks at most of them.
        """
        workers = -1 if len(points) > _FEW_POINTS else 1
        away, index = self._centres.query(points, distance_upper_bound=self._reach, workers=workers)
        far = np.flatnonzero(np.isinf(away))
        first = self._leaf[np.where(np.isinf(away), 0, index)]
        for start in range(0, len(far), _PAIRS_AT_ONCE // _BEAM):
            some = far[start : start + _PAIRS_AT_ONCE // _BEAM]
            first[some] = self._from_afar(points[some])
        return first

    def _from_afar(self, points: Float[np.ndarray, "points 3"]) -> Int[np.ndarray, "points"]:
        """The nearest of the pieces that are reached through the few nearest boxes of each level."""
        nodes, every = np.zeros((len(points), 1), int), np.arange(len(points))[:, None]
        for axes, low, high in self._levels:
            p = np.einsum("ni,nbij->nbj", points, axes[nodes])[..., None]
            gap = np.maximum(low[nodes] - p, p - high[nodes])
            np.maximum(gap, 0.0, out=gap)
            squares = np.einsum("nbjk,nbjk->nbk", gap, gap).reshape(len(points), -1)
            nodes = (nodes[..., None] * low.shape[2] + np.arange(low.shape[2])).reshape(len(points), -1)
            if nodes.shape[1] > _BEAM:
                nodes = nodes[every, np.argpartition(squares, _BEAM, axis=1)[:, :_BEAM]]
        repeated = np.repeat(points, nodes.shape[1], axis=0)
        away = _squares(repeated - self._on(repeated, nodes.ravel())).reshape(nodes.shape)
        return nodes[every[:, 0], away.argmin(axis=1)]

    def _on(
        self, points: Float[np.ndarray, "points 3"], piece: Int[np.ndarray, "points"]
    ) -> Float[np.ndarray, "points 3"]:
        """The nearest point of one piece to each point."""
        self.looked_at += len(points)
        frames = self._frames[piece]
        a, along, across = frames[:, :3], frames[:, 3:6], frames[:, 6:9]
        length, c, h = frames[:, 9:].T
        from_a = points - a
        x, y = np.einsum("ij,ij->i", from_a, along), np.einsum("ij,ij->i", from_a, across)
        below = y <= 0
        inside = ~below & (h * x > c * y) & (h * (length - x) > (length - c) * y)
        # Along the two sides that end in the corner opposite, from their other ends.
        d = c - length
        left = np.clip((x * c + y * h) / np.maximum(c * c + h * h, 1e-300), 0, 1)
        right = np.clip(((x - length) * d + y * h) / np.maximum(d * d + h * h, 1e-300), 0, 1)
        to_left = (x - left * c) ** 2 + (y - left * h) ** 2
        to_right = (x - length - right * d) ** 2 + (y - right * h) ** 2
        on_left = to_left <= to_right
        side_x, side_y = np.where(on_left, left * c, length + right * d), np.where(on_left, left, right) * h
        x = np.where(inside, x, np.where(below, np.clip(x, 0, length), side_x))
        y = np.where(inside, y, np.where(below, 0.0, side_y))
        return a + x[:, None] * along + y[:, None] * across


def _squares(differences: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    return np.einsum("ij,ij->i", differences, differences)


def _mean_area(corners: Float[np.ndarray, "triangles 3 3"]) -> float:
    a, b, c = np.moveaxis(corners, 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).mean()) / 2


def _cut(
    corners: Float[np.ndarray, "triangles 3 3"],
) -> tuple[Float[np.ndarray, "pieces 3 3"], Int[np.ndarray, "pieces"]]:
    """Pieces of triangles, none much larger than the others, and the triangle of each."""
    pieces, owner = corners, np.arange(len(corners))
    area = _mean_area(corners)
    while True:
        sides = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=-1)
        length = sides.max(axis=1)
        long = np.flatnonzero(length > max(length.max() / 2, _LONG * np.sqrt(area)))
        if not len(long) or len(pieces) + len(long) > 2 * len(corners) + _MOST_MORE:
            return pieces, owner
        which = (sides[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(pieces[long], which[:, :, None], axis=1), 1, 0)
        middle = (a + b) / 2
        pieces = np.concatenate([pieces, np.stack([middle, b, c], axis=1)])
        pieces[long] = np.stack([a, middle, c], axis=1)
        owner = np.concatenate([owner, owner[long]])


def _in_order(centres: Float[np.ndarray, "pieces 3"]) -> Int[np.ndarray, "leaves"]:
    """Pieces so that halves, quarters and so on of the order lie together, down to those of one node.

    They are filled up to a power of two with numbers beyond the last.
    """
    leaves = 1 << (len(centres) - 1).bit_length()
    groups = np.arange(leaves)[None]
    while groups.shape[1] > _FAN:
        places = centres[np.minimum(groups, len(centres) - 1)]
        widest = np.ptp(places, axis=1).argmax(axis=1)
        key = np.take_along_axis(places, widest[:, None, None], axis=2)[..., 0]
        half = groups.shape[1] // 2
        groups = np.take_along_axis(groups, np.argpartition(key, half, axis=1), axis=1).reshape(-1, half)
    return groups.ravel()


def _levels(pieces: Float[np.ndarray, "leaves 3 3"], real: np.ndarray) -> list[_Level]:
    """The nodes, from the top of the tree to its leaves; boxes without a real piece are empty."""
    levels, nodes, fan = [], len(pieces), 1
    while nodes > 1 or not levels:
        fan, inside = min(_FAN, nodes), len(pieces) // nodes
        nodes //= fan
        corners = pieces.reshape(nodes, -1, 3)
        axes = _axes(corners)
        along = np.einsum("nij,njk->nki", corners, axes).reshape(nodes, 3, fan, 3 * inside)
        empty = ~real.reshape(nodes, 1, fan, inside).any(axis=3)
        low, high = np.where(empty, np.inf, along.min(axis=3)), np.where(empty, -np.inf, along.max(axis=3))
        levels.append((axes, low, high))
    return levels[::-1]


def _axes(corners: Float[np.ndarray, "nodes corners 3"]) -> Float[np.ndarray, "nodes 3 3"]:
    """Two directions along the plane of least squares through each node's corners, and that across it, as columns.

    The first is that of the axis that is nearest to the plane: pieces were put in order along the axes.
    """
    off = corners - corners.mean(axis=1, keepdims=True)
    across = np.linalg.eigh(np.einsum("nij,nik->njk", off, off))[1][:, :, 0]
    first = np.eye(3)[np.abs(across).argmin(axis=1)]
    first = first - (first * across).sum(axis=1, keepdims=True) * across
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(across, first), across], axis=2)


def _frames(pieces: Float[np.ndarray, "leaves 3 3"]) -> Float[np.ndarray, "leaves 12"]:
    """For each piece the start of its longest side, the directions of x and y, the side's length, and c, h."""
    sides = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=-1)
    which = (sides.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(pieces, which[:, :, None], axis=1), 1, 0)
    length = sides.max(axis=1, keepdims=True)
    along = (b - a) / np.where(length > 0, length, 1.0)
    normal = np.cross(along, c - a)
    height = np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal / np.where(height > 0, height, 1.0), along)
    return np.hstack([a, along, across, length, ((c - a) * along).sum(axis=1, keepdims=True), height])
