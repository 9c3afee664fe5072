"""The outline in which a plane cuts a surface: where the lines between neighbouring points pass through it.

A point on the line from a to b, x = a + t (b − a), t = h_a / (h_a − h_b) with h the heights above the plane, moves with
a and b, and so that it stays in the plane: where both move by δ,

    δx = (1 − (b − a) mᵀ / (m · (b − a))) δ,

m the plane's normal. Of its own noise it has no more than a or b has.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from trimesh.intersections import mesh_plane

from jaxscan.errors import InputError
from jaxscan.files.part_file import Feature
from jaxscan.measurement.scanned import Scanned

# Neighbours that are further apart than so many times the usual have an edge of depth between them.
_FAR = 4.0


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
        raise InputError("its plane meets no points: move `point`, turn `normal`, or enlarge the box or ball")
    return cut.part(inside)


def _of_grid(scanned: Scanned, point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> Scanned:
    """Along frames or columns, whichever the plane crosses more often."""
    assert scanned.image is not None
    assert scanned.place is not None
    number = np.full(scanned.image.valid.shape, -1)
    number[tuple(scanned.place.T)] = np.arange(len(scanned.points))
    height = (scanned.points - point) @ normal
    found = [_crossed(number, height), _crossed(number.T, height)]
    a, b = max(found, key=lambda pair: len(pair[0]))
    way = scanned.points[b] - scanned.points[a]
    length = np.linalg.norm(way, axis=1)
    near = length <= _FAR * np.median(length) if len(length) else np.zeros(0, bool)
    a, b, way = a[near], b[near], way[near]
    t = height[a] / (height[a] - height[b])
    slide = np.eye(3) - way[:, :, None] * normal / (way @ normal)[:, None, None]
    order = np.stack([np.zeros(len(a), int), np.arange(len(a))], axis=1)
    by_rig = scanned.by_rig

    def moved(some: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 3 leaves"]:
        assert by_rig is not None
        return slide[some] @ by_rig(a[some])

    stripe = None if scanned.stripe is None else (slide @ scanned.stripe[a][..., None])[..., 0]
    return replace(
        scanned,
        points=scanned.points[a] + t[:, None] * way,
        place=order,
        stripe=stripe,
        sigma=None if stripe is None else np.linalg.norm(stripe, axis=1),
        by_rig=None if by_rig is None else moved,
        camera=None if scanned.camera is None else scanned.camera[a],
        image=None,
    )


def _crossed(
    number: Int[np.ndarray, "lines items"], height: Float[np.ndarray, "points"]
) -> tuple[Int[np.ndarray, "edges"], Int[np.ndarray, "edges"]]:
    """Neighbours in successive lines between which the height changes its sign, item after item."""
    a, b = number[:-1].T, number[1:].T
    there = (a >= 0) & (b >= 0)
    a, b = a[there], b[there]
    crossed = (height[a] < 0) != (height[b] < 0)
    return a[crossed], b[crossed]
