"""A cloud against a reference: how far off it is, and steps and flatness of picked regions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.surface.fit import rigid_fit_to
from jaxscan.surface.reference import Reference, diagonal, signed_distance

# A point that is this many times as far off as the median is far: of normal errors one in 10^11.
_FAR: Final = 10.0
# A median that is less, mm, is rounding, and measures nothing.
_ROUNDING_MM: Final = 1e-6


@dataclass(frozen=True)
class Comparison:
    """How far a cloud is from a reference, mm.

    Attributes:
        points: the cloud, where it was compared.
        distance: of each of them, positive in front of the surface; NaN where it was further than was asked for.
        motion: that carried the cloud there; None where it stayed where it was.
    """

    points: Float[np.ndarray, "points 3"]
    distance: Float[np.ndarray, "points"]
    motion: Pose | None = None

    def figures(self) -> dict[str, float | int]:
        """The mean with its sign; root mean square, median, 95 % and largest of the distances without, mm.

        Points farther off than ten times the median are far: `points_far` is how many, `far_mm` that distance, and
        `rms_without_far_mm` the root mean square of the others. All other figures are of all points.
        """
        known = self.distance[np.isfinite(self.distance)]
        size = np.abs(known)
        median = float(np.median(size))
        limit = _FAR * median if median > _ROUNDING_MM else np.inf
        near = known[size <= limit]
        return {
            "points": len(known),
            "points_beyond": len(self.distance) - len(known),
            "mean_mm": float(known.mean()),
            "rms_mm": float(np.sqrt((known**2).mean())),
            "median_mm": float(np.median(size)),
            "p95_mm": float(np.percentile(size, 95)),
            "largest_mm": float(size.max()),
            "points_far": len(known) - len(near),
            "far_mm": limit if np.isfinite(limit) else float(size.max()),
            "rms_without_far_mm": float(np.sqrt((near**2).mean())),
        }


@dataclass(frozen=True)
class Region:
    """A flat piece of a cloud.

    Attributes:
        centre: of its points, mm.
        normal: of the plane through them, toward the origin of the cloud's frame.
        points: how many.
        rms_mm: of their distances from the plane.
        flatness_mm: from the lowest to the highest.
    """

    centre: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    points: int
    rms_mm: float
    flatness_mm: float

    def above(self, other: "Region") -> float:
        """How far its middle is above the plane of another region, mm."""
        return float((self.centre - other.centre) @ other.normal)


def compare(
    cloud: Float[np.ndarray, "points 3"], reference: Reference, *, fit: bool = False, within_mm: float = np.inf
) -> Comparison:
    """Distances of a cloud from a reference.

    Args:
        cloud: mm.
        reference: what it is held against.
        fit: move the cloud rigidly onto the reference first.
        within_mm: points further away do not count.

    Raises:
        InputError: cloud and reference lie apart, no point is near enough, or as `rigid_fit_to`.
    """
    points = np.asarray(cloud, np.float64)
    motion = (
        rigid_fit_to(reference, points[_near(reference, points, within_mm)] if not fit else points) if fit else None
    )
    if motion is not None:
        points = motion.apply(points)
    elif not _overlap(reference, points):
        raise InputError(
            "cloud and reference lie apart: see that both have one unit of length (--units, --reference-units); if "
            "they are not in one frame, have the cloud fitted first (--fit)"
        )
    distance = signed_distance(reference, points)
    distance[np.abs(distance) > within_mm] = np.nan
    if not np.isfinite(distance).any():
        raise InputError(f"no point is within {within_mm:g} mm of the reference: allow more, or fit the cloud first")
    return Comparison(points, distance, motion)


def region(cloud: Float[np.ndarray, "points 3"], pick: Sequence[float], radius_mm: float) -> Region:
    """The piece of a cloud within a ball around a pick.

    Raises:
        InputError: fewer than ten points are there.
    """
    near = cloud[np.linalg.norm(cloud - np.asarray(pick), axis=1) <= radius_mm].astype(np.float64)
    if len(near) < 10:
        raise InputError(
            f"{len(near)} points lie within {radius_mm:g} mm of {list(pick)}: ten or more are needed, so give a larger "
            "radius, or another point (`jaxscan inspect` says how far the cloud reaches)"
        )
    centre = near.mean(axis=0)
    normal = np.linalg.svd(near - centre, full_matrices=False)[2][2]
    normal *= -1 if normal @ centre > 0 else 1
    height = (near - centre) @ normal
    return Region(centre, normal, len(near), float(height.std()), float(np.ptp(height)))


def _overlap(reference: Reference, points: Float[np.ndarray, "points 3"]) -> bool:
    """Whether any point is within the reference's box, widened by half of its diagonal."""
    low, high = reference.bounds
    more = 0.5 * diagonal(reference)
    return bool(((points >= low - more) & (points <= high + more)).all(axis=1).any())
