"""Sides of one object brought together: two at a time to begin with, then all of them in one adjustment.

In each round the points of every overlapping pair are matched again (`jaxscan.surface.pairs`), and the poses of all
sides but the first take the Gauss-Newton step of Σ w r² / σ², w Tukey's weights. Two sides alone are the same thing
with one pose. Since every pair that overlaps is in the one sum, a loop of scans closes.

The covariance counts every point's error once, however many residuals it is in: with g_k the sum of w ∂r/∂pose · (±1) /
σ_r² over the residuals of point k and H the normal matrix, it is H⁻¹ (Σ σ_k² g_k g_kᵀ) H⁻¹, times the variance of the
residuals in units of their σ where that is more than 1.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array

from jaxscan.errors import InputError, ObservabilityError
from jaxscan.geometry import Pose
from jaxscan.surface.pairs import Equations, Matches, equations, match
from jaxscan.surface.side import Side

# Rounds go on until the step left is negligible in units of the estimates' own σ, RMS; matches flip for ever.
_NEGLIGIBLE: Final = 0.02
# Matches that flip for ever move the poses in circles: they have settled when this number of rounds moves them by less.
_CIRCLE, _CIRCLE_NEGLIGIBLE = 10, 0.1
_ROUNDS: Final = 40
# In the end points are matched within this number of spacings.
_REACH: Final = 2.0
# Pairs with a smaller part in common, or fewer matches, do not count.
LEAST_OVERLAP, _FEWEST = 0.1, 60
# A motion along which points leave the surface by less than this part of their way is a sliding.
_SLIDING: Final = 0.04


class NotSettledWarning(UserWarning):
    """The rounds ran out before the poses came to rest."""


@dataclass(frozen=True)
class Pair:
    """Two sides that overlap, as they stand in the end.

    Attributes:
        first: number of the one side.
        second: of the other.
        matches: how many points belong together.
        overlap: the part of the points that do, of the side with the larger part.
        scale: scatter of the residuals in units of their σ, by the median.
        rms_mm: of the residuals, weighted.
        apart_mm: how far the two would move against each other, RMS over their matches, if there were no other sides.
    """

    first: int
    second: int
    matches: int
    overlap: float
    scale: float
    rms_mm: float
    apart_mm: float


@dataclass(frozen=True)
class Registration:
    """The poses of the sides.

    Attributes:
        poses: T_first_side of each; the first one's is the identity.
        centre: the middle of all points, in the first one's frame, mm: what rotations of the covariance are about.
        covariance: of the small motions (rotation vector in radians, translation of the centre in mm) of all sides but
            the first; NaN where the poses are as they were given.
        pairs: those that overlap.
        variance: mean square of the residuals in units of their σ; NaN where no sides overlap.
        rounds: how many it took; 0 where the poses are as they were given.
        left_in_sigma: the step of the last round in units of the estimates' own σ, RMS; where that was not negligible
            when the rounds ran out, what the last ten moved the poses by together.
        converged: whether that was negligible, and the reach of the matches had shrunk to what it should; if not, the
            covariance says too little.
    """

    poses: tuple[Pose, ...]
    centre: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "parameters parameters"]
    pairs: tuple[Pair, ...]
    variance: float
    rounds: int
    left_in_sigma: float
    converged: bool

    @property
    def closure_mm(self) -> float:
        """The furthest that two sides would move against each other if there were no others: loops close within it."""
        return max(pair.apart_mm for pair in self.pairs)

    def sigma(self, side: int) -> tuple[float, float]:
        """σ of a side's pose: of its rotation (radians) and of its centre (mm), the square root of the traces."""
        if side == 0:
            return 0.0, 0.0
        own = np.diag(self.covariance)[6 * (side - 1) : 6 * side]
        return float(np.sqrt(own[:3].sum())), float(np.sqrt(own[3:].sum()))


