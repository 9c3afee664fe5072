"""Whether a turn closes: its last photographs show the stripe where its first ones say.

A table that turns by another angle than the rig says, steps that were lost, and an object that was pushed leave each
photograph as good as any, and make a surface of two passages that do not fit. Near the first photographs each line's
stripe goes on about straight, u(x) = u₀ + s x at x motor steps from the first. A photograph from just before a full
turn lies where that fits it best in all lines,

    x̂ = Σ w s (u − u₀) / Σ w s²,

and differs from where it should be by as much as the turn is off. How well photographs near the first ones are placed
by those beside them, in the same way, says what that means.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.robust import NORMAL_MAD, weighted_median

# Photographs that predict. Others are placed by them that are this number of steps before them, and the last ones of a
# turn that are no further away than the second.
_PREDICT, _BEFORE, _FURTHEST = 5, 3, 3.5
# Lines that both must have; how many of the first photographs are placed by those beside them.
_LINES, _TRIED = 16, 12
# Rounds of the weights; no line is known better than this, px. What is off by two such parts counts for half.
_ROUNDS, _LEAST_PX, _HALF = 5, 0.05, 2.0
# A turn does not close if it misses by this part of a step, and by this multiple of what placing is off by.
_MISSES, _SURE = 0.5, 4.0
# Where that multiple is more than this part of a full turn, nothing can be said.
_UNKNOWN = 1 / 18


class Closing(NamedTuple):
    """How far the last photographs of a turn are from where the first ones say, σ of that, and a step; motor steps."""

    misses: float
    sigma: float
    step: float


def closing(
    stripes: Float[np.ndarray, "frames lines"], steps: Float[np.ndarray, "frames"], turn: int
) -> Closing | None:
    """How a turn closes; None where too few photographs show it.

    Args:
        stripes: the position of each line's stripe, px; NaN where there is none; in the order of the steps.
        steps: of each photograph, motor steps, growing.
        turn: of a full turn, motor steps.
    """
    if len(steps) < _PREDICT + _TRIED:
        return None
    step = float(np.median(np.diff(steps)))
    should = steps - turn - steps[0]
    last = np.flatnonzero((should >= -_FURTHEST * step) & (should <= step))
    off = [
        x - should[j]
        for j in last[last >= _PREDICT]
        if (x := _placed(stripes[:_PREDICT], steps[:_PREDICT], stripes[j])) is not None
    ]
    near = [
        x - (steps[i - before] - steps[i])
        for i in range(_BEFORE, _TRIED)
        for before in range(1, _BEFORE + 1)
        if (x := _placed(stripes[i : i + _PREDICT], steps[i : i + _PREDICT], stripes[i - before])) is not None
    ]
    if len(off) < 2 or len(near) < _TRIED:
        return None
    return Closing(float(np.median(off)), NORMAL_MAD * float(np.median(np.abs(near))), step)


def closing_notes(
    stripes: Float[np.ndarray, "frames lines"], steps: Float[np.ndarray, "frames"], turn: int, axis: str
) -> list[str]:
    """What is said of a turn that does not close, or of which that cannot be known.

    The arguments are those of `closing`, and the axis's name.
    """
    found = closing(stripes, steps, turn)
    if found is None:
        return []
    surely = _SURE * found.sigma
    if surely > _UNKNOWN * turn:
        return [
            "whether the turn closes could not be checked: near its first photograph the stripe hardly changes with "
            f"the turn, so that lost steps, or an object that moved, would show from {surely / turn * 360:.0f}° on: "
            "begin the scan where the stripe runs over the sides of the object, or photograph in smaller steps"
        ]
    if abs(found.misses) < max(_MISSES * found.step, surely):
        return []
    return [
        f"the turn does not close: after {turn} motor steps the stripe is {abs(found.misses):.0f} of them "
        f"({abs(found.misses) / turn * 360:.1f}°) from where it was, as if a turn had {turn - found.misses:.0f}: check "
        f"the steps of {axis} in scan.toml, whether steps were lost, and whether the object moved on the table"
    ]


def _placed(
    near: Float[np.ndarray, "some lines"], steps: Float[np.ndarray, "some"], stripe: Float[np.ndarray, "lines"]
) -> float | None:
    """x̂ of a stripe, motor steps from the first of the photographs that it is placed by; None where lines are few."""
    both = np.isfinite(near).all(axis=0) & np.isfinite(stripe)
    if both.sum() < _LINES:
        return None
    about = np.stack([np.ones(len(steps)), steps - steps[0]], axis=1)
    u = near[:, both].astype(float)
    line, *_ = np.linalg.lstsq(about, u, rcond=None)
    # A line that is not straight predicts little.
    bends = ((u - about @ line) ** 2).sum(axis=0) / (len(steps) - 2)
    slope, off = line[1], stripe[both] - line[0]
    tells = np.abs(slope) / np.sqrt(1 + bends)
    if not tells.any():
        return None
    # The least sum of |off − slope x|: lines on a bare table, which tell nothing of the turn, do not count in it.
    x = weighted_median(off / np.where(slope == 0, 1, slope), tells)
    for _ in range(_ROUNDS):
        left = off - slope * x
        usual = max(NORMAL_MAD * weighted_median(np.abs(left), tells), _LEAST_PX)
        weight = 1 / ((1 + bends) * (1 + (left / (_HALF * usual)) ** 2))
        total = float((weight * slope**2).sum())
        if total <= 0:
            return None
        x += float((weight * slope * left).sum()) / total
    return x
