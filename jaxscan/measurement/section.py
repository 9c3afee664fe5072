"""The outline in which a plane cuts a surface: where the curves through neighbouring points pass through it.

Between a and b that is the cubic through four points of a line of the grid: a chord of length l lies up to l² / 8 R
inside of a round. It is the chord, x = a + t (b − a), t = h_a / (h_a − h_b) with h the heights above the plane, where
there are no four points, or the surface turns sharply. The point moves with a and b, and so that it stays in the plane:
where both move by δ,

    δx = (1 − (b − a) mᵀ / (m · (b − a))) δ,

m the plane's normal. Of its own noise it has no more than a or b has.

The last two columns of a surface are left out: lens and pixels mix them with what is beside it (`border`), and on a
cylinder they are 0.05 mm and 0.01 mm too far out.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from trimesh.intersections import mesh_plane

from jaxscan.errors import InputError
from jaxscan.files.part_file import Feature
from jaxscan.measurement.scanned import Scanned

# Neighbours that are further apart than this number of times the usual have an edge of depth between them.
_FAR = 4.0
# Where three neighbouring steps differ by more than this part of the middle one there is an edge, and no curve.
_TURNS = 0.5
_STEPS = 3
# Columns at either end of a surface that are left out; of a narrower one this part of it. Fewer columns are no surface.
_BORDER, _OF_NARROW, _FEWEST = 2, 5, 3


def outline(scanned: Scanned, feature: Feature) -> Scanned:
    """The points in which a section's plane cuts a range image or a mesh, in order.

    Raises:
        InputError: the points have no neighbours, or the plane meets none.
    """
    point, normal = np.asarray(feature.point, np.float64), np.asarray(feature.normal, np.float64)
    normal = normal / np.linalg.norm(normal)
    if scanned.mesh is not None:
        segments = np.asarray(mesh_plane(scanned.mesh, normal, point)).reshape(-1, 3)
        cut = Scanned(segments, why_not=scanned.why_not)
    elif scanned.image is not None and scanned.place is not None:
        cut = _of_grid(scanned, point, normal)
    else:
        raise InputError(
            "points without neighbours have no section: measure the range image (.npz), or mesh the cloud first"
        )
    inside = cut.within(feature.region)
    if not len(inside):
        raise InputError("its plane meets no points: move `point`, turn `normal`, or enlarge the region")
    return cut.part(inside)


def _of_grid(scanned: Scanned, point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> Scanned:
    """Along frames or columns, whichever the plane crosses more often."""
    assert scanned.image is not None
    assert scanned.place is not None
    number = np.full(scanned.image.valid.shape, -1)
    number[tuple(scanned.place.T)] = np.arange(len(scanned.points))
    number[~_inner(number, scanned.points)] = -1
    height = (scanned.points - point) @ normal
    found = [_crossed(number, height), _crossed(number.T, height)]
    around = max(found, key=len)
    way = scanned.points[around[:, 2]] - scanned.points[around[:, 1]]
    length = np.linalg.norm(way, axis=1)
    near = length <= _FAR * np.median(length) if len(length) else np.zeros(0, bool)
    around, way = around[near], way[near]
    a = around[:, 1]
    crossing = _crossing(scanned.points, height, around)
    slide = np.eye(3) - way[:, :, None] * normal / (way @ normal)[:, None, None]
    order = np.stack([np.zeros(len(a), int), np.arange(len(a))], axis=1)
    by_rig = scanned.by_rig

    def moved(some: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 3 leaves"]:
        assert by_rig is not None
        return slide[some] @ by_rig(a[some])

    stripe = None if scanned.stripe is None else (slide @ scanned.stripe[a][..., None])[..., 0]
    return replace(
        scanned,
        points=crossing,
        place=order,
        stripe=stripe,
        sigma=None if stripe is None else np.linalg.norm(stripe, axis=1),
        by_rig=None if by_rig is None else moved,
        camera=None if scanned.camera is None else scanned.camera[a],
        image=None,
    )


def _inner(
    number: Int[np.ndarray, "frames columns"], points: Float[np.ndarray, "points 3"]
) -> Bool[np.ndarray, "frames columns"]:
    """Whether a point of the grid is not at the end of a surface along its stripe."""
    there = (number[:, 1:] >= 0) & (number[:, :-1] >= 0)
    apart = np.full(there.shape, np.inf)
    apart[there] = np.linalg.norm(points[number[:, 1:][there]] - points[number[:, :-1][there]], axis=1)
    joined = apart <= _FAR * (np.median(apart[there]) if there.any() else 0.0)
    column = np.broadcast_to(np.arange(number.shape[1]), number.shape)
    begins = np.pad(~joined, ((0, 0), (1, 0)), constant_values=True)
    ends = np.pad(~joined, ((0, 0), (0, 1)), constant_values=True)
    first = np.maximum.accumulate(np.where(begins, column, 0), axis=1)
    last = np.minimum.accumulate(np.where(ends, column, number.shape[1])[:, ::-1], axis=1)[:, ::-1]
    wide = last - first + 1
    deep = np.minimum(column - first, last - column)
    return (wide >= _FEWEST) & (deep >= np.minimum(_BORDER, wide // _OF_NARROW))


def _crossing(
    points: Float[np.ndarray, "points 3"], height: Float[np.ndarray, "points"], around: Int[np.ndarray, "edges 4"]
) -> Float[np.ndarray, "edges 3"]:
    """Where the curve through four points each has the height 0, between the middle two."""
    a, b = around[:, 1], around[:, 2]
    there = (around >= 0).all(axis=1)
    # A missing one goes on as the middle two do.
    four = np.stack([points[around[:, k]] for k in range(4)], axis=1)
    turns = np.abs(four[:, 3] - four[:, 2] - four[:, 1] + four[:, 0]).max(axis=1)
    bent = ~there | (turns > _TURNS * np.linalg.norm(four[:, 2] - four[:, 1], axis=1))
    four[bent, 0], four[bent, 3] = 2 * points[a[bent]] - points[b[bent]], 2 * points[b[bent]] - points[a[bent]]
    heights = height[around]
    heights[bent, 0] = 2 * height[a[bent]] - height[b[bent]]
    heights[bent, 3] = 2 * height[b[bent]] - height[a[bent]]
    t = height[a] / (height[a] - height[b])
    for _ in range(_STEPS):
        off = (_weights(t) * heights).sum(axis=1)
        t = np.clip(t - off / (height[b] - height[a]), 0.0, 1.0)
    return np.einsum("ek,ekx->ex", _weights(t), four)


def _weights(t: Float[np.ndarray, "edges"]) -> Float[np.ndarray, "edges 4"]:
    """The weights of Lagrange's cubic through its values at −1, 0, 1 and 2."""
    u, v, w = t + 1, t - 1, t - 2
    return np.stack([-t * v * w / 6, u * v * w / 2, -u * t * w / 2, u * t * v / 6], axis=1)


def _crossed(number: Int[np.ndarray, "lines items"], height: Float[np.ndarray, "points"]) -> Int[np.ndarray, "edges 4"]:
    """Neighbours in successive lines between which the height changes its sign, item after item.

    The middle two; the first and the last are those before and after, −1 where there are none.
    """
    padded = np.pad(number, ((1, 1), (0, 0)), constant_values=-1)
    around = np.stack([padded[k : len(padded) - 3 + k] for k in range(4)], axis=-1).swapaxes(0, 1).reshape(-1, 4)
    a, b = around[:, 1], around[:, 2]
    crossed = (a >= 0) & (b >= 0)
    crossed[crossed] = (height[a[crossed]] < 0) != (height[b[crossed]] < 0)
    return around[crossed]
