"""Two photographs between which the object moved on less than its steps say: an axis that stalled or slipped.

In each line the stripe goes on about as it did from the photograph before, and as it will to the one after. With
u₀ … u₃ its places in four photographs, and x₀ … x₃ the motor steps, the middle two should differ by

    s = ½ ((u₁ − u₀) / (x₁ − x₀) + (u₃ − u₂) / (x₃ − x₂)) (x₂ − x₁),

and differ by ρ s, ρ = (u₂ − u₁) / s in the weighted median of all lines. ρ is near 1: in 30 drawn scans of turntables
and stages it is 0.73 at the least where many lines agree, and 0.16 where a table lost five of six degrees. It grows
to 2.4 where a face is seen nearly along the sheet, so that what is above 1 shows nothing.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.phrases import first_few
from jaxscan.robust import NORMAL_MAD, weighted_median

# A line tells something where its stripe moves by this much from photograph to photograph, px, and by nearly as much
# before as after: half the difference of these is less than this part of their mean. The greatest weight of a line.
_MOVES_PX, _EVEN, _MOST = 1.2, 0.5, 50.0
# No line is known better than this, px.
_NOISE_PX: Final = 0.2
# At least 20 lines have to tell, and to agree on ρ; below 0.45 the object moved on too little.
_TELLING, _AGREE, _TOO_LITTLE = 20, 0.2, 0.45
# A scan with fewer such pairs, or whose ρ scatter more than this, shows nothing.
_PAIRS, _SCATTER = 6, 0.2
_NAMED: Final = 3


class _Pair(NamedTuple):
    """Two photographs: the number of the first, ρ, how many lines tell it, and how far they differ, robustly."""

    first: int
    moved: float
    telling: int
    spread: float


def stalled_notes(
    stripes: Float[np.ndarray, "frames lines"], steps: Float[np.ndarray, "frames"], axis: str, names: Sequence[str]
) -> list[str]:
    """What is said of photographs between which the axis seems to have stood still.

    Args:
        stripes: the position of each line's stripe, px; NaN where there is none; in the order of the steps.
        steps: of each photograph, motor steps, growing.
        axis: its name.
        names: of the photographs, in the same order.
    """
    fours = (slice(i - 1, i + 3) for i in range(1, len(steps) - 2) if (np.diff(steps[i - 1 : i + 3]) > 0).all())
    pairs = [pair for four in fours if (pair := _pair(four.start + 1, stripes[four], steps[four])) is not None]
    if len(pairs) < _PAIRS or np.median([abs(pair.moved - 1) for pair in pairs]) * NORMAL_MAD > _SCATTER:
        return []
    stalled = [pair for pair in pairs if pair.moved < _TOO_LITTLE and pair.spread < _AGREE]
    if not stalled:
        return []
    some = first_few(
        [f"{names[p.first]} and {names[p.first + 1]} ({max(p.moved, 0):.0%}, in {p.telling} lines)" for p in stalled],
        _NAMED,
    )
    return [
        f"between {some} the stripe moved on by that part of what it does between the photographs around them: the "
        f"{axis} stood still or lost steps there, or the object slipped, and what follows is off by as much: check how "
        "the object is held and how fast the motor is driven, and scan again"
    ]


def _pair(first: int, u: Float[np.ndarray, "4 lines"], x: Float[np.ndarray, "4"]) -> _Pair | None:
    """The middle two of four photographs; None where too few lines tell of them."""
    u = u[:, np.isfinite(u).all(axis=0)]
    before, moved, after = np.diff(u, axis=0) / np.diff(x)[:, None] * (x[2] - x[1])
    should, uneven = (before + after) / 2, np.abs(before - after) / 2
    tell = (np.abs(should) > _MOVES_PX) & (uneven < _EVEN * np.abs(should))
    if tell.sum() < _TELLING:
        return None
    each = moved[tell] / should[tell]
    weight = np.minimum(np.abs(should[tell]) / np.hypot(_NOISE_PX, uneven[tell]), _MOST)
    middle = weighted_median(each, weight)
    return _Pair(first, middle, int(tell.sum()), weighted_median(np.abs(each - middle), weight))
