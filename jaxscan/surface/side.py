"""One side of an object as registration needs it: points with normals, and how well each is known along its normal.

A stripe's error moves its point X along the line in which the sheet of light, ω · X = 1, meets the plane of the image
column (or row); with that line's direction e, the ray's d and the normal n, σ along the ray becomes along the normal

    σ |n · e| / |d · e|.

The rig's part of σ is known along the ray alone. Errors of the rig move a point sideways about as far as along its ray,
so that the part along the normal is taken to be the same.

The sheet's normal at each point is that of the range image's light; range images of older files have none, and there
ω is the plane through all points as the camera saw them. A column's plane contains the camera. Where the points lie on
no such plane the error is taken to be along the ray.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.point_sigma import rig_part
from jaxscan.surface.clean import clean
from jaxscan.surface.floor import Floor, find_floor, stands_on
from jaxscan.surface.links import Sampling, sampling
from jaxscan.surface.triangles import Surface, even_points

# Planes are fitted to the points within this number of spacings.
_AROUND: Final = 1.5
_MOST_AROUND, _FEWEST_AROUND = 64, 6
# A point whose neighbours' mean is off by more than this part of their reach has them on one side: it is on the rim.
_OFF_CENTRE: Final = 0.3
# Along its normal a point is known no better than this part of its σ along the ray: where light grazes, its place
# beside the ray counts.
_BEST: Final = 0.3
# |ω · X − 1| of points that lie on the sheet, beyond their rounding.
_OFF_SHEET: Final = 1e-3
_FEWEST: Final = 100
# Rays of a side that are kept.
_RAYS: Final = 6000
# The neighbour whose distance stands for the spacing of points without an order.
_NEIGHBOUR: Final = 24


@dataclass(frozen=True)
class Side:
    """The points of one scan.

    Attributes:
        name: what the scan is called.
        points: its object frame, mm.
        normals: unit, on the camera's side; of the plane through the points around.
        sigma: of each point's distance from the surface, mm: the pixel's part, which no other scan shares.
        rim: points with neighbours on one side alone.
        spacing_mm: from point to point, the larger of along and across.
        floor: what the object stood on, where it is known.
        sigma_rig: σ of the same distance by the rig, mm, which all scans with one rig share; NaN where it is not known.
        painted: the scan's points with their colours, where it has them.
        rays: some of what the camera saw, the floor too, and from where, mm each; None where that is not known.
    """

    name: str
    points: Float[np.ndarray, "points 3"]
    normals: Float[np.ndarray, "points 3"]
    sigma: Float[np.ndarray, "points"]
    rim: Bool[np.ndarray, "points"]
    spacing_mm: float
    floor: Floor | None = None
    sigma_rig: Float[np.ndarray, "points"] | None = None
    painted: Cloud | None = None
    rays: tuple[Float[np.ndarray, "seen 3"], Float[np.ndarray, "seen 3"]] | None = None

    @cached_property
    def tree(self) -> KDTree:
        """For the nearest of its points."""
        return KDTree(self.points)


def side_of_image(name: str, image: RangeImage, *, cleaned: bool = True, on_floor: bool = True) -> Side:
    """A side from a range image as it was reconstructed.

    Args:
        name: what the scan is called.
        image: the range image.
        cleaned: whether to leave out what `clean` does.
        on_floor: whether to find the floor that the object stands on, and leave it out.

    Raises:
        InputError: there is no floor, or there are too few points to register.
    """
    image = clean(image).image if cleaned else image
    cameras = image.cameras()
    frame, column = np.nonzero(image.valid)
    every = slice(None, None, max(1, len(frame) // _RAYS))
    rays = image.points[frame[every], column[every]].astype(np.float64), cameras[frame[every]]
    floor = find_floor(image) if on_floor else None
    image = image.where(stands_on(image, floor)) if floor else image
    how = sampling(image)
    points = image.points[image.valid].astype(np.float64)
    to_camera = np.broadcast_to(cameras[:, None], image.points.shape)[image.valid] - points
    e = error_direction(image)[image.valid]
    pixel, rig = (part[image.valid] for part in _parts_of_sigma(image, how))
    side = _side_of_points(name, points, to_camera, e, (pixel, rig), max(how.across_mm, how.along_mm), floor)
    return replace(side, rays=rays, painted=None if image.colours is None else image.cloud())


def side_of_surface(name: str, image: RangeImage, surface: Surface, how: Sampling) -> Side:
    """A side from the triangles of a range image, with more points where they are large.

    A turn samples its surface closely about the axis and widely far from it, and so does any scan of a wall. Points are
    added until none are further apart than the spacing; n² instead of one have a σ n times as large, so that they
    weigh no more than it.

    Args:
        name: what the scan is called.
        image: the range image.
        surface: triangles between its points.
        how: its spacing and noise.

    Raises:
        InputError: there are too few points.
    """
    spacing = max(how.across_mm, how.along_mm)
    corners, weights, parts = even_points(surface, spacing)
    place = surface.place[corners]

    def mean(values: Float[np.ndarray, "frames columns *each"]) -> Float[np.ndarray, "points *each"]:
        return np.einsum("pk,pk...->p...", weights, values.reshape(-1, *values.shape[2:])[place].astype(np.float64))

    points = mean(image.points)
    to_camera = mean(np.broadcast_to(image.cameras()[:, None], image.points.shape)) - points
    pixel, rig = (mean(part) for part in _parts_of_sigma(image, how))
    e = mean(error_direction(image))
    return _side_of_points(name, points, to_camera, e, (pixel * parts, rig), spacing, None)


def side_of_cloud(name: str, cloud: Cloud) -> Side:
    """A side from points without an order, seen from the origin of their frame.

    Raises:
        InputError: there are too few points to register.
    """
    points = cloud.points.astype(np.float64)
    _check(name, points)
    spacing = float(np.median(KDTree(points).query(points, min(_NEIGHBOUR, len(points)))[0][:, -1])) / _AROUND
    normals, rim, rms = _planes(name, points, -points, _AROUND * spacing)
    known = cloud.sigma if cloud.sigma_pixel is None else cloud.sigma_pixel
    sigma = np.zeros(len(points)) if known is None else known.astype(np.float64)
    ray = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = np.maximum(np.abs((normals * ray).sum(axis=1)), _BEST)
    rig = np.full(len(points), np.nan)
    if cloud.sigma is not None and cloud.sigma_pixel is not None:
        rig = rig_part(cloud.sigma.astype(np.float64), sigma)
    side = _side(name, points, normals, (along * sigma, rig), rim, rms, spacing, None)
    return side if cloud.colours is None else replace(side, painted=cloud)


def error_direction(image: RangeImage) -> Float[np.ndarray, "frames columns 3"]:
    """The direction in which a stripe's error moves each point: unit; NaN where there is no point."""
    seen = image.seen()
    normal = _sheet_normal(image, seen)
    if normal is None:
        e = seen
    else:
        # Along a column of the image x / z stays the same, along a row y / z.
        full = image.valid.sum(axis=0) > 1
        held = np.median(np.nanstd((seen / seen[..., 2:])[:, full], axis=0)[:, :2], axis=0).argmin()
        e = along_line(normal, seen, int(held))
    e = e @ image.from_camera().matrix().swapaxes(-1, -2)
    return e / np.linalg.norm(e, axis=-1, keepdims=True)


