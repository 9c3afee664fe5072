"""Planes through points of which many lie elsewhere: random triples judged by the caller, rounds of least squares."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.geometry.pose import Pose
from jaxscan.robust import NORMAL_MAD

_TRIALS: Final = 400
_SAMPLE: Final = 1500
_SEED: Final = 2003
# A plane's points are first looked for within this distance, and its scatter judged by those within the other, mm.
_ROUGHLY_MM: Final = 0.3
_WITHIN_MM: Final = 1.0


def planes_through(
    a: Float[np.ndarray, "triples 3"], b: Float[np.ndarray, "triples 3"], c: Float[np.ndarray, "triples 3"]
) -> tuple[Float[np.ndarray, "planes 3"], Float[np.ndarray, "planes 3"]]:
    """A point and the unit normal of the plane through each triple; triples on a line are left out."""
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    proper = length > 1e-9
    return a[proper], normal[proper] / length[proper, None]


def random_planes(
    cloud: Float[np.ndarray, "points 3"], within: float
) -> tuple[Float[np.ndarray, "planes 3"], Float[np.ndarray, "planes 3"], Float[np.ndarray, "planes"]]:
    """Planes through triples of some points: a point of each, its unit normal, and which share of the points it holds.

    Args:
        cloud: mm.
        within: how near to it a point of a plane is, mm.
    """
    rng = np.random.default_rng(_SEED)
    sample = cloud[rng.permutation(len(cloud))[:_SAMPLE]]
    a, b, c = (sample[rng.integers(len(sample), size=_TRIALS)] for _ in range(3))
    centres, normals = planes_through(a, b, c)
    off = np.abs(sample @ normals.T - (centres * normals).sum(axis=1))
    return centres, normals, (off < within).mean(axis=0)


def refined_plane(
    points: Float[np.ndarray, "points 3"],
    centre: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
    *,
    within: float = np.inf,
    rounds: int = 10,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Rounds of least squares over the points within 3 σ of a plane, σ from the median distance of those `within`."""
    for _ in range(rounds):
        distance = np.abs((points - centre) @ normal)
        near = distance <= max(3 * NORMAL_MAD * float(np.median(distance[distance < within])), 1e-9)
        centre = points[near].mean(axis=0)
        normal = np.linalg.svd(points[near] - centre, full_matrices=False)[2][2]
    return centre, normal


def dominant_plane(cloud: Float[np.ndarray, "points 3"], across: Float[np.ndarray, "3"] | None = None) -> Pose:
    """The frame of the plane that the most points lie on, its z toward the origin.

    Args:
        cloud: mm.
        across: a direction that the plane holds, within 10°; by default it may be any plane.

    Raises:
        InputError: the points lie on no plane.
    """
    centres, normals, near = random_planes(cloud, _ROUGHLY_MM)
    if not len(normals):
        raise InputError("the scan's points lie on one line: scan more frames")
    if across is not None:
        near = np.where(np.abs(normals @ across) < np.sin(np.radians(10.0)) * np.linalg.norm(across), near, 0)
    best = int(near.argmax())
    if not near[best]:
        raise InputError("no plane through the scan's points holds the direction in which the stage moves")
    centre, normal = refined_plane(cloud, centres[best], normals[best], within=_WITHIN_MM, rounds=5)
    return plane_frame(centre, normal)


def plane_frame(
    centre: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"] | None = None
) -> Pose:
    """The frame of a plane at a point of it: z its normal on the origin's side, y as near as can be to `along`.

    By default `along` is the camera's y axis, or its x axis where that is nearly the normal.
    """
    z = -normal if normal @ centre > 0 else normal
    if along is None:
        along = np.array([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0])
    x = np.cross(along, z)
    x /= np.linalg.norm(x)
    return Pose.from_matrix(np.stack([x, np.cross(z, x), z], axis=1), centre)
