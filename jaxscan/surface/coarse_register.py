"""Rough poses of sides: by the angles that the object was turned, or by features of its shape.

Sides are joined one after the other, nearest in the order of the scans first, until all are connected. Of each two
several starts are tried, followed with few points, and the best is judged by all: it counts where a tenth and more of
the points have a partner, and the scatter of their distances is that of their σ, a few times over.

Features are fast point feature histograms matched by KISS-Matcher (H. Lim et al., ICRA 2025; extra `features`).
"""

import warnings
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError, ObservabilityError
from jaxscan.extras import extra
from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.surface.register import NotSettledWarning, Pair, Registration, register
from jaxscan.surface.side import Side

# By how much an angle that the user gave may be wrong is tried in steps of this, degrees.
_OFFSETS_DEG: Final = (0.0, -8.0, 8.0)
_TRY_POINTS, _TRY_ROUNDS = 400, 12
# How far apart points are matched to begin with, in parts of the sides' size.
_REACH: Final = 0.15
# The scatter of distances in units of their σ beyond which two sides do not fit.
LARGEST_SCALE: Final = 5.0
# A loop of sides that does not close within this multiple of the poses' σ may have been turned the other way; it was
# where that brings this many times the matches, each over the scatter of its distances.
_LOOSE, _CLEARLY_MORE = 3.0, 1.3
# Features are searched in cubes of this number of spacings, but at least of this part of the sides' size.
_CUBES, _SMALLEST_CUBE = (1.0, 1.5), 0.015


def coarse_register(
    sides: Sequence[Side], degrees: Sequence[float] | None = None, known: Sequence[Pose] | None = None
) -> list[Pose]:
    """T_first_side of each side, from pairs.

    Args:
        sides: two or more.
        degrees: how far the object was turned at each scan, anticlockwise as seen from above its floor, or where no
            floor is known about any of the axes of its frame; without, it is found from features of the shapes.
        known: T_first_side, if known otherwise, e.g. from a turntable; replaces both.

    Raises:
        InputError: sides do not overlap, named; or there are no angles and the extra is not installed.
    """
    groups: list[dict[int, Pose]] = [{k: Pose.identity()} for k in range(len(sides))]
    sliding: list[ObservabilityError] = []
    for i, j in _in_order(len(sides), degrees):
        own = next(group for group in groups if i in group)
        if j in own:
            continue
        other = next(group for group in groups if j in group)
        try:
            found = _together(sides[i], sides[j], list(_starts(sides, i, j, degrees, known)))
        except ObservabilityError as error:
            sliding.append(error)
            continue
        if found is not None:
            T_own_other = own[i] @ found @ other[j].inverse()
            own |= {k: T_own_other @ T for k, T in other.items()}
            groups = [group for group in groups if group is not other]
    if len(groups) > 1:
        if sliding:
            raise sliding[0]
        first = next(group for group in groups if 0 in group)
        apart = [sides[k].name for k in range(len(sides)) if k not in first]
        raise InputError(
            f"{', '.join(apart)}: does not overlap with {', '.join(sides[k].name for k in sorted(first))}: scan the "
            "sides in between, or say how far the object was turned"
        )
    T_side_first = groups[0][0].inverse()
    return [T_side_first @ groups[0][k] for k in range(len(sides))]


def fits(pair: Pair) -> bool:
    """Whether two sides agree within their σ where they overlap."""
    return pair.scale <= LARGEST_SCALE


def check_fits(sides: Sequence[Side], registration: Registration) -> None:
    """Refuse sides that agree with none of those that they overlap with.

    Raises:
        InputError: there are such, named.
    """
    good = {k for pair in registration.pairs if fits(pair) for k in (pair.first, pair.second)}
    bad = [side.name for k, side in enumerate(sides) if k not in good]
    if bad:
        raise InputError(
            f"{', '.join(bad)}: does not fit the others, by more than {LARGEST_SCALE:g} σ in the median: is it of the "
            "same object, and did nothing move in it?"
        )


def check_turned(sides: Sequence[Side], degrees: Sequence[float], registration: Registration) -> None:
    """Refuse angles with the wrong sign: the sides fit better if the object was turned the other way.

    A square base alone fits at any quarter turn. Where a loop of sides closes within its σ, the sign is right.

    Raises:
        InputError: they have it.
    """
    sigma = max(registration.sigma(k)[1] for k in range(1, len(sides)))
    if all(d % 180 == 0 for d in degrees) or (len(sides) > 2 and registration.closure_mm <= _LOOSE * sigma):
        return
    other_way = [-d for d in degrees]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotSettledWarning)
            other = register(sides, coarse_register(sides, other_way))
    except InputError:
        return
    matches, more = (sum(pair.matches / max(pair.scale, 1.0) for pair in each.pairs) for each in (registration, other))
    if other.converged and more > _CLEARLY_MORE * matches and all(map(fits, other.pairs)):
        raise InputError(
            f"the scans fit better if the object was turned the other way: {more:.0f} points then lie on another scan, "
            f"and {matches:.0f} as it is given: give the angles the other sign; from above they are anticlockwise"
        )


