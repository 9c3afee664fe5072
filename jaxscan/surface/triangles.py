"""The surface of a range image: triangles between neighbours in frame and column.

Each cell of the grid has the corners a, b of one frame and c, d of the next, in the same two columns. A triangle stands
where two of the cell's sides that meet are linked (`jaxscan.surface.links`); where both diagonals give as many
triangles, the shorter one is taken. All triangles turn the same way round, for neighbours on a surface that the light
and the camera see have the same order everywhere; which way faces the camera is seen from all of them together.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxscan.errors import InputError
from jaxscan.reconstruction import RangeImage
from jaxscan.surface.links import Links, Sampling, links, sampling
from jaxscan.surface.passages import passages

# Corners a, b, c, d of a cell are 0 to 3. The diagonal a d: a b d and a d c; the diagonal b c: a b c and b d c.
_OF_DIAGONAL = (((0, 1, 3), (0, 3, 2)), ((0, 1, 2), (1, 3, 2)))
_FIRST, _SECOND, _OTHER = 1, 2, 4
# Frames whose cells are looked at together: they stay in the processor's cache.
_FRAMES_AT_ONCE = 32
_MOST_TURNED_ON = 100_000
# Fewer of the points than this make no surface.
_LEAST_JOINED = 0.1


@dataclass(frozen=True)
class Surface:
    """Triangles between the points of a range image.

    Attributes:
        vertices: object frame, mm.
        triangles: three vertices each, anticlockwise as the camera sees them.
        place: of each vertex in the flattened grid of the range image.
        cells: a number for each triangle: two of one number are the halves of one cell.
    """

    vertices: Float[np.ndarray, "vertices 3"]
    triangles: Int[np.ndarray, "triangles 3"]
    place: Int[np.ndarray, "vertices"]
    cells: Int[np.ndarray, "triangles"]

    def faces(self) -> tuple[Int[np.ndarray, "triangles 3"], Int[np.ndarray, "quads 4"]]:
        """Triangles that are alone in their cell, and quadrilaterals of those that are not."""
        order = np.argsort(self.cells, kind="stable")
        cell, triangles = self.cells[order], self.triangles[order]
        pair = np.flatnonzero(cell[1:] == cell[:-1])
        alone = np.ones(len(cell), bool)
        alone[pair] = alone[pair + 1] = False
        a, b = triangles[pair], triangles[pair + 1]
        # The corner of a that b has not; the others are the diagonal, and b's own corner stands opposite.
        own = ~(a[:, :, None] == b[:, None]).any(axis=2)
        turned = np.take_along_axis(a, (own.argmax(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
        other = b[~(b[:, :, None] == a[:, None]).any(axis=2)]
        return triangles[alone], np.column_stack([turned[:, :2], other, turned[:, 2]])


def grid_surface(image: RangeImage, how: Sampling | None = None) -> Surface:
    """The triangles of a range image; of a sweep that is a full turn, the last frame is joined to the first.

    What was seen at several passages (`jaxscan.surface.passages`) has as many layers, which are not joined.

    Args:
        image: the range image.
        how: its spacing and noise; by default as `sampling` finds them.

    Raises:
        InputError: there is one frame, or hardly any point has neighbours.
    """
    layers = grid_layers(image, how)
    if len(layers) == 1:
        return layers[0]
    vertices = np.cumsum([0, *(len(layer.place) for layer in layers)])
    return Surface(
        np.concatenate([layer.vertices for layer in layers]),
        np.concatenate([layer.triangles + first for layer, first in zip(layers, vertices, strict=False)]),
        np.concatenate([layer.place for layer in layers]),
        np.concatenate([layer.cells + i * image.closed().valid.size for i, layer in enumerate(layers)]),
    )


def grid_layers(image: RangeImage, how: Sampling | None = None) -> list[Surface]:
    """The triangles of each passage, as `grid_surface`; one surface of what was seen once.

    Raises:
        InputError: as `grid_surface`.
    """
    how = how or sampling(image)
    layers, first = [], 0
    for sweep in image.sweeps():
        if len(sweep.valid) > 1:
            found = [_layer(sweep.where(part), how) for part in passages(sweep)]
            layers += [replace(layer, place=layer.place + first) for layer in found if layer is not None]
        first += sweep.valid.size
    joined, points = sum(len(layer.place) for layer in layers), int(image.valid.sum())
    if not layers or joined < _LEAST_JOINED * points:
        raise InputError(
            f"{joined} of {points} points make triangles with their neighbours, so there is no surface: scan with "
            f"smaller steps than {how.step:g}, or clean less"
        )
    return layers


def _layer(image: RangeImage, how: Sampling) -> Surface | None:
    """The triangles of one passage; None where there are none."""
    linked = links(image, how)
    once, image = image, image.closed()
    if image is not once:
        linked = Links(np.concatenate([linked.across, linked.across[:1]]), linked.along)
    code = _cells(image, linked)
    # Cells are numbered by their corner a, so the last column and the last frame have none.
    columns = image.valid.shape[1]
    kinds = [
        (bit | _OTHER * diagonal, corners)
        for diagonal, pair in enumerate(_OF_DIAGONAL)
        for bit, corners in zip((_FIRST, _SECOND), pair, strict=True)
    ]
    corner = (0, 1, columns, columns + 1)
    at = []
    used = np.zeros(code.size + columns + 1, bool)
    for kind, corners in kinds:
        here = (code & (kind | _OTHER)) == kind
        at.append(np.flatnonzero(here))
        for i in corners:
            used[corner[i] : corner[i] + code.size] |= here
    place = np.flatnonzero(used)
    if not len(place):
        return None
    number = np.cumsum(used, dtype=np.int32)
    number -= 1
    triangles = np.empty((sum(map(len, at)), 3), np.int32)
    done = 0
    for cells, (_, corners) in zip(at, kinds, strict=True):
        for k, i in enumerate(corners):
            number[corner[i] :].take(cells, out=triangles[done : done + len(cells), k], mode="clip")
        done += len(cells)
    if image is not once:
        # Of a turn that closes, the first frame's points stand at its end too.
        place, same = np.unique(place % once.valid.size, return_inverse=True)
        triangles = same.astype(np.int32)[triangles]
    surface = Surface(once.points.reshape(-1, 3)[place], triangles, place, np.concatenate(at))
    return surface if facing_away(surface, once) <= 0.5 else _turned(surface)


def even_points(
    surface: Surface, spacing_mm: float
) -> tuple[Int[np.ndarray, "points 3"], Float[np.ndarray, "points 3"], Int[np.ndarray, "points"]]:
    """The vertices of a surface, and points on its larger triangles, so that none are further apart than a spacing.

    Returns:
        Of each point the vertices that it lies between, its weights on them, and into how many parts the sides of its
        triangle were divided: 1 for a vertex.
    """
    number = np.arange(len(surface.vertices))
    corners, weights = [np.stack([number] * 3, axis=1)], [np.broadcast_to([1.0, 0.0, 0.0], (len(number), 3))]
    parts = [np.ones(len(number), int)]
    at = surface.vertices[surface.triangles].astype(np.float64)
    longest = np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).max(axis=1)
    divided = np.ceil(longest / spacing_mm).astype(int)
    for n in np.unique(divided[divided > 1]):
        i, j = np.mgrid[: n + 1, : n + 1].reshape(2, -1)
        inner = (i + j <= n) & (np.maximum(np.maximum(i, j), n - i - j) < n)
        lattice = np.stack([i, j, n - i - j], axis=1)[inner] / n
        some = surface.triangles[divided == n]
        corners.append(np.repeat(some, len(lattice), axis=0))
        weights.append(np.tile(lattice, (len(some), 1)))
        parts.append(np.full(len(some) * len(lattice), n))
    return np.concatenate(corners), np.concatenate(weights), np.concatenate(parts)


def _cells(image: RangeImage, linked: Links) -> UInt8[np.ndarray, "cells"]:
    """Which of its two triangles each cell has, and which diagonal; a cell for each point."""
    code = np.zeros(image.valid.shape, np.uint8)
    for start in range(0, len(code) - 1, _FRAMES_AT_ONCE):
        stop = min(start + _FRAMES_AT_ONCE, len(code) - 1)
        ab, cd = linked.across[start:stop], linked.across[start + 1 : stop + 1]
        ac, bd = linked.along[start:stop, :-1], linked.along[start:stop, 1:]
        ad, bc = ((ab & bd), (ac & cd)), ((ab & ac), (bd & cd))
        count_ad, count_bc = (one.view(np.int8) + two.view(np.int8) for one, two in (ad, bc))
        P = image.points[start : stop + 1]
        longer = np.zeros(ab.shape, np.float32)
        with np.errstate(invalid="ignore"):
            for i in range(3):
                longer += (P[1:, 1:, i] - P[:-1, :-1, i]) ** 2
                longer -= (P[1:, :-1, i] - P[:-1, 1:, i]) ** 2
            other = (count_bc > count_ad) | ((count_bc == count_ad) & (longer > 0))
        own = code[start:stop, :-1]
        for bit, of_ad, of_bc in zip((_FIRST, _SECOND), ad, bc, strict=True):
            own |= np.where(other, of_bc, of_ad).view(np.uint8) * np.uint8(bit)
        own |= other.view(np.uint8) * np.uint8(_OTHER)
    return code.ravel()


def facing_away(surface: Surface, image: RangeImage) -> float:
    """The part of the surface's area that the camera would have seen from behind.

    Triangles that all turn the same way round have fronts and backs only if the surface is folded, and no scanner sees
    a fold: a part that is not small says that the stage moved the other way than the rig has it.
    """
    some = surface.triangles[:: max(1, len(surface.triangles) // _MOST_TURNED_ON)]
    a, b, c = (surface.vertices[some[:, i]].astype(np.float64) for i in range(3))
    camera = image.cameras()[surface.place[some[:, 0]] // image.valid.shape[1]]
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    return float(area[(normal * (camera - a)).sum(axis=1) < 0].sum() / max(area.sum(), 1e-300))


def _turned(surface: Surface) -> Surface:
    return Surface(surface.vertices, surface.triangles[:, [0, 2, 1]], surface.place, surface.cells)