def along_line(
    normal: Float[np.ndarray, "*points 3"], seen: Float[np.ndarray, "*points 3"], held: int
) -> Float[np.ndarray, "*points 3"]:
    """Along the line in which the sheet meets the plane of an image column (or row), camera frame; of any length.

    Args:
        normal: of the sheet.
        seen: each point, or any other on its ray.
        held: which of x and y stays the same along the column (0) or the row (1).
    """
    across = np.zeros_like(seen)
    across[..., held], across[..., 2] = seen[..., 2], -seen[..., held]
    return np.cross(normal, across)


def _sheet_normal(
    image: RangeImage, seen: Float[np.ndarray, "frames columns 3"]
) -> Float[np.ndarray, "*frames_columns 3"] | None:
    """The normal of the sheet at each point as the camera saw it; None where the points lie on no sheet.

    Range images of older files do not have their light: there it is the plane through all points.
    """
    for sheet in image.sheets_in_frames():
        return np.asarray(sheet.gradient(seen))
    normal = np.linalg.lstsq(seen[image.valid], np.ones(int(image.valid.sum())), rcond=None)[0]
    return None if np.abs(seen[image.valid] @ normal - 1).max() > _OFF_SHEET else normal


def _parts_of_sigma(
    image: RangeImage, how: Sampling
) -> tuple[Float[np.ndarray, "frames columns"], Float[np.ndarray, "frames columns"]]:
    """The pixel's part of σ along the ray, by the noise where it is not known, and the rig's, NaN where it is not."""
    pixel = image.sigma_pixel.astype(np.float64)
    pixel = np.where(np.isfinite(pixel) & (pixel > 0), pixel, how.noise_mm)
    return pixel, rig_part(image.sigma.astype(np.float64), pixel)


