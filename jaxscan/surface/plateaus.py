"""Plateaus: pieces of what stands on the floor that are level with it, and their heights.

Around every point a plane is fitted to the heights near it, those on the far side of a step left out. Where it slopes
as little as a plateau does, within its own uncertainty, neighbours of nearly the same fitted height are connected. A
piece that is large enough, and as a whole hardly tilted, is a plateau.

Its height is the mean of its points. Errors of neighbouring points are alike, so the standard error is that of means of
squares, nine or more, and the floor's own under the plateau is added: of the plane through means of squares of what is
seen of the floor. What the rig is wrong by is common to plateau and floor, and no part of it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.stats import t as students_t

from jaxscan.errors import InputError
from jaxscan.reconstruction import RangeImage
from jaxscan.surface.floor import Floor, stands_on
from jaxscan.surface.links import next_frame, sampling
from jaxscan.surface.passages import passages

# Of the fitted planes: how far they reach, in spacings, and at least, mm; how many points they are fitted to.
_REACH, _SMALLEST_MM = 1.6, 1.0
_AROUND, _FEWEST_AROUND = 32, 6
# A point is level where its plane slopes by less than this plus this number of its σ; a plateau where all of it does.
_LEVEL, _SIGMAS = np.tan(np.radians(2.0)), 2.0
_TILTED: Final = np.tan(np.radians(1.0))
# No more points than this are looked at.
_MOST: Final = 200_000
# Squares over which means are taken: about this number on a plateau, each at most this size, mm.
_SQUARES, _LARGEST_MM = 9, 5.0
_FEWEST_SQUARES: Final = 4
_CONFIDENCE: Final = 0.95


@dataclass(frozen=True)
class Plateau:
    """A level piece above the floor.

    Attributes:
        height_mm: the mean of its points above the floor.
        sigma_mm: standard error of that.
        interval_mm: half the width of the interval that holds 95 %.
        spread_mm: standard deviation of the points about their mean.
        points: how many, without those at the rim.
        area_mm2: of them.
        centre: of them, object frame, mm.
        tilt_deg: against the floor.
    """

    height_mm: float
    sigma_mm: float
    interval_mm: float
    spread_mm: float
    points: int
    area_mm2: float
    centre: Float[np.ndarray, "3"]
    tilt_deg: float


def plateaus(image: RangeImage, floor: Floor, least_mm2: float = 20.0) -> tuple[Plateau, ...]:
    """The plateaus of what stands on a floor, the largest first.

    Args:
        image: the range image, floor and all.
        floor: what heights are above.
        least_mm2: the area of the smallest.

    Raises:
        InputError: the area is not more than 0, or no point is above the floor as it was scanned.
    """
    if not least_mm2 > 0:
        raise InputError(f"plateaus of {least_mm2:g} mm²: give an area that is more than 0")
    height = floor.height(image.points)
    if not np.isfinite(height[image.valid]).any():
        raise InputError(
            "no point lies over the scan of the bare stage, so that no height is known: scan the stage where the "
            "object stands, in the same frame"
        )
    try:
        kept = stands_on(image, floor)
    except InputError:
        return ()
    how = sampling(image)
    every = max(1, -(-int(kept.sum()) // _MOST))
    thinned = np.zeros_like(kept)
    thinned[:, ::every] = True
    of = kept & thinned & np.isfinite(height)
    places = floor.frame.inverse().apply(image.points[of].astype(np.float64))
    z = height[of]
    across, along = _spacing(image, floor)
    spacing = max(across * every, along)
    reach = max(_REACH * spacing, _SMALLEST_MM)
    level, fitted = _level(places[:, :2], z, reach, max(how.noise_mm, floor.sigma_mm))
    label = _together(places[level, :2], fitted[level], 1.5 * spacing, how.noise_mm)
    areas = every * _areas(image, floor)[of][level]
    on_floor = _floor_means(image, floor, height, kept)
    cloud = image.points[of].astype(np.float64)[level]
    found = []
    for piece in np.flatnonzero(np.bincount(label, areas) >= least_mm2) if len(label) else ():
        of_piece = label == piece
        area = float(areas[of_piece].sum())
        plateau = _measured(places[level, :2][of_piece], z[level][of_piece], cloud[of_piece], area, spacing, on_floor)
        found += [plateau] if plateau else []
    return tuple(sorted(found, key=lambda one: -one.area_mm2))


def _spacing(image: RangeImage, floor: Floor) -> tuple[float, float]:
    """From one column, and one frame, to the next, as seen from above the floor, in the median, mm."""
    flat = [floor.frame.inverse().apply(sweep.closed().points)[..., :2] for sweep in image.sweeps()]
    apart = [[np.linalg.norm(np.diff(one, axis=axis), axis=-1).ravel() for one in flat] for axis in (1, 0)]
    across, along = (float(np.nanmedian(np.concatenate(each))) for each in apart)
    return across, along


def _areas(image: RangeImage, floor: Floor) -> Float[np.ndarray, "frames columns"]:
    """What each point stands for of the surface as seen from above the floor, mm².

    Of a scan along a line it is the same for all. A turn samples closely about its axis and widely far from it, and
    what several passages have shown is shared by their points.
    """
    across, along = _spacing(image, floor)
    areas = np.full(image.valid.shape, across * along)
    sweeps = image.sweeps()
    if len(sweeps) == 1 and image.full_turn is None:
        return areas
    own = np.concatenate([_own_areas(sweep, floor) for sweep in sweeps])
    areas = np.where(np.isfinite(own), own, areas)
    parts = passages(image)
    trees = [KDTree(image.points[part]) for part in parts]
    for part in parts:
        away = [tree.query(image.points[part])[0] for tree in trees]
        areas[part] /= (np.array(away) <= max(across, along)).sum(axis=0)
    return areas


def _own_areas(sweep: RangeImage, floor: Floor) -> Float[np.ndarray, "frames columns"]:
    """Area of each point's cell, as seen from above the floor, mm²; NaN where it has none."""
    flat = floor.frame.inverse().apply(sweep.points.astype(np.float64))[..., :2]
    down = _way_on(flat, len(sweep.gaps()))
    right = _way_on(flat.swapaxes(0, 1), flat.shape[1] - 1).swapaxes(0, 1)
    return np.abs(down[..., 0] * right[..., 1] - down[..., 1] * right[..., 0])


