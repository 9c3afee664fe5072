"""Albedo: how much light a point of a surface reflects, from how bright the stripe is on it.

A matt surface (Lambert) of albedo ρ that the sheet meets has the radiance ρ E cos i, i the angle between its normal n
and the direction to the laser. All light of the stripe, summed across, depends on the surface's slope, too, for that
says how many pixels the sheet covers: along the direction d in which the surface crosses the image column (or row),

    sum ∝ ρ cos i g / s,        g = |d × r| / (|d · m| |X|),

r the unit ray, m the sheet's unit normal, |X| the distance from the camera and s that from the laser. A fan of light is
as bright as 1 / s, for its light spreads over a line that grows with s; how thick the sheet is there cancels: the
thicker, the dimmer and the wider. Near and far in all count as the square of the distance.

The strength is the greatest number of the stripe after smoothing, which is that of the pixel nearest to its middle, at
δ pixels from it. Of a bell of variance w², and smoothing of variance S², strength = sum exp(−δ² / 2 (w² + S²)) /
√(2π (w² + S²)). A single width is noisy; w² = b² + t² g², the lens's blur and the sheet's thickness, is fitted to those
of the whole scan.

Assumed, for no calibration tells it: the laser stands in its sheet, where the image's v axis (or u axis) through the
camera meets it; all rays of the fan are equally strong; surfaces are matt. What is burnt out has no albedo.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import InputError
from jaxscan.images.stripes.bell import FWHM
from jaxscan.reconstruction import RangeImage
from jaxscan.rig.light import laser_place
from jaxscan.surface.links import Links, links, sampling
from jaxscan.surface.normals import normals

# Why a point has no albedo, as reported to programs: its strength is not known, the stripe was burnt out, the point has
# no neighbours on the surface, or light or view are too oblique.
GAPS: Final = ("no_strength", "burnt_out", "alone", "oblique")
# A normal is the mean of those within this number of columns and frames that are turned by less than this from it.
_AROUND: Final = ((3, 1), float(np.cos(np.radians(25.0))))
# Groups of points by how many pixels the sheet covers, of whose widths the medians are fitted.
_GROUPS: Final = 12
# Variance of the smoothing of `images.stripes.windows`, px².
_SMOOTHED: Final = 1.0
# Light or view so oblique, cosine, tell little of the surface.
_LEAST_COSINE: Final = 0.5


def albedo(
    image: RangeImage, *, laser: Float[np.ndarray, "3"] | None = None, columns: bool = True
) -> Float[np.ndarray, "frames columns"]:
    """The relative albedo of each point: the median of the scan is 1. The arguments are those of `albedo_and_gaps`.

    Returns:
        NaN without a point, without neighbours on the surface, where light or view are more oblique than 60°, where the
        stripe was burnt out, and where the strength is not known.

    Raises:
        InputError: the light is not known, or there is one frame.
    """
    return albedo_and_gaps(image, laser=laser, columns=columns)[0]


def albedo_and_gaps(
    image: RangeImage, *, laser: Float[np.ndarray, "3"] | None = None, columns: bool = True
) -> tuple[Float[np.ndarray, "frames columns"], dict[str, int]]:
    """The relative albedo of each point, and how many points have none for each reason of `GAPS`.

    Args:
        image: with the light and the motion that it was scanned with, and with what was burnt out.
        laser: where the laser stands, camera frame, mm; None for `laser_place`.
        columns: whether the scan has a point for each image column.

    Returns:
        The albedo, as `albedo` has it; and the points without, each counted once, by its first reason.

    Raises:
        InputError: the light is not known, or there is one frame.
    """
    if not image.sheets:
        raise InputError("the light in which the scan was taken is not known, so that its albedo is not: reconstruct")
    (sheet, *_), at = image.sheets_in_frames(), image.from_camera()
    source = laser_place(image.sheets[0]) if laser is None else np.asarray(laser, np.float64)
    n = smooth_normals(image, links(image, sampling(image)))
    points, seen = image.points.astype(np.float64), image.seen()
    to_laser = (at.matrix() @ source + at.translation)[:, None] - points
    ray = points - at.translation[:, None]
    turn = at.matrix()
    gradient = np.broadcast_to(np.asarray(sheet.gradient(seen), np.float64), seen.shape)
    m = _unit(np.einsum("fij,fcj->fci", turn, gradient))
    across = np.broadcast_to((turn @ ([0.0, 1.0, 0.0] if columns else [1.0, 0.0, 0.0]))[:, None], ray.shape)
    d = _unit(np.cross(n, np.cross(ray, across)))
    near, far = np.linalg.norm(to_laser, axis=-1), np.linalg.norm(ray, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        incidence = (n * to_laser).sum(axis=-1) / near
        view = -(n * ray).sum(axis=-1) / far
        wide = np.linalg.norm(np.cross(d, ray / far[..., None]), axis=-1) / np.abs((d * m).sum(axis=-1))
        spread = wide / far
        breadth2 = _breadth2(image, spread) + _SMOOTHED
        off = image.pixels - np.rint(image.pixels)
        total = image.strength * np.sqrt(breadth2) * np.exp(off**2 / (2 * breadth2))
        found = total * near / (incidence * spread)
        known = image.valid & (incidence > _LEAST_COSINE) & (view > _LEAST_COSINE) & (image.strength > 0)
    known &= np.isfinite(found)
    if image.width is not None:
        known &= np.isfinite(image.width)
    median = np.median(found[known]) if known.any() else 1.0
    return np.where(known, found / median, np.nan).astype(np.float32), _gaps(image, n, image.valid & ~known)


def _gaps(
    image: RangeImage, n: Float[np.ndarray, "frames columns 3"], without: Bool[np.ndarray, "frames columns"]
) -> dict[str, int]:
    """How many of the points without an albedo have none for each reason."""
    with np.errstate(invalid="ignore"):
        dim = ~(image.strength > 0)
    burnt = np.zeros(without.shape, bool) if image.width is None else ~np.isfinite(image.width)
    alone = ~np.isfinite(n).all(axis=-1)
    counts = {}
    for reason, here in zip(GAPS, (dim, burnt, alone, np.ones(without.shape, bool)), strict=True):
        counts[reason] = int((without & here).sum())
        without = without & ~here
    return counts


def _breadth2(image: RangeImage, spread: Float[np.ndarray, "frames columns"]) -> Float[np.ndarray, "frames columns"]:
    """The variance of the stripe's bell at each point, px²: b² + t² g² of the scan's widths; 0 where none is known."""
    if image.width is None:
        return np.zeros(spread.shape)
    seen2 = (image.width / FWHM) ** 2
    some = np.isfinite(seen2) & np.isfinite(spread)
    if not some.any():
        return np.zeros(spread.shape)
    g2, w2 = spread[some] ** 2, seen2[some]
    edges = np.quantile(g2, np.linspace(0, 1, _GROUPS + 1))
    group = np.clip(np.searchsorted(edges, g2, side="right") - 1, 0, _GROUPS - 1)
    at, of = (np.array([np.median(each[group == k]) for k in np.unique(group)]) for each in (g2, w2))
    slope = float(np.cov(at, of)[0, 1] / np.var(at, ddof=1)) if len(at) > 2 and np.var(at) > 0 else 0.0
    slope = max(slope, 0.0)
    return np.maximum(np.median(of - slope * at), 0.0) + slope * spread**2


def smooth_normals(image: RangeImage, linked: Links) -> Float[np.ndarray, "frames columns 3"]:
    """Unit normals on the camera's side, each the mean of those about it that face nearly its way; NaN for none."""
    own = normals(image, linked).astype(np.float64)
    (columns, frames), alike = _AROUND
    known = np.nan_to_num(own)
    total = np.zeros_like(known)
    wide = np.pad(known, ((frames, frames), (columns, columns), (0, 0)))
    rows, lines = own.shape[:2]
    for i in range(2 * frames + 1):
        for j in range(2 * columns + 1):
            other = wide[i : i + rows, j : j + lines]
            total += np.where(((other * known).sum(axis=-1) > alike)[..., None], other, 0.0)
    return np.where(np.isfinite(own), _unit(total), np.nan)


def _unit(vectors: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    with np.errstate(invalid="ignore", divide="ignore"):
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
