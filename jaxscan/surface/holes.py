"""Holes of a range image filled on request: the smoothest surface over them that meets their rims.

Over a hole each coordinate is harmonic on the grid: every missing point is the mean of its four neighbours (the
discrete Laplace equation), solved with the points around as they are. What was filled has no σ and no strength.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.sparse import csc_array
from scipy.sparse.linalg import spsolve

from jaxscan.errors import InputError
from jaxscan.reconstruction import RangeImage

_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))


def fill_holes(image: RangeImage, largest_mm: float) -> RangeImage:
    """Fill the holes that points enclose on all sides and whose rim is no larger than so much along any axis.

    Raises:
        InputError: the size is not positive.
    """
    if not largest_mm > 0:
        raise InputError(f"holes of up to {largest_mm:g} mm: give a size that is more than 0")
    if len(sweeps := image.sweeps()) > 1:
        return RangeImage.joined([fill_holes(sweep, largest_mm) for sweep in sweeps])
    # Where a turn closes, the frames stand there twice, so that what goes over its ends is in one piece in the middle.
    once, frames = image, len(image.valid)
    if len(image.gaps()) == frames:
        image = RangeImage.joined([image, image])
    label = np.zeros(image.valid.shape, np.int32)
    ndimage.label(~image.valid, output=label)
    fill = np.zeros(image.valid.shape, bool)
    for number, place in enumerate(ndimage.find_objects(label), 1):
        if any(s.start == 0 or s.stop == n for s, n in zip(place, label.shape, strict=True)):
            continue
        around = tuple(slice(s.start - 1, s.stop + 1) for s in place)
        hole = label[around] == number
        rim = image.points[around][ndimage.binary_dilation(hole) & ~hole]
        if np.ptp(rim, axis=0).max() <= largest_mm:
            fill[around] |= hole
    if not fill.any():
        return once
    filled = image.points.copy()
    filled[fill] = _harmonic(image.points, fill)
    points, valid = once.points.copy(), once.valid.copy()
    for start in range(0, len(fill), frames):
        here = fill[start : start + frames]
        points[here] = filled[start : start + frames][here]
        valid |= here
    return replace(once, points=points, valid=valid)


def _harmonic(points: np.ndarray, fill: np.ndarray) -> np.ndarray:
    """The missing points, in the order of `fill`."""
    number = np.full(fill.shape, -1)
    number[fill] = np.arange(fill.sum())
    frame, column = np.nonzero(fill)
    own = number[fill]
    rows, columns, values = [own], [own], [np.full(len(own), 4.0)]
    known = np.zeros((len(own), 3))
    for df, dc in _NEIGHBOURS:
        other = number[frame + df, column + dc]
        inner = other >= 0
        rows.append(own[inner])
        columns.append(other[inner])
        values.append(np.full(int(inner.sum()), -1.0))
        known[~inner] += points[frame + df, column + dc][~inner]
    laplace = csc_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))))
    return np.asarray(spsolve(laplace, known)).reshape(-1, 3)