def register(
    sides: Sequence[Side],
    starts: Sequence[Pose],
    *,
    most: int = 4000,
    reach_mm: float | None = None,
    rounds: int = _ROUNDS,
) -> Registration:
    """Refine the poses of all sides together.

    Args:
        sides: two or more.
        starts: T_first_side of each; the first one's stays.
        most: points of each side that are looked up in each of the others.
        reach_mm: how far apart matched points may be to begin with; by default twice the spacing. It shrinks as the
            sides come together.
        rounds: the largest number of rounds; if they do not suffice there is a `NotSettledWarning`.

    Raises:
        InputError: sides do not overlap, named.
        ObservabilityError: sides slide on each other, named.
    """
    poses = list(starts)
    centre = np.mean([T.apply(side.points).mean(axis=0) for side, T in zip(sides, poses, strict=True)], axis=0)
    size = _size(sides, poses, centre)
    reach = {(a, b): reach_mm or 0.0 for a, b in combinations(range(len(sides)), 2)}
    linked: dict[tuple[int, int], tuple[Matches, Equations]] = {}
    H, left, steps, converged = np.zeros((0, 0)), np.inf, [], False
    shrinking = True
    while len(steps) < rounds and not converged:
        linked, shrinking = {}, False
        for a, b in reach:
            least = _REACH * max(sides[a].spacing_mm, sides[b].spacing_mm)
            found = match(sides[a], sides[b], poses[a], poses[b], max(reach[a, b], least), most)
            if found.overlap >= LEAST_OVERLAP and len(found) >= _FEWEST:
                linked[a, b] = found, (own := equations(sides[a], sides[b], poses[a], poses[b], found, centre))
                shrunk = min(reach[a, b], max(least, 6.0 * own.scale * float(np.median(own.sigma))))
                shrinking |= shrunk < 0.9 * reach[a, b]
                reach[a, b] = shrunk
        _connected(sides, list(linked))
        H, g = _normal(len(sides), {pair: own for pair, (_, own) in linked.items()})
        step = _step(sides, H, g, size)
        for k in range(1, len(sides)):
            turn, shift = step[6 * k - 6 : 6 * k - 3], step[6 * k - 3 : 6 * k]
            poses[k] = Pose.about(turn, centre, shift) @ poses[k]
        steps.append(step)
        left = _in_sigma(step, H)
        converged = left < _NEGLIGIBLE and not shrinking
    if not converged and len(steps) >= _CIRCLE:
        left = _in_sigma(np.sum(steps[-_CIRCLE:], axis=0), H)
        converged = left < _CIRCLE_NEGLIGIBLE and not shrinking
    found = _registration(sides, poses, centre, size, linked, H, (len(steps), left, converged))
    if not converged:
        warnings.warn(
            f"after {len(steps)} rounds the poses still moved, in the end by {left:.2g} of their σ: do not rely on "
            "them or their σ; start closer to the poses of the scans, or scan with more overlap",
            NotSettledWarning,
            stacklevel=2,
        )
    return found


def as_given(sides: Sequence[Side], poses: Sequence[Pose], *, most: int = 4000) -> Registration:
    """The sides where their poses say, and how they fit there: nothing is moved, so none slides, and none need overlap.

    What is off in the poses stays in the surface, and no residual says how much that is along a surface: their σ is not
    known.

    Args:
        sides: two or more.
        poses: T_first_side of each.
        most: points of each side that are looked up in each of the others.
    """
    centre = np.mean([T.apply(side.points).mean(axis=0) for side, T in zip(sides, poses, strict=True)], axis=0)
    size = _size(sides, list(poses), centre)
    linked: dict[tuple[int, int], tuple[Matches, Equations]] = {}
    for a, b in combinations(range(len(sides)), 2):
        reach = _REACH * max(sides[a].spacing_mm, sides[b].spacing_mm)
        found = match(sides[a], sides[b], poses[a], poses[b], reach, most)
        if found.overlap >= LEAST_OVERLAP and len(found) >= _FEWEST:
            linked[a, b] = found, equations(sides[a], sides[b], poses[a], poses[b], found, centre)
    pairs, variance = _pairs(sides, poses, centre, size, linked)
    unknown = np.full((6 * len(sides) - 6,) * 2, np.nan)
    return Registration(tuple(poses), centre, unknown, pairs, variance, 0, 0.0, True)


def moved_apart(side: Side, T: Pose, other: Pose) -> float:
    """How far the points of a side are apart in two of its poses, RMS, mm."""
    return float(np.sqrt(((T.apply(side.points) - other.apply(side.points)) ** 2).sum(axis=1).mean()))


def _in_sigma(step: np.ndarray, H: np.ndarray) -> float:
    """How large a step is in units of the estimates' own σ, RMS."""
    return float(np.sqrt(step @ H @ step / len(step)))


