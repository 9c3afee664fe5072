"""Space that a scan has seen through: nothing of the object can stand there.

Between the camera and each point that it saw there is nothing. Scans that were joined in a wrong way put points into
this space of each other, even where each two of them fit well: a body that looks alike from two sides does. The points
of the floor count too, for above it the camera has seen through most of all.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.surface.side import Side

# Points of a side that are looked for on the rays of another.
_POINTS: Final = 4000
# In spacings of the side: how far before what was seen a ray begins, and how near to it is on it.
_BEFORE, _ON = 1.5, 0.25
# Of sides that are joined rightly 0.3 % of the points are in free space of another at most, of others 13 % and more.
_MOST: Final = 0.04


def check_free_space(sides: Sequence[Side], poses: Sequence[Pose]) -> None:
    """Refuse sides of which one stands where another has seen through.

    Args:
        sides: two or more; those without rays are not looked at.
        poses: T_first_side of each.

    Raises:
        InputError: they do, and which.
    """
    rays = {k: _on_rays(side) for k, side in enumerate(sides) if side.rays is not None}
    found = {
        (i, k): share_in(poses[k].inverse() @ poses[i], side, sides[k], rays[k])
        for k in rays
        for i, side in enumerate(sides)
        if i != k
    }
    if not found or max(found.values()) <= _MOST:
        return
    i, k = max(found, key=lambda pair: found[pair])
    raise InputError(
        f"{sides[i].name}: {found[i, k]:.0%} of its points would lie where {sides[k].name} has seen through, so the "
        "two are joined wrongly, however well they fit: name the scans in the order in which they were taken, and "
        "check the angles or poses, and that nothing moved on the object between them"
    )


def share_in(pose: Pose, side: Side, other: Side, on_rays: Float[np.ndarray, "places 3"]) -> float:
    """Which part of a side's points stands where another has seen through.

    Args:
        pose: T_other_side.
        side: whose points are looked for.
        other: which has seen through.
        on_rays: places of its free space, as `_on_rays` gives them.
    """
    every = max(1, len(side.points) // _POINTS)
    x, reach = pose.apply(side.points[::every]), _ON * other.spacing_mm
    inside = ((on_rays > x.min(axis=0) - reach) & (on_rays < x.max(axis=0) + reach)).all(axis=1)
    if not inside.any():
        return 0.0
    away, _ = KDTree(on_rays[inside]).query(x, distance_upper_bound=reach)
    return float(np.isfinite(away).mean())


def _on_rays(side: Side) -> Float[np.ndarray, "places 3"]:
    """Places along a side's rays, from before what was seen to as far as its points reach, own frame, mm."""
    assert side.rays is not None
    points, cameras = side.rays
    toward = cameras - points
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    size = float(np.linalg.norm(np.ptp(side.points, axis=0)))
    way = np.arange(_BEFORE * side.spacing_mm, size, _ON * side.spacing_mm)
    return (points[:, None] + way[:, None] * toward[:, None]).reshape(-1, 3)