def _way_on(flat: Float[np.ndarray, "lines items 2"], gaps: int) -> Float[np.ndarray, "lines items 2"]:
    """From each place to the one in the next line, or where there is none from the one before; NaN without both."""
    after = np.full(flat.shape, np.nan)
    after[:gaps] = next_frame(flat, gaps) - flat[:gaps]
    return np.where(np.isfinite(after), after, np.roll(after, 1, axis=0))


def _level(
    places: Float[np.ndarray, "points 2"], z: Float[np.ndarray, "points"], reach: float, noise: float
) -> tuple[Bool[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """Which points' surroundings slope as little as a plateau's, and the heights of the planes there."""
    if len(places) < _FEWEST_AROUND:
        return np.zeros(len(places), bool), z
    away, index = KDTree(places).query(places, min(_AROUND, len(places)), distance_upper_bound=reach)
    there = np.isfinite(away)
    index = np.where(there, index, 0)
    # Nothing that rises by more than 45 degrees from here belongs to it.
    there &= np.abs(z[index] - z[:, None]) < np.maximum(away, 6 * noise)
    count = there.sum(axis=1)
    offset = np.where(there[..., None], places[index] - places[:, None], 0.0)
    A = np.concatenate([there[..., None].astype(float), offset], axis=2)
    values = np.where(there, z[index] - z[:, None], 0.0)
    N = np.einsum("nki,nkj->nij", A, A)
    # Points on one line have no slope across it.
    N_inverse = np.linalg.pinv(N, rcond=1e-6, hermitian=True)
    fit = np.einsum("nij,nkj,nk->ni", N_inverse, A, values)
    rest = ((values - np.einsum("nki,ni->nk", A, fit)) ** 2).sum(axis=1)
    sound = (count >= _FEWEST_AROUND) & (np.linalg.eigvalsh(N[:, 1:, 1:])[:, 0] > (0.1 * reach) ** 2)
    if not sound.any():
        return sound, z
    scatter = np.sqrt(np.median(rest[sound] / (count[sound] - 3)))
    slope = np.linalg.norm(fit[:, 1:], axis=1)
    sigma = scatter * np.sqrt(N_inverse[:, 1, 1] + N_inverse[:, 2, 2])
    return sound & (slope <= _LEVEL + _SIGMAS * sigma), z + fit[:, 0]


def _together(
    places: Float[np.ndarray, "points 2"], fitted: Float[np.ndarray, "points"], reach: float, noise: float
) -> Int[np.ndarray, "points"]:
    """A number for each point, the same where neighbours are equally high."""
    if not len(places):
        return np.zeros(0, int)
    a, b = KDTree(places).query_pairs(reach, output_type="ndarray").T
    same = np.abs(fitted[a] - fitted[b]) <= noise + _LEVEL * np.linalg.norm(places[a] - places[b], axis=1)
    graph = coo_array((np.ones(same.sum()), (a[same], b[same])), shape=(len(places), len(places)))
    return connected_components(graph, directed=False)[1]


def _measured(
    places: Float[np.ndarray, "points 2"],
    z: Float[np.ndarray, "points"],
    cloud: Float[np.ndarray, "points 3"],
    area: float,
    spacing: float,
    on_floor: tuple[Float[np.ndarray, "squares 3"], float],
) -> Plateau | None:
    """The plateau of these points, if they are one."""
    offset = places - places.mean(axis=0)
    A = np.column_stack([np.ones(len(z)), offset])
    slope = np.linalg.lstsq(A, z, rcond=None)[0][1:]
    size = float(np.clip(np.sqrt(area / _SQUARES), spacing, _LARGEST_MM))
    means = _means(places, z, size, 0.25)[:, 2]
    if np.linalg.norm(slope) > _TILTED or len(means) < _FEWEST_SQUARES:
        return None
    own = means.var(ddof=1) / len(means)
    sigma = float(np.sqrt(own + _under(places.mean(axis=0), on_floor)))
    interval = float(students_t.ppf((1 + _CONFIDENCE) / 2, len(means) - 1)) * sigma
    tilt = float(np.degrees(np.arctan(np.linalg.norm(slope))))
    return Plateau(float(z.mean()), sigma, interval, float(z.std()), len(z), area, cloud.mean(axis=0), tilt)


def _means(
    places: Float[np.ndarray, "points 2"], z: Float[np.ndarray, "points"], size: float, part: float
) -> Float[np.ndarray, "squares 3"]:
    """The mean place and value in each square of a size that has at least that part of the points of the fullest."""
    if not len(z):
        return np.zeros((0, 3))
    _, square, count = np.unique(np.floor(places / size), axis=0, return_inverse=True, return_counts=True)
    square = square.ravel()
    sums = np.stack([np.bincount(square, values) for values in (*places.T, z)], axis=1)
    full = count >= part * count.max()
    return (sums / count[:, None])[full]


def _floor_means(
    image: RangeImage, floor: Floor, height: Float[np.ndarray, "frames columns"], kept: np.ndarray
) -> tuple[Float[np.ndarray, "squares 3"], float]:
    """What is seen of the floor: means of squares of it, and their scatter about a plane."""
    with np.errstate(invalid="ignore"):
        on = image.valid & ~kept & (np.abs(height) <= floor.tolerance_mm)
    places = floor.frame.inverse().apply(image.points[on].astype(np.float64))
    squares = _means(places[:, :2], height[on], _LARGEST_MM, 0.25)
    if len(squares) < _FEWEST_SQUARES + 3:
        return squares, np.nan
    A = np.column_stack([np.ones(len(squares)), squares[:, :2]])
    rest = squares[:, 2] - A @ np.linalg.lstsq(A, squares[:, 2], rcond=None)[0]
    return squares, float((rest**2).sum() / (len(squares) - 3))


def _under(place: Float[np.ndarray, "2"], on_floor: tuple[Float[np.ndarray, "squares 3"], float]) -> float:
    """The variance of the floor's plane at a place; 0 where too little of the floor is seen."""
    squares, variance = on_floor
    if not np.isfinite(variance):
        return 0.0
    A = np.column_stack([np.ones(len(squares)), squares[:, :2] - place])
    return variance * float(np.linalg.pinv(A.T @ A)[0, 0])
