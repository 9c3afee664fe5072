"""The bare bed's own scan as the floor: heights above what was scanned, point by point, and not above a plane.

In the frame of the bed's plane its points are heights over x and y. Below a point the bed is as high as the plane
through the points of the bed around it, where there are enough on all sides, and else as high as they are in the mean.
Where no point of the bed is near, no height is known.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxscan.reconstruction import RangeImage
from jaxscan.robust import NORMAL_MAD
from jaxscan.surface.clean import clean
from jaxscan.surface.floor import Floor, find_floor
from jaxscan.surface.links import sampling

# Of the bed's points, how many around a place say how high it is, and how far they may be, in spacings.
_AROUND: Final = 16
_REACH: Final = 4.0
_POINTS_AT_ONCE: Final = 1 << 16
# The scatter of the bed is estimated by comparing this number of its points with the others.
_TRIED: Final = 20_000


@dataclass(frozen=True)
class ScannedFloor(Floor):
    """A bed as it was scanned; `sigma_mm` is the scatter of a point of it about what the others say.

    Attributes:
        bed: its points, object frame, mm.
        reach_mm: how far from the nearest of them a height is known.
    """

    bed: Float[np.ndarray, "points 3"]
    reach_mm: float

    @cached_property
    def _surface(self) -> tuple[KDTree, Float[np.ndarray, "points"]]:
        local = self.frame.inverse().apply(self.bed)
        return KDTree(local[:, :2]), local[:, 2]

    def height(self, points: Float[np.ndarray, "*grid 3"]) -> Float[np.ndarray, "*grid"]:
        """How far points are above the bed, mm; NaN where the bed was not scanned."""
        local = self.frame.inverse().apply(np.asarray(points, np.float64))
        known = np.isfinite(local).all(axis=-1)
        height = np.full(known.shape, np.nan)
        height[known] = local[known][:, 2] - self._level(local[known][:, :2])
        return height

    def _level(self, places: Float[np.ndarray, "points 2"], skip: int = 0) -> Float[np.ndarray, "points"]:
        """How high the bed is over its plane; of the points around, the first `skip` do not count."""
        tree, z = self._surface
        level = np.full(len(places), np.nan)
        for start in range(0, len(places), _POINTS_AT_ONCE):
            here = slice(start, start + _POINTS_AT_ONCE)
            away, index = tree.query(places[here], _AROUND + skip, distance_upper_bound=self.reach_mm)
            there, index = np.isfinite(away)[:, skip:], np.asarray(index)[:, skip:]
            level[here] = _at_origin(tree.data, z, np.where(there, index, 0), there, places[here])
        return level


def floor_from_scan(image: RangeImage) -> ScannedFloor:
    """The bed that a scan of nothing else shows.

    Raises:
        InputError: there is no plane in it, or no surface.
    """
    image = clean(image).image
    plane = find_floor(image)
    how = sampling(image)
    bed = image.points[image.valid].astype(np.float64)
    reach = _REACH * max(how.across_mm, how.along_mm)
    floor = ScannedFloor(plane.frame, plane.sigma_mm, plane.flatness_mm, plane.share, bed, reach)
    tried = plane.frame.inverse().apply(bed[:: max(1, len(bed) // _TRIED)])
    off = np.abs(tried[:, 2] - floor._level(tried[:, :2], skip=1))
    sigma = NORMAL_MAD * float(np.nanmedian(off))
    sigma = max(sigma, float(np.sqrt(np.mean(np.square(off[off <= 3 * sigma])))))
    return ScannedFloor(plane.frame, sigma, plane.flatness_mm, plane.share, bed, reach)


def _at_origin(
    places: np.ndarray, z: np.ndarray, index: np.ndarray, there: np.ndarray, origin: np.ndarray
) -> Float[np.ndarray, "points"]:
    """The value at each origin of the plane of least squares through the values around it."""
    count = np.maximum(there.sum(axis=1), 1)
    offset = np.where(there[..., None], places[index] - origin[:, None], 0.0)
    values = np.where(there, z[index], 0.0)
    middle, mean = offset.sum(axis=1) / count[:, None], values.sum(axis=1) / count
    offset = np.where(there[..., None], offset - middle[:, None], 0.0)
    xx, yy = (offset[..., 0] ** 2).sum(axis=1), (offset[..., 1] ** 2).sum(axis=1)
    xy = (offset[..., 0] * offset[..., 1]).sum(axis=1)
    xz, yz = (offset * (values - mean[:, None])[..., None]).sum(axis=1).T
    determinant = xx * yy - xy**2
    # The points lie around the place, and not beside it or on one line.
    around = (determinant > 0.01 * (xx + yy) ** 2) & ((middle**2).sum(axis=1) * count < xx + yy)
    safe = np.where(around, determinant, 1.0)
    slope_x, slope_y = (yy * xz - xy * yz) / safe, (xx * yz - xy * xz) / safe
    level = np.where(around, mean - slope_x * middle[:, 0] - slope_y * middle[:, 1], mean)
    return np.where(there.any(axis=1), level, np.nan)
