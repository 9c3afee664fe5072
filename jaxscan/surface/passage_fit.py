"""Whether the two passages of a turn fit better if the table turned the other way.

A table that turns against what the rig says makes of each photograph the same profile, carried to the wrong side. Where
the sheet does not hold the axis, the two passages over a place then lie apart, and meet once each profile is carried
back twice. If the sheet holds the axis the wrong direction makes the mirror image, whose passages fit as well:
nothing shows it.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage

# Points of one passage that are looked for, and of the other among which they are.
_POINTS, _AMONG = 4000, 100_000
# The part of them that must be seen by both; others are as far away as they are.
_SHARED: Final = 0.4
# Neighbours that make a plane; a point is beside them further than this many times their own scatter.
_NEIGHBOURS, _BESIDE = 8, 3.0
# The other way fits better if the passages are this number of times nearer.
_NEARER: Final = 2.0


class PassageFit(NamedTuple):
    """How far the points of one passage are from the other one, mm: as the axis was said to turn, and if it did not."""

    as_said: float
    other_way: float

    @property
    def turned_the_other_way(self) -> bool:
        """Whether they fit clearly better so."""
        return self.other_way * _NEARER < self.as_said


def passage_fit(image: RangeImage, masks: Sequence[Bool[np.ndarray, "frames columns"]]) -> PassageFit | None:
    """How well the two largest passages of a turn fit, both ways; None where there are no two of one axis.

    Args:
        image: the range image.
        masks: its passages (`passages`), the largest first.
    """
    if len(masks) < 2 or len(image.moving) != 1 or not image.full_turn:
        return None
    steps = {axis: np.asarray(at, float) for axis, at in image.positions.items()}
    steps[image.leading] = -steps[image.leading]
    back = as_numpy(image.motion.pose(steps)).inverse()
    return PassageFit(_apart(np.asarray(image.points, float), masks), _apart(back.apply(image.seen()), masks))


def _apart(points: Float[np.ndarray, "frames columns 3"], masks: Sequence[Bool[np.ndarray, "frames columns"]]) -> float:
    """How far the points of one passage are from the other one's surface, mm, at the quantile that both must see.

    The surface at a point is the plane through its neighbours; beside what they span a point is as far as they are.
    """
    some, among = (points[mask] for mask in masks[:2])
    some, among = some[:: max(1, len(some) // _POINTS)], among[:: max(1, len(among) // _AMONG)]
    away, which = KDTree(among).query(some, k=_NEIGHBOURS)
    near = among[which]
    middle = near.mean(axis=1)
    near = near - middle[:, None]
    spread, normals = np.linalg.eigh(near.swapaxes(1, 2) @ near)
    off = some - middle
    along = np.abs((off * normals[:, :, 0]).sum(axis=-1))
    beside = (off**2).sum(axis=-1) > _BESIDE**2 * spread[:, 2] / _NEIGHBOURS
    return float(np.quantile(np.where(beside, away[:, 0], along), _SHARED))
