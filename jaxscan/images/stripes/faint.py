"""A stripe in weak light: lines whose peak alone could be noise, but which continue those of other lines.

Of noise the greatest peak of each line lies anywhere. Where the peaks of neighbouring lines lie within a few pixels of
one another, over more lines than chance would ever join, there is a stripe, however faint. In the lines between, in
which noise outdid it, it is looked for again where the others say that it must be.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.images.stripes.runs import Points, linked
from jaxscan.images.stripes.validity import GAP

# Faint points follow one another closely: within so much, and no steeper.
_COMPANY_PX, _STEEPEST = 2.0, 1.0
# Chance joins a run of this length once in a million. A stripe is longer, and has at least this number of points.
_LN_CHANCE, _FEWEST = float(np.log(1e-6)), 16
# Chance joins a run of this length once in a thousand: it may be a stripe that is too weak.
_LN_TOO_WEAK: Final = float(np.log(1e-3))
# A run has points in this part of its lines.
_DENSE: Final = 0.4
# Between two points up to this number of lines apart the stripe is searched again, within this distance of the straight
# line.
_BETWEEN, _NEAR_PX = 12, 3.0


class Faint(NamedTuple):
    """What faint points of a frame make, for each of its lines.

    Attributes:
        runs: which have a point of the stripe.
        weak: which have something in company, and not enough of it.
        between: which have none and lie between two that do.
        rows: where the stripe must be there.
    """

    runs: Bool[np.ndarray, "lines"]
    weak: Bool[np.ndarray, "lines"]
    between: Bool[np.ndarray, "lines"]
    rows: Float[np.ndarray, "lines"]


def faint_runs(
    seen: Bool[np.ndarray, "lines"],
    at: Float[np.ndarray, "lines"],
    strength: Float[np.ndarray, "lines"],
    width: Float[np.ndarray, "lines"],
    rows: int,
    known: Bool[np.ndarray, "lines"],
    least_alone: float,
) -> Faint:
    """The runs that the points of a frame make.

    Args:
        seen: which lines have a point, however faint.
        at: where.
        strength: how bright.
        width: its full width at half height, px.
        rows: among how many a peak of noise may lie.
        known: which of them are a stripe's beyond doubt.
        least_alone: how bright the points of a run are in the mean that has no such point.
    """
    line = np.flatnonzero(seen)
    run = linked(Points(line, at[line], strength[line], width[line], width[line]), _COMPANY_PX, _STEEPEST)
    length = np.bincount(run)
    first, last = np.full(len(length), len(seen)), np.zeros(len(length), int)
    np.minimum.at(first, run, line)
    np.maximum.at(last, run, line)
    chance = sum(2 * (_COMPANY_PX + _STEEPEST * gap) + 1 for gap in range(1, GAP + 1)) / rows
    ln_chance = np.log(min(chance, 0.99))
    long = (length >= max(_FEWEST, _LN_CHANCE / ln_chance)) & (length > _DENSE * (last - first))
    company = length > 1 + _LN_TOO_WEAK / ln_chance
    of_known = np.bincount(run, known[line])
    goes_on = (of_known > 0) & (length - of_known >= _FEWEST)
    long &= goes_on | (np.bincount(run, strength[line]) >= least_alone * length)
    runs, weak = np.zeros_like(seen), np.zeros_like(seen)
    runs[line] = long[run]
    weak[line] = (company & ~long)[run]
    taken = np.flatnonzero(runs)
    between, rows_ = np.zeros_like(seen), np.full(len(seen), np.nan)
    if taken.size > 1:
        apart, step = np.diff(taken), np.abs(np.diff(at[taken]))
        near = (apart <= _BETWEEN) & (step <= _COMPANY_PX + _STEEPEST * apart)
        lines = np.arange(len(seen))
        before = np.searchsorted(taken, lines, "right") - 1
        inner = (before >= 0) & (before < len(near))
        between[inner] = near[before[inner]]
        between &= ~runs
        rows_[between] = np.interp(lines[between], taken, at[taken])
    return Faint(runs, weak, between, rows_)


def near_enough(at: Float[np.ndarray, "some"], rows: Float[np.ndarray, "some"]) -> Bool[np.ndarray, "some"]:
    """Whether what is found lies where it must."""
    return np.abs(at - rows) <= _NEAR_PX