def _in_order(count: int, degrees: Sequence[float] | None) -> list[tuple[int, int]]:
    """Pairs of sides, those first that were turned least against each other, or were scanned one after the other."""
    pairs = list(combinations(range(count), 2))
    if degrees is None:
        return sorted(pairs, key=lambda pair: min(pair[1] - pair[0], count - pair[1] + pair[0]))
    return sorted(pairs, key=lambda pair: abs((degrees[pair[1]] - degrees[pair[0]] + 180.0) % 360.0 - 180.0))


def _starts(
    sides: Sequence[Side], i: int, j: int, degrees: Sequence[float] | None, known: Sequence[Pose] | None
) -> Iterator[Pose]:
    """Guesses of T_i_j."""
    a, b = sides[i], sides[j]
    if known is not None:
        yield known[i].inverse() @ known[j]
    elif degrees is not None:
        if degrees[i] == degrees[j]:
            # Two lasers of one rig, or the same place again.
            yield Pose.identity()
        for up_a, up_b in _ups(a, b):
            for offset in _OFFSETS_DEG:
                yield _turned(a, b, up_a, up_b, degrees[j] - degrees[i] + offset)
    else:
        yield from _by_features(a, b)


def _ups(a: Side, b: Side) -> list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """Which way is up in a and in b: their floors' normals, or where there is none each axis of the frame.

    One scanner has scanned both from where it stands, so what is up in the one is in the other.
    """
    known = [side.floor.up for side in (a, b) if side.floor is not None]
    if known:
        return [(known[0], known[-1])]
    return [(up, up) for up in (*-np.eye(3), *np.eye(3))]


def _turned(a: Side, b: Side, up_a: Float[np.ndarray, "3"], up_b: Float[np.ndarray, "3"], degrees: float) -> Pose:
    """T_a_b where the object was turned about what is up between a and b, and stayed where it was."""
    upright = Rotation.align_vectors(up_a[None], up_b[None])[0].as_matrix()
    R = vector_to_matrix(-np.radians(degrees) * up_a) @ upright
    return Pose.from_matrix(R, a.points.mean(axis=0) - R @ b.points.mean(axis=0))


def _by_features(a: Side, b: Side) -> Iterator[Pose]:
    matcher = extra("features")
    size = float(np.linalg.norm(np.ptp(np.concatenate([a.points - a.points.mean(0), b.points - b.points.mean(0)]), 0)))
    for cubes in _CUBES:
        cube = cubes * max(a.spacing_mm, b.spacing_mm, _SMALLEST_CUBE * size)
        how = matcher.KISSMatcherConfig(voxel_size=cube, enable_noise_bound_clamping=False)
        found = matcher.KISSMatcher(how).estimate(list(b.points.astype(np.float32)), list(a.points.astype(np.float32)))
        if found.valid:
            R, t = (np.asarray(x, np.float64) for x in (found.rotation, found.translation))
            yield Pose.from_matrix(R, t.ravel())


def _together(a: Side, b: Side, starts: list[Pose]) -> Pose | None:
    """T_a_b from the best of its starts; None where none fits."""
    size = float(np.sqrt(((a.points - a.points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    # Where a trial has not come to rest the next step goes on from there.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotSettledWarning)
        return _best_of(a, b, starts, 2 * _REACH * size)


def _best_of(a: Side, b: Side, starts: list[Pose], reach_mm: float) -> Pose | None:
    best, score = None, 0.0
    sliding: ObservabilityError | None = None
    for start in starts:
        try:
            tried = register((a, b), (Pose.identity(), start), most=_TRY_POINTS, reach_mm=reach_mm, rounds=_TRY_ROUNDS)
        except ObservabilityError as error:
            sliding = error
            continue
        except InputError:
            continue
        pair = tried.pairs[0]
        if pair.overlap / max(pair.scale, 1.0) > score:
            best, score = tried.poses[1], pair.overlap / max(pair.scale, 1.0)
    if best is None and sliding is not None:
        raise sliding
    if best is None:
        return None
    try:
        found = register((a, b), (Pose.identity(), best))
    except ObservabilityError:
        raise
    except InputError:
        return None
    return found.poses[1] if fits(found.pairs[0]) else None