def _side_of_points(
    name: str,
    points: Float[np.ndarray, "points 3"],
    to_camera: Float[np.ndarray, "points 3"],
    e: Float[np.ndarray, "points 3"],
    sigma: tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]],
    spacing: float,
    floor: Floor | None,
) -> Side:
    """With σ of pixel and rig along the rays, and the directions in which an error of the stripe moves the points."""
    normals, rim, rms = _planes(name, points, to_camera, _AROUND * spacing)
    ray = -to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
    along = np.abs((normals * e).sum(axis=1)) / np.maximum(np.abs((ray * e).sum(axis=1)), 1e-3)
    pixel, rig = sigma
    return _side(name, points, normals, (pixel * np.maximum(along, _BEST), rig), rim, rms, spacing, floor)


def _side(
    name: str,
    points: Float[np.ndarray, "points 3"],
    normals: Float[np.ndarray, "points 3"],
    sigma: tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]],
    rim: Bool[np.ndarray, "points"],
    rms: Float[np.ndarray, "points"],
    spacing: float,
    floor: Floor | None,
) -> Side:
    """Without the points that have no normal; where the pixel's σ is not known it is the scatter of the points around.

    σ is along the normal, of pixel and rig.
    """
    known = np.isfinite(normals).all(axis=1)
    typical = float(np.median(rms[known])) if known.any() else 0.0
    pixel, rig = sigma
    pixel = np.where(pixel > 0, pixel, max(typical, 1e-6))
    points = points[known]
    _check(name, points)
    return Side(name, points, normals[known], pixel[known], rim[known], spacing, floor, rig[known])


def _check(name: str, points: Float[np.ndarray, "points 3"]) -> None:
    if len(points) < _FEWEST:
        raise InputError(f"{name}: {len(points)} points are too few to register: {_FEWEST} or more are needed")


def _planes(
    name: str, points: Float[np.ndarray, "points 3"], toward: Float[np.ndarray, "points 3"], reach: float
) -> tuple[Float[np.ndarray, "points 3"], Bool[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """The plane through the points within a reach of each: its normal, whether it is on the rim, its scatter."""
    _check(name, points)
    away, index = KDTree(points).query(points, _MOST_AROUND, distance_upper_bound=reach)
    there = np.isfinite(away)
    count = there.sum(axis=1)
    near = np.where(there[..., None], points[np.where(there, index, 0)] - points[:, None], 0.0)
    mean = near.sum(axis=1) / count[:, None]
    near = np.where(there[..., None], near - mean[:, None], 0.0)
    values, vectors = np.linalg.eigh(near.swapaxes(1, 2) @ near)
    normal = vectors[:, :, 0]
    normal = np.where(((normal * toward).sum(axis=1) < 0)[:, None], -normal, normal)
    # Points on one line have no plane.
    normal[(count < _FEWEST_AROUND) | (values[:, 1] < 0.01 * values[:, 2])] = np.nan
    farthest = np.where(there, away, 0.0).max(axis=1)
    rim = np.linalg.norm(mean, axis=1) > _OFF_CENTRE * farthest
    return normal, rim, np.sqrt(np.maximum(values[:, 0], 0) / np.maximum(count - 3, 1))
