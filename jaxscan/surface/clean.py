"""Points that are none of the surface: found by rules, left out, counted. Nothing is moved, nothing is smoothed.

- *Mixed*: where the stripe lies half on one surface and half on another, or half in a shadow, the centre of its light
  is beside both. Such a point borders on a depth edge or on a gap, and has clearly less light than the points around
  it. What borders on it when it is gone is looked at again.
- *Grazing*: seen at more than `grazing_deg` to the surface's normal: an error of a pixel is a large error in depth.
- *Isolated*: linked to fewer than `fewest` others, directly and through each other: glints, reflections, dust.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Int, UInt8
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxscan.errors import InputError
from jaxscan.reconstruction import RangeImage
from jaxscan.robust import NORMAL_MAD
from jaxscan.surface.links import Links, Sampling, links, next_frame, of_both_gaps, sampling
from jaxscan.surface.normals import incidence

RULES: Final = ("mixed", "grazing", "isolated")
# Frames and columns to either side whose median strength is that of the surroundings.
_FRAMES, _COLUMNS = 1, 2
_ROUNDS: Final = 8
# Limits of the part of the surrounding strength below which a point is mixed, and how many σ of the strength that is.
_WEAKEST, _SIGMAS = (0.5, 0.9), 3.0
_AT_ONCE: Final = 1 << 15


@dataclass(frozen=True)
class Cleaned:
    """A range image without the points that are none of the surface.

    Attributes:
        image: what is left.
        removed: 0 where a point stayed or there was none, else the number of the rule that took it, from 1, in `RULES`.
    """

    image: RangeImage
    removed: UInt8[np.ndarray, "frames columns"]

    def counts(self) -> dict[str, int]:
        """How many points each rule took."""
        return {rule: int((self.removed == number).sum()) for number, rule in enumerate(RULES, 1)}


def clean(
    image: RangeImage,
    how: Sampling | None = None,
    *,
    weakest: float | None = None,
    grazing_deg: float = 80.0,
    fewest: int = 12,
) -> Cleaned:
    """Leave out points that do not lie on the surface.

    Args:
        image: the range image.
        how: its spacing and noise; by default as `sampling` finds them.
        weakest: a bordering point with less than this part of the surrounding strength is mixed; 0 for none. By default
            1 − 3 times the relative scatter of the strength from column to column, from 0.5 to 0.9.
        grazing_deg: incidence beyond which a point is left out; 90 for none.
        fewest: least number of connected points; 0 for no limit.

    Raises:
        InputError: no point is left.
    """
    how = how or sampling(image)
    weakest = _weakest(image) if weakest is None else weakest
    removed = np.zeros(image.valid.shape, np.uint8)
    left, linked = image, links(image, how)

    def take(points: Bool[np.ndarray, "frames columns"], rule: str) -> None:
        nonlocal left, linked
        removed[points] = 1 + RULES.index(rule)
        left = left.where(~points)
        linked = links(left, how)

    for _ in range(_ROUNDS):
        mixed = _weak(image, left.valid & _borders(left, linked), weakest)
        if not mixed.any():
            break
        take(mixed, "mixed")
    with np.errstate(invalid="ignore"):
        take(left.valid & (incidence(left, linked) > np.radians(grazing_deg)), "grazing")
    take(left.valid & (_sizes(left, linked) < fewest), "isolated")
    if not left.valid.any():
        raise InputError(f"cleaning left none of {int(image.valid.sum())} points: use the points as they are")
    return Cleaned(left, removed)


def patches(image: RangeImage, linked: Links) -> Int[np.ndarray, "frames columns"]:
    """A number for each point, the same for all connected points; −1 where there is no point."""
    number = np.arange(image.valid.size).reshape(image.valid.shape)
    pairs = [
        np.stack([number[:, :-1][linked.across], number[:, 1:][linked.across]]),
        np.stack([number[: len(linked.along)][linked.along], next_frame(number, len(linked.along))[linked.along]]),
    ]
    i, j = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(i), bool), (i, j)), shape=(number.size, number.size))
    label = connected_components(graph, directed=False)[1].reshape(number.shape)
    return np.where(image.valid, label, -1)


def _weakest(image: RangeImage) -> float:
    """The part of its neighbours' strength that a point has all but always."""
    both = image.valid[:, 1:] & image.valid[:, :-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = image.strength[:, 1:][both] / image.strength[:, :-1][both]
    ratio = ratio[np.isfinite(ratio)]
    scatter = NORMAL_MAD * float(np.median(np.abs(ratio - 1))) / np.sqrt(2) if len(ratio) else 0.0
    return float(np.clip(1 - _SIGMAS * scatter, *_WEAKEST))


def _sizes(image: RangeImage, linked: Links) -> Int[np.ndarray, "frames columns"]:
    """How many points are connected with each."""
    label = patches(image, linked)
    return np.where(image.valid, np.bincount(label[image.valid], minlength=1)[label], 0)


def _borders(image: RangeImage, linked: Links) -> Bool[np.ndarray, "frames columns"]:
    """Points that lack a link to one of their four neighbours."""
    frames, columns = image.valid.shape
    count = of_both_gaps(linked.along.view(np.int8), frames)
    count += of_both_gaps(linked.across.view(np.int8).T, columns).T
    return count < 4


def _weak(
    image: RangeImage, candidates: Bool[np.ndarray, "frames columns"], weakest: float
) -> Bool[np.ndarray, "frames columns"]:
    """Candidates with less than this part of the median strength around them."""
    weak = np.zeros(candidates.shape, bool)
    places = np.argwhere(candidates)
    strength = np.where(image.valid, image.strength, np.nan)
    rows, columns = np.mgrid[-_FRAMES : _FRAMES + 1, -_COLUMNS : _COLUMNS + 1].reshape(2, -1)
    frames, last = len(strength), strength.shape[1] - 1
    closes = len(image.gaps()) == frames
    for start in range(0, len(places), _AT_ONCE):
        frame, column = places[start : start + _AT_ONCE].T
        row = frame[:, None] + rows
        row = row % frames if closes else np.clip(row, 0, frames - 1)
        near = strength[row, np.clip(column[:, None] + columns, 0, last)]
        weak[frame, column] = strength[frame, column] < weakest * np.nanmedian(near, axis=1)
    return weak
