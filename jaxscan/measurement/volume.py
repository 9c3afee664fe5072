"""The volume between a range image's surface and a plane: prisms over its triangles.

A triangle with corners at heights h₁, h₂, h₃ over the plane stands for (h₁ + h₂ + h₃) / 3 times its area as seen along
the plane's normal. By its corners the volume is polynomial, so that its derivatives are written down: that by a corner
is n A / 3 for the height, and for the area the mean height times n × (the opposite side) / 2.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.measurement.alike import Alike
from jaxscan.measurement.fit import Fit
from jaxscan.measurement.known import Known
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.shapes import across

_FAR: Final = 4.0
_OF_RIG: Final = 20_000


@dataclass(frozen=True)
class Volume:
    """A volume.

    Attributes:
        value: mm³; what lies below the plane counts negative.
        own: variance by the points' noise, mm⁶.
        by_rig: how it follows the rig's leaves; None without a rig.
        notes: sentences about it.
    """

    value: float
    own: float
    by_rig: Float[np.ndarray, "leaves"] | None
    notes: tuple[str, ...]


def volume_above(scanned: Scanned, plane: Fit, known: Known, alike: Alike) -> Volume:
    """The volume of a surface above a fitted plane, mm³.

    Args:
        scanned: the surface's points, with their places in the range image.
        plane: the plane.
        known: how well its numbers are known.
        alike: how alike neighbours' errors are in the scan.

    Raises:
        InputError: the points have no order, or are no neighbours.
    """
    if scanned.place is None:
        raise InputError("points without neighbours have no volume: measure the range image (.npz)")
    corners = _triangles(scanned)
    if not len(corners):
        raise InputError("its points are no neighbours of each other: enlarge the region")
    n = plane.shape.axis
    P = scanned.points[corners]
    height = (P - plane.shape.point) @ n
    mean = height.mean(axis=1)
    area = np.cross(P[:, 1] - P[:, 0], P[:, 2] - P[:, 0]) @ n / 2
    # Triangles of a grid are turned one way; what is seen from the plane's front counts positive.
    sign = 1.0 if area.sum() > 0 else -1.0
    area = sign * area
    by_point = np.zeros(scanned.points.shape)
    for k in range(3):
        opposite = P[:, (k + 2) % 3] - P[:, (k + 1) % 3]
        slope = (area / 3)[:, None] * n + sign * (mean / 2)[:, None] * np.cross(n, opposite)
        np.add.at(by_point, corners[:, k], slope)
    value = float((mean * area).sum())
    notes = ("parts that the scan has not seen, such as undercuts, count as the triangles over them do",)
    if scanned.by_rig is None or scanned.stripe is None or known.by_rig is None:
        return Volume(value, 0.0, None, notes)
    # By the plane: heights, and by its turns the areas as seen along its normal too.
    by_plane = plane.shape.jacobian(P.mean(axis=1)).T @ area
    turned = sign * (mean[:, None] * np.cross(P[:, 1] - P[:, 0], P[:, 2] - P[:, 0])).sum(axis=0) / 2
    by_plane[:2] += np.stack(across(n)) @ turned / plane.shape.size
    weights = (by_point * scanned.stripe).sum(axis=1)
    own = known.scale**2 * float(alike.variance(scanned.place, weights[None])[0, 0])
    own += float(by_plane @ known.own @ by_plane)
    matters = np.flatnonzero(np.abs(by_point).sum(axis=1) > 0)
    every = max(1, len(matters) // _OF_RIG)
    some = matters[::every]
    by_rig = every * np.einsum("pi,pil->l", by_point[some], scanned.by_rig(some)) + by_plane @ known.by_rig
    return Volume(value, own, by_rig, notes)


def _triangles(scanned: Scanned) -> Int[np.ndarray, "triangles 3"]:
    """Two for each cell of the grid whose corners are there and not far apart."""
    assert scanned.place is not None
    first = scanned.place.min(axis=0)
    shape = tuple(scanned.place.max(axis=0) - first + 1)
    number = np.full(shape, -1)
    number[tuple((scanned.place - first).T)] = np.arange(len(scanned.points))
    a, b, c, d = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    corners = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    corners = corners[(corners >= 0).all(axis=1)]
    sides = np.linalg.norm(scanned.points[corners] - scanned.points[np.roll(corners, 1, axis=1)], axis=2).max(axis=1)
    return corners[sides <= _FAR * np.median(sides)] if len(sides) else corners