def _size(sides: Sequence[Side], poses: Sequence[Pose], centre: np.ndarray) -> float:
    """RMS distance of the points from their middle, mm."""
    squares = [((T.apply(side.points) - centre) ** 2).sum(axis=1) for side, T in zip(sides, poses, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def _normal(n: int, pairs: dict[tuple[int, int], Equations]) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and right-hand side of the poses of all sides but the first."""
    H, g = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    for (a, b), own in pairs.items():
        at = np.r_[6 * a : 6 * a + 6, 6 * b : 6 * b + 6]
        weighted = own.J * (own.weight / own.sigma**2)[:, None]
        H[np.ix_(at, at)] += own.J.T @ weighted
        g[at] -= weighted.T @ own.residual
    return H[6:, 6:], g[6:]


def _step(sides: Sequence[Side], H: np.ndarray, g: np.ndarray, size: float) -> np.ndarray:
    """The Gauss-Newton step.

    Raises:
        ObservabilityError: a motion of the sides hardly changes their distances.
    """
    # In units in which a rotation moves points as far as a translation does.
    unit = np.tile([1 / size] * 3 + [1.0] * 3, len(g) // 6)
    scaled = H * np.outer(unit, unit)
    own = [scaled[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(len(g) // 6)]
    sliding = [
        side.name
        for side, block in zip(sides[1:], own, strict=True)
        if np.linalg.eigvalsh(block)[0] < _SLIDING**2 * np.trace(block) / 6
    ]
    if sliding:
        raise ObservabilityError(
            f"{', '.join(sliding)}: slides on what it overlaps with, because a flat or round surface does not fix its "
            "pose: scan it from a side that shows more of its shape, or put something beside it; if its pose is "
            "known, as with two lasers of one rig or from a turntable's steps, --as-given keeps it there"
        )
    return unit * np.linalg.solve(scaled, unit * g)


def _connected(sides: Sequence[Side], pairs: list[tuple[int, int]]) -> None:
    """Refuse sides that are not all connected by overlap."""
    group = list(range(len(sides)))
    for a, b in pairs:
        group = [group[a] if k == group[b] else k for k in group]
    apart = [side.name for side, k in zip(sides, group, strict=True) if k != group[0]]
    if apart:
        raise InputError(
            f"{', '.join(apart)}: does not overlap with {sides[0].name} nor with what does: scan the sides in between"
        )


def _registration(
    sides: Sequence[Side],
    poses: list[Pose],
    centre: np.ndarray,
    size: float,
    linked: dict[tuple[int, int], tuple[Matches, Equations]],
    H: np.ndarray,
    how: tuple[int, float, bool],
) -> Registration:
    inverse_H = np.linalg.inv(H)
    # Of every point, the sum of its residuals' pulls.
    start = np.concatenate([[0], np.cumsum([len(side.points) for side in sides])])
    rows, parts = [], []
    for (a, b), (found, own) in linked.items():
        pull = own.J * (own.weight / own.sigma**2)[:, None]
        full = np.zeros((len(found), 6 * len(sides)))
        full[:, 6 * a : 6 * a + 6], full[:, 6 * b : 6 * b + 6] = pull[:, :6], pull[:, 6:]
        rows += [start[a] + found.first, start[b] + found.second]
        parts += [full, -full]
    at, pulls = np.concatenate(rows), np.concatenate(parts)[:, 6:]
    sums = coo_array((np.ones(len(at)), (at, np.arange(len(at)))), shape=(int(start[-1]), len(at))).tocsr() @ pulls
    scaled = sums * np.concatenate([side.sigma for side in sides])[:, None]
    pairs, variance = _pairs(sides, poses, centre, size, linked)
    covariance = max(variance, 1.0) * inverse_H @ (scaled.T @ scaled) @ inverse_H
    return Registration(tuple(poses), centre, covariance, pairs, variance, *how)


def _pairs(
    sides: Sequence[Side],
    poses: Sequence[Pose],
    centre: np.ndarray,
    size: float,
    linked: dict[tuple[int, int], tuple[Matches, Equations]],
) -> tuple[tuple[Pair, ...], float]:
    """Those that overlap, and the mean square of all residuals in units of their σ; NaN without any."""
    if not linked:
        return (), np.nan
    weights = np.concatenate([own.weight for _, own in linked.values()])
    squares = np.concatenate([(own.residual / own.sigma) ** 2 for _, own in linked.values()])
    pairs = tuple(
        Pair(
            first=a,
            second=b,
            matches=len(found),
            overlap=found.overlap,
            scale=own.scale,
            rms_mm=float(np.sqrt((own.weight * own.residual**2).sum() / own.weight.sum())),
            apart_mm=_apart(own, poses[a].apply(sides[a].points[found.first]) - centre, size),
        )
        for (a, b), (found, own) in linked.items()
    )
    return pairs, float((weights * squares).sum() / weights.sum())


def _apart(own: Equations, arms: Float[np.ndarray, "matches 3"], size: float) -> float:
    """How far one side's points move in the step that its residuals alone ask for; slidings are left out."""
    unit = np.array([1 / size] * 3 + [1.0] * 3)
    J = own.J[:, :6] * unit * (np.sqrt(own.weight) / own.sigma)[:, None]
    step = unit * np.linalg.lstsq(J, -own.residual * np.sqrt(own.weight) / own.sigma, rcond=_SLIDING)[0]
    return float(np.sqrt(((np.cross(step[:3], arms) + step[3:]) ** 2).sum(axis=1).mean()))
