"""How often a scan has shown the object: in each of its sweeps, and where it turns twice in each turn.

A circle about the axis meets a plane of light in two points. At the one what stands on the turntable enters the sheet's
far side, at the other it comes back: the two differ in the sign of g · v, with g the sheet's normal and v the velocity
of the point, and they are the two sides of the axis where the sheet holds it. So half a turn shows everything once, and
a full turn twice. Neighbours in the grid are of one passage, except across the line where g · v = 0, and from one sweep
to the next.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage

# A passage with fewer points than this is left with the others.
_FEWEST: Final = 100


def passages(image: RangeImage) -> tuple[Bool[np.ndarray, "frames columns"], ...]:
    """The points of each passage: masks that together hold every valid point once.

    Of a sweep there is one where the object did not turn, turned by no more than half a turn, or where the light is not
    known.
    """
    sweeps = image.sweeps()
    if len(sweeps) == 1:
        return _of_sweep(image)
    frames = np.cumsum([0, *(len(sweep.valid) for sweep in sweeps)])
    every = []
    for sweep, first in zip(sweeps, frames, strict=False):
        for part in _of_sweep(sweep):
            one = np.zeros_like(image.valid)
            one[first : first + len(part)] = part
            every.append(one)
    return _large(image, every)


def _of_sweep(image: RangeImage) -> tuple[Bool[np.ndarray, "frames columns"], ...]:
    whole = image.full_turn
    if whole is None or not image.sheets:
        return (image.valid,)
    gaps = image.gaps()
    way = np.abs(np.concatenate([[0], np.cumsum(gaps[: len(image.valid) - 1])]))
    if way.max() + np.abs(gaps).max() <= whole / 2:
        return (image.valid,)
    entering = _rate(image) > 0
    turn = way // whole
    return _large(
        image,
        [image.valid & (turn == n)[:, None] & which for n in np.unique(turn) for which in (entering, ~entering)],
    )


def _large(
    image: RangeImage, every: list[Bool[np.ndarray, "frames columns"]]
) -> tuple[Bool[np.ndarray, "frames columns"], ...]:
    """Without those of few points, which go with the largest."""
    every.sort(key=lambda one: -int(one.sum()))
    large = [one for one in every if one.sum() >= _FEWEST] or every[:1]
    large[0] = large[0] | (image.valid & ~np.any(large, axis=0))
    return tuple(large)


def _rate(image: RangeImage) -> Float[np.ndarray, "frames columns"]:
    """The rate g · v at each point, for each motor step of the leading axis; NaN where there is no point."""
    # How far each axis goes for a step of the leading one, full turns left out.
    step = float(np.median(image.gaps())) or 1.0
    rates = {axis: float(np.median(np.diff(image.positions[axis]))) / step for axis in image.moving}
    rates[image.leading] = 1.0

    def seen(by: float) -> Float[np.ndarray, "frames columns 3"]:
        q = {axis: np.asarray(steps) + by * rates.get(axis, 0.0) for axis, steps in image.positions.items()}
        return as_numpy(image.motion.pose(q)).apply(np.asarray(image.points, np.float64))

    before, after = seen(-1.0), seen(1.0)
    (sheet,) = image.sheets_in_frames()
    return (np.asarray(sheet.gradient(image.seen())) * (after - before)).sum(axis=-1) / 2
