"""Which of several bright lines in a photograph is the stripe.

All points of a frame that a stripe could have, several in a line where there are several, are linked into runs: points
of neighbouring lines that are each other's nearest, about as bright and about as wide. A run is taken or left as one:

- It is longer than it is thick, or it is no line.
- Where two runs share lines, the mean of the logarithms of their strengths over these lines decides, the frame's usual
  strength at most, for what is burnt out may be as bright as it likes; a run that is wider or narrower than the frame's
  usual stripe, or shorter than the other, loses by that.
- Of a stripe and its copy, moved or upside down, the brighter over the whole frame is taken everywhere.
- Where a surface turns away from the sheet or is half hidden a run fades: its end counts by itself.
- Runs that go on from one another straight are one course. What is beaten in more than half of its course's lines, and
  fainter there, is a ghost or a mirror image, and is none where it is alone either.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from jaxscan.images.stripes.validity import COMPANY_PX, GAP, LN_WIDTHS, STEEPEST, longer_than_thick

# A change of ln brightness by 1 counts as much as this number of lines between two points.
_BY_STRENGTH: Final = 0.5
# A run that is e times longer, and one as wide as usual where the other is off by e, have so much more of ln strength.
_BY_LENGTH, _BY_WIDTH = 0.2, 1.0
# A ghost is fainter than this part of its stripe, beside which it is over more than this part of its lines.
_FAINT, _BESIDE = 0.75, 0.5
# Copies lie at the same distance within so much, over this part of the lines that have points.
_SAME_PX, _COPIED = 3.0, 0.2
# A run is a copy if at least this number of its lines are copied, and more than this part of the lines that both share.
_FEWEST_COPIED, _MOSTLY_COPIED = 6, 0.4
# A stripe is no fainter than this part of its copy.
_SHOWN = 0.6
# A part of a run is separate if it is brighter or fainter than most by this factor, over half this number of lines.
_APART, _FEWEST_APART = 2.0, 7
# A course continues across up to this number of lines, from this number of points at a run's end, with this deviation
# for each line.
_ACROSS, _STRAIGHT, _BENDS = 48, 24, 0.1


# How far places stand out in their lines, by line and row.
Response = Callable[[Int[np.ndarray, "points"], Float[np.ndarray, "points"]], Num[np.ndarray, "points"]]


class Points(NamedTuple):
    """Points of one frame, several in a line, sorted by line.

    Attributes:
        line: of each point.
        at: its row (or column).
        strength: grey levels.
        width: of the profile, full at half height, px.
        thickness: the same, but for a burnt-out core, which counts.
    """

    line: Int[np.ndarray, "points"]
    at: Float[np.ndarray, "points"]
    strength: Float[np.ndarray, "points"]
    width: Float[np.ndarray, "points"]
    thickness: Float[np.ndarray, "points"]

    def of(self, which: np.ndarray) -> "Points":
        """Some of them."""
        return Points(*(x[which] for x in self))


def linked(
    points: Points, company_px: float = COMPANY_PX, steepest: float = STEEPEST, ln_widths: float = LN_WIDTHS
) -> Int[np.ndarray, "points"]:
    """The number of the run that each point belongs to."""
    line, at, count = points.line, points.at, len(points.line)
    ln_strength, ln_width = np.log(np.maximum(points.strength, 1e-3)), np.log(points.width)
    index = np.arange(count)
    reach = int((np.searchsorted(line, line + GAP, "right") - index).max(initial=1)) - 1
    after, before = np.full(count, -1), np.full(count, -1)
    least_after, least_before = np.full(count, np.inf), np.full(count, np.inf)
    for m in range(1, reach + 1):
        gap = line[m:] - line[:-m]
        most = company_px + steepest * gap
        off = np.abs(at[m:] - at[:-m])
        near = (gap > 0) & (gap <= GAP) & (off <= most) & (np.abs(ln_width[m:] - ln_width[:-m]) <= ln_widths)
        by = gap + off / company_px + _BY_STRENGTH * np.abs(ln_strength[m:] - ln_strength[:-m])
        for mine, its, best, least in (
            (np.s_[:-m], index[m:], after, least_after),
            (np.s_[m:], index[:-m], before, least_before),
        ):
            nearer = near & (by < least[mine])
            best[mine][nearer], least[mine][nearer] = its[nearer], by[nearer]
    mutual = (after >= 0) & (before[after] == index)
    first = index.copy()
    first[after[mutual]] = index[mutual]
    while (first[first] != first).any():
        first = first[first]
    return np.unique(first, return_inverse=True)[1]


def likeliest(
    points: Points, response: Response, ln_widths: float = LN_WIDTHS
) -> tuple[Bool[np.ndarray, "points"], Bool[np.ndarray, "points"]]:
    """Which points are of the stripe, one in a line at most; and which of the others lie in lines that are none.

    Args:
        points: what was measured.
        response: how far places stand out in their lines, measured or not, by line and row.
        ln_widths: by how much the logarithms of neighbours' widths may differ.
    """
    run = linked(points, ln_widths=ln_widths)
    order = np.lexsort((points.line, run))
    starts = np.searchsorted(run[order], np.arange(run.max(initial=-1) + 1))
    ordered = points.of(order)
    long = longer_than_thick(ordered.line, ordered.strength.astype(np.float64), ordered.thickness, starts)
    is_line = long[run]
    chosen = np.zeros(len(run), bool)
    if is_line.any():
        lines = points.of(is_line)
        chosen[is_line] = _winners(
            lines, _parts_apart(lines, np.unique(run[is_line], return_inverse=True)[1]), response
        )
    return chosen, is_line & ~chosen


def _parts_apart(points: Points, run: Int[np.ndarray, "points"]) -> Int[np.ndarray, "points"]:
    """The same runs, their parts that are twice as bright as most of them, or half as bright, as runs of their own.

    A run that has faded at its end is one such, and a stripe that goes on where a ghost ends is another.
    """
    # A command is slow to begin with it, and most scans need none.
    from scipy.ndimage import median_filter

    run, added = run.copy(), int(run.max()) + 1
    for mine in np.split(np.argsort(run, kind="stable"), np.cumsum(np.bincount(run))[:-1]):
        level = np.log(points.strength[mine])
        off = median_filter(level, _FEWEST_APART, mode="nearest") - np.median(level)
        kind = np.sign(off) * (np.abs(off) > np.log(_APART))
        for part in np.split(mine, 1 + np.flatnonzero(np.diff(kind)))[1:]:
            run[part] = added
            added += 1
    return run


def _winners(points: Points, run: Int[np.ndarray, "points"], response: Response) -> Bool[np.ndarray, "points"]:
    """Whether each point stays, of runs that are lines."""
    runs = int(run.max()) + 1
    length = np.bincount(run, minlength=runs)
    # The frame's usual stripe: half of all lines have something at least as strong.
    first = np.flatnonzero(np.diff(points.line, prepend=-1))
    usual_strength = np.median(np.maximum.reduceat(points.strength, first))
    ln_width = np.log(points.width)
    misfit = np.bincount(run, np.abs(ln_width - np.median(ln_width)), runs) / length
    merit = _BY_LENGTH * np.log(length) - _BY_WIDTH * misfit
    capped = np.log(np.minimum(points.strength, usual_strength))
    ln_strength = np.log(points.strength)
    one, other = _pairs(points.line)
    shared, ahead, brighter = (np.zeros((runs, runs)) for _ in range(3))
    of = run[one], run[other]
    np.add.at(shared, of, 1)
    by_capped, (by_copies, sources) = capped[one] - capped[other], _copies(points, one, other, ln_strength)
    np.add.at(ahead, of, np.where(by_copies == 0, by_capped, by_copies))
    np.add.at(brighter, of, ln_strength[one] - ln_strength[other])
    copied = np.zeros(runs)
    if sources:
        # What a copy is of shines where it must be, even where it could not be measured; here or there the copy may be
        # as bright.
        here = response(points.line, points.at)
        for rows in sources:
            copied += np.bincount(run, _SHOWN * here < response(points.line, rows), runs)
    shared, ahead, brighter = shared + shared.T, ahead - ahead.T, brighter - brighter.T
    lead = ahead / np.maximum(shared, 1) + merit[:, None] - merit[None]
    beaten = (shared > 0) & (lead < 0)
    course = _courses(points, run, runs)
    lost, by = (np.bincount(course, np.where(beaten, x, 0.0).sum(axis=1), runs) for x in (shared, brighter))
    ghost = (lost > _BESIDE * np.bincount(course, length, runs)) & (by < np.log(_FAINT) * lost)
    # A copy that is shown by the whole frame need not be seen beside its stripe for long.
    mostly = (copied >= _FEWEST_COPIED) & (copied > _MOSTLY_COPIED * shared.sum(axis=1))
    ghost[course[mostly | (copied > _COPIED * length)]] = True
    # What is clearly the brighter one where it is not alone is no part of a ghost's course.
    clear = (brighter.sum(axis=1) > -np.log(_FAINT) * shared.sum(axis=1)) & (shared.sum(axis=1) > 0)
    standing = ~(ghost[course] & ~clear)[run]
    lost_points = np.zeros(len(run), bool)
    for a, b in ((one, other), (other, one)):
        lost_points[a[beaten[run[a], run[b]] & standing[b]]] = True
    return standing & ~lost_points


def _copies(
    points: Points, one: Int[np.ndarray, "pairs"], other: Int[np.ndarray, "pairs"], ln_strength: np.ndarray
) -> tuple[Float[np.ndarray, "pairs"], list[Float[np.ndarray, "points"]]]:
    """How much brighter the first of each pair is over the whole frame, of a stripe and its copy; 0 of other pairs.

    A copy is the stripe once more, moved or upside down: the difference of their places, or the sum, is the same
    wherever both are seen. Step by step of reflectance either may be the brighter.

    Returns:
        That, and for each kind of copy that the frame shows the row of what each point would be a copy of; NaN of what
        can be none.
    """
    upper = np.where(points.at[one] < points.at[other], 1.0, -1.0)
    by = upper * (ln_strength[one] - ln_strength[other])
    found, sources = np.zeros(len(one)), []
    apart, total = np.abs(points.at[one] - points.at[other]), points.at[one] + points.at[other]
    for between in (total, apart):
        place = np.floor(between / _SAME_PX).astype(int)
        count = np.bincount(place, minlength=3)
        # The three neighbouring places that hold most.
        middle = int((count[:-2] + count[1:-1] + count[2:]).argmax()) + 1
        same = np.abs(place - middle) <= 1
        if same.sum() > _COPIED * np.unique(points.line).size:
            found = np.where(same, upper * by[same].mean(), found)
            usual, down = np.median(between[same]), np.sign(by[same].mean())
            # The upper one is the brighter of each two, or it is the lower one.
            upside_down = np.where(down * (2 * points.at - usual) > 0, usual - points.at, np.nan)
            sources.append(upside_down if between is total else points.at - down * usual)
    return found, sources


def _courses(points: Points, run: Int[np.ndarray, "points"], runs: int) -> Int[np.ndarray, "runs"]:
    """The number of the course that each run is on: runs that go on from one another straight across a gap."""
    order = np.lexsort((points.line, run))
    bounds = np.searchsorted(run[order], np.arange(runs + 1))
    ends = np.empty((2, runs, 3))
    for i in range(runs):
        mine = order[bounds[i] : bounds[i + 1]]
        for end, outermost, some in zip(ends, (0, -1), (mine[:_STRAIGHT], mine[-_STRAIGHT:]), strict=True):
            line, at = points.line[some].astype(float), points.at[some]
            off = line - line.mean()
            slope = (off * at).sum() / max((off**2).sum(), 1.0)
            here = line[outermost]
            end[i] = here, at.mean() + slope * (here - line.mean()), slope
    (first, begin, rise), (last, finish, fall) = (x.T for x in ends)
    gap = first[None] - last[:, None]
    ahead, back = (np.abs(begin[None] - finish[:, None] - slope * gap) for slope in (fall[:, None], rise[None]))
    off = np.maximum(ahead, back)
    near = (gap > 0) & (gap <= _ACROSS) & (off <= COMPANY_PX + _BENDS * gap)
    cost = np.where(near, off + gap / _ACROSS, np.inf)
    course = np.arange(runs)
    after, before = cost.argmin(axis=1), cost.argmin(axis=0)
    for i in np.argsort(first):
        earlier = before[i]
        if np.isfinite(cost[earlier, i]) and after[earlier] == i:
            course[i] = course[earlier]
    return course


def _pairs(line: Int[np.ndarray, "points"]) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Every two points of a line."""
    found = [np.empty((2, 0), int)]
    m = 1
    while (same := np.flatnonzero(line[m:] == line[:-m])).size:
        found.append(np.stack([same, same + m]))
        m += 1
    one, other = np.concatenate(found, axis=1)
    return one, other
