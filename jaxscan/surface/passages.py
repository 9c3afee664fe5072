"""Where a turning object passed the light: once on the way in and once on the way out, in each turn.

A circle about the axis meets a plane of light in two points. At the one what stands on the turntable enters the sheet's
far side, at the other it comes back: the two differ in the sign of g · v, with g the sheet's normal and v the velocity
of the point, and they are the two sides of the axis where the sheet holds it. So half a turn shows everything once, and
a full turn twice. Neighbours in the grid are of one passage, except across the line where g · v = 0.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.reconstruction import RangeImage

# A passage with fewer points than this is left with the others.
_FEWEST: Final = 100


def passages(image: RangeImage) -> tuple[Bool[np.ndarray, "frames columns"], ...]:
    """The points of each passage: masks that together hold every valid point once.

    There is one where the object did not turn, turned by no more than half a turn, or where the light is not known.
    """
    whole = image.full_turn
    if whole is None or image.sheet is None:
        return (image.valid,)
    gaps = image.gaps()
    way = np.abs(np.concatenate([[0], np.cumsum(gaps[: len(image.valid) - 1])]))
    if way.max() + np.abs(gaps).max() <= whole / 2:
        return (image.valid,)
    entering = _rate(image) > 0
    turn = way // whole
    every = [image.valid & (turn == n)[:, None] & which for n in np.unique(turn) for which in (entering, ~entering)]
    every.sort(key=lambda one: -int(one.sum()))
    large = [one for one in every if one.sum() >= _FEWEST] or every[:1]
    large[0] = large[0] | (image.valid & ~np.any(large, axis=0))
    return tuple(large)


def _rate(image: RangeImage) -> Float[np.ndarray, "frames columns"]:
    """The rate g · v at each point, for each motor step of the axis that moves; NaN where there is no point."""
    (axis,) = image.moving
    before, after = (replace(image, positions={**image.positions, axis: image.steps + step}).seen() for step in (-1, 1))
    assert image.sheet is not None
    return (np.asarray(image.sheet.gradient(image.seen())) * (after - before)).sum(axis=-1) / 2
