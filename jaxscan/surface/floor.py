"""The floor that an object stands on: found, measured, and taken away.

The floor is the plane with the most points, among those that hold the direction of the stage's travel where that is
known, or one parallel to it below with at least a quarter as many. σ is the scatter of its own points about it, noise
and unevenness together.

What stands on it is found with two thresholds: points more than 3 σ above the floor that are connected with some more
than 6 σ above it. So the object is kept down to where it touches the floor, and the one in seven hundred of the floor's
points that scatter beyond 3 σ go with the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import InputError
from jaxscan.files.floor_note import FloorNote
from jaxscan.geometry import Pose
from jaxscan.geometry.robust_plane import dominant_plane, plane_frame, refined_plane
from jaxscan.reconstruction import RangeImage
from jaxscan.robust import NORMAL_MAD
from jaxscan.surface.clean import patches
from jaxscan.surface.links import Links, links, next_frame

_LOW, _HIGH = 3.0, 6.0
# A floor has at least this part of all points, and at most that part below it.
_LEAST_SHARE, _MOST_BELOW = 0.1, 0.1
# A parallel plane below is the floor if it has at least this part of the first one's points.
_LOWER_SHARE: Final = 0.25
# Points around a picked one, and how far from a plane its scatter is judged, mm.
_AROUND_MM, _WITHIN_MM = 2.0, 1.0
# Points spread evenly over the distance in which a floor's scatter is judged have a σ of 0.74 mm: they are no floor.
_LARGEST_SIGMA_MM: Final = 0.5
# A σ that is less than this, mm, is rounding: of points that were computed, and lie on one plane exactly.
_ROUNDING_MM: Final = 1e-9
# Size of the squares whose mean heights give the flatness, mm, and how many points each has.
_SQUARE_MM, _FEWEST_IN_SQUARE = 5.0, 8
# What stands on the floor has at least this many points.
_FEWEST: Final = 12


@dataclass(frozen=True)
class Floor:
    """A plane with what stands on it above.

    Attributes:
        frame: T_object_floor: at a point of it, y as near as can be to the stage's travel where that is known, z up.
        sigma_mm: the scatter of its points about it.
        flatness_mm: from the lowest to the highest mean of its points in squares of 5 mm; NaN where it was not seen.
        share: its part of all points.
    """

    frame: Pose
    sigma_mm: float
    flatness_mm: float
    share: float

    @cached_property
    def up(self) -> Float[np.ndarray, "3"]:
        """Its normal, object frame."""
        return self.frame.matrix()[:, 2]

    @property
    def tolerance_mm(self) -> float:
        """What is nearer to the plane than this is the floor."""
        return _LOW * self.sigma_mm

    def height(self, points: Float[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid"]:
        """How far points are above the floor, mm."""
        return (points - self.frame.translation) @ self.up

    def note(self) -> FloorNote:
        """Its plane, as files note it."""
        return FloorNote(self.up, -float(self.frame.translation @ self.up))


def find_floor(image: RangeImage) -> Floor:
    """The floor of a scan.

    Raises:
        InputError: there is none.
    """
    cloud = image.points[image.valid].astype(np.float64)
    if len(cloud) < 3:
        raise InputError(f"{len(cloud)} points have no floor: scan more")
    frame = dominant_plane(cloud, image.travel())
    origin, up = frame.translation, frame.matrix()[:, 2]
    height = (cloud - origin) @ up
    floor = _measured(cloud, origin, up, image)
    below = cloud[height < -2 * _HIGH * floor.sigma_mm]
    if len(below) >= _LOWER_SHARE * floor.share * len(cloud):
        # The level below at which most points lie, if it has enough.
        depth = (below - origin) @ up
        width = _HIGH * floor.sigma_mm
        levels, count = np.unique(np.round(depth / width), return_counts=True)
        at = origin + levels[count.argmax()] * width * up
        near = below[np.abs((below - at) @ up) < _WITHIN_MM]
        lower = _measured(cloud, *refined_plane(near, at, up, within=_WITHIN_MM), image)
        parallel = abs(lower.up @ up) > np.cos(np.radians(5.0))
        floor = lower if parallel and lower.share >= _LOWER_SHARE * floor.share else floor
    under = float((floor.height(cloud) < -_HIGH * floor.sigma_mm).mean())
    if floor.share < _LEAST_SHARE or under > _MOST_BELOW or floor.sigma_mm > _LARGEST_SIGMA_MM:
        raise InputError(
            f"no floor was found: the best plane holds {100 * floor.share:.0f} % of the points within "
            f"{floor.tolerance_mm:.2g} mm, and {100 * under:.0f} % lie below it: keep what there is (--floor keep); "
            "`jaxscan mesh` also takes points of the floor (--floor X,Y,Z:X,Y,Z:X,Y,Z) or a scan of the bare stage "
            "(--floor bare.npz)"
        )
    return floor


def floor_from_picks(image: RangeImage, picks: Sequence[Sequence[float]]) -> Floor:
    """The plane through the points around three or more picked ones.

    Args:
        image: the range image.
        picks: (x, y, z), object frame, mm.

    Raises:
        InputError: there are fewer than three, they lie on one line, or there are no points around one.
    """
    cloud = image.points[image.valid].astype(np.float64)
    if len(picks) < 3:
        raise InputError(f"{len(picks)} picked points give no plane: pick three or more, far from each other")
    around = []
    for pick in picks:
        away = np.linalg.norm(cloud - pick, axis=1)
        near = cloud[away < _AROUND_MM]
        if not len(near):
            if not len(cloud):
                raise InputError("0 points have no floor: scan more")
            x, y, z = cloud[away.argmin()]
            raise InputError(
                f"there is no point within {_AROUND_MM:g} mm of the pick {list(pick)}; the nearest is {x:.2f},{y:.2f},"
                f"{z:.2f}, {away.min():.3g} mm away: pick on the points"
            )
        around.append(near)
    points = np.concatenate(around)
    middles = np.stack([near.mean(axis=0) for near in around])
    centre = middles.mean(axis=0)
    _, spread, axes = np.linalg.svd(middles - centre, full_matrices=False)
    if spread[1] < 0.05 * spread[0]:
        raise InputError("the picked points lie on one line: pick some beside it")
    return _measured(cloud, *refined_plane(points, centre, axes[2], within=_WITHIN_MM), image)


def stands_on(image: RangeImage, floor: Floor, linked: Links | None = None) -> Bool[np.ndarray, "frames columns"]:
    """The points of the objects on the floor.

    Raises:
        InputError: there are none.
    """
    with np.errstate(invalid="ignore"):
        height = floor.height(image.points)
        # Beside a bed that was scanned its plane goes on.
        height = np.where(np.isnan(height), (image.points - floor.frame.translation) @ floor.up, height)
        above = image.valid & (height > _LOW * floor.sigma_mm)
        core = above & (height > _HIGH * floor.sigma_mm)
    linked = linked or links(image)
    gaps = len(linked.along)
    along = linked.along & above[:gaps] & next_frame(above, gaps)
    label = patches(image.where(above), Links(linked.across & above[:, 1:] & above[:, :-1], along))
    count = np.bincount(label[core], minlength=image.valid.size)
    kept = above & (count[label] >= _FEWEST)
    if not kept.any():
        raise InputError(
            f"nothing stands on the floor: of {int(image.valid.sum())} points none is joined to others more "
            f"than {_HIGH * floor.sigma_mm:.2g} mm above it: keep the floor if it is what you want"
        )
    return kept


def _measured(
    cloud: Float[np.ndarray, "points 3"],
    origin: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"],
    image: RangeImage,
) -> Floor:
    """The plane with its scatter and flatness."""
    frame = plane_frame(origin, normal, image.travel())
    local = frame.inverse().apply(cloud)
    height = local[:, 2]
    near = np.abs(height) < _WITHIN_MM
    sigma = NORMAL_MAD * float(np.median(np.abs(height[near]))) if near.any() else np.nan
    on = np.abs(height) <= _LOW * sigma
    sigma = max(sigma, float(height[on].std()), _ROUNDING_MM) if on.any() else sigma
    squares = np.floor(local[on, :2] / _SQUARE_MM)
    _, square, count = np.unique(squares, axis=0, return_inverse=True, return_counts=True)
    means = np.bincount(square.ravel(), height[on]) / count
    means = means[count >= _FEWEST_IN_SQUARE]
    return Floor(frame, sigma, float(np.ptp(means)) if len(means) else np.nan, float(on.mean()))
