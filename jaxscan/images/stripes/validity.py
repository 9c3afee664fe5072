"""What is no stripe: round spots, what a lens or a JPEG adds beyond a stripe's end, whatever is thicker than long."""

from enum import IntEnum
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.images.stripes.bell import FWHM

# Points of a stripe follow one another within this number of lines, within this distance and slope, and with widths
# that agree within this factor.
GAP, COMPANY_PX, STEEPEST = 4, 2.0, 4.0
LN_WIDTHS: Final = float(np.log(2.5))
# Where colours have half the resolution, each block of 16 pixels may blur the stripe in its own way.
LN_WIDTHS_IN_BLOCKS: Final = float(np.log(4.0))
# It is longer than this multiple of its thickness, and longer than this number of lines.
_LONGER, _SHORTEST = 1.5, 2.5
# Fewer points make a line only where they stand out by so much more than noise does: where a texture leaks into the
# colour of the laser, noise has company.
_FEW, _CLEAR = 6, 1.5
# A lens's flare, and a JPEG's blocks of 16 pixels, echo the end of a bright stripe so faintly at the most, no further.
_ECHO, _ECHO_PX = 1 / 8, 16
# Where a surface ends the stripe is half as bright as further in, whatever blurs it: dimmer light is spilt beyond its
# end. It is compared with this number of lines further in, and at most this number are left out.
_SPILT, _FURTHER_IN, _MOST_SPILT = 0.5, 2, 3


class Verdict(IntEnum):
    """What was made of a line."""

    NOTHING = 0
    STRIPE = 1
    # Not where the sheet can be.
    OUTSIDE = 2
    # As bright as a stripe, and no line.
    SPOT = 3
    # A line, and beside it another is likelier to be the stripe.
    SECOND = 4
    # In company, but too weak to be distinguished from noise.
    WEAK = 5


def in_a_line(
    measured: Any,
    seen: Bool[np.ndarray, "frames lines"],
    least: Float[np.ndarray, "frames"],
    ln_widths: Float[np.ndarray, "frames"],
) -> tuple[Bool[np.ndarray, "frames lines"], Int[np.ndarray, "frames"]]:
    """Whether a point belongs to something longer than it is thick: a stripe is a line, noise and glints are not.

    Points are connected if they are no further apart than on the steepest possible stripe, over a few missing lines,
    and are about as wide.

    Args:
        measured: `Measured` of NumPy's arrays.
        seen: which lines have a point.
        least: by how much more than noise a point stands out at the least.
        ln_widths: by how much the logarithms of neighbours' widths may differ.

    Returns:
        Which points do, and how many such runs of points each frame has.
    """
    frames, lines = seen.shape
    place = np.flatnonzero(seen)
    if not place.size:
        return seen, np.zeros(frames, int)
    line = place % lines
    fields = measured.position, measured.strength, measured.width, measured.thickness
    at, weight, width, thickness = (np.asarray(x).ravel()[place] for x in fields)
    apart = np.diff(line)
    # The next frame's lines begin again.
    joined = (np.diff(place) <= GAP) & (apart > 0) & (np.abs(np.diff(at)) <= COMPANY_PX + STEEPEST * apart)
    joined &= _as_wide(np.log(width), ln_widths[place // lines])
    starts = np.concatenate([[0], 1 + np.flatnonzero(~joined)])
    weight = weight.astype(np.float64)
    length = np.diff(starts, append=place.size)
    clear = np.add.reduceat(weight, starts) > _CLEAR * length * least[place[starts] // lines]
    longer = longer_than_thick(line, weight, thickness, starts) & (clear | (length >= _FEW))
    ends = starts + length - 1
    kept = np.repeat(longer, length) & ~_spilt(weight, starts, ends) & ~_echoes(place, lines, at, weight, starts, ends)
    found = np.zeros_like(seen)
    found.flat[place] = kept
    return found, np.bincount(place[starts[longer]] // lines, minlength=frames)


def _as_wide(ln_width: Float[np.ndarray, "points"], most: Float[np.ndarray, "points"]) -> Bool[np.ndarray, "pairs"]:
    """Whether each point is about as wide as the next, or every second one is.

    Behind a mosaic of colour filters the lines that did not see the laser's colour are broad, those between narrow.
    """
    alike = np.abs(np.diff(ln_width)) <= most[1:]
    every_second = np.abs(ln_width[2:] - ln_width[:-2]) <= most[2:]
    alike[1:-1] |= every_second[1:] & every_second[:-1]
    return alike


def longer_than_thick(
    line: Int[np.ndarray, "points"],
    weight: Float[np.ndarray, "points"],
    thickness: Float[np.ndarray, "points"],
    starts: Int[np.ndarray, "runs"],
) -> Bool[np.ndarray, "runs"]:
    """Which runs are lines; `starts` says where in the points each begins.

    Along the lines the σ of a run, weighted by strength, is n / √12 of a stripe that is n lines long; of a round spot
    it is that of its profile across.
    """
    total, mean, square, thick = (
        np.add.reduceat(x, starts) for x in (weight, weight * line, weight * line**2, weight * (thickness / FWHM) ** 2)
    )
    along2 = square / total - (mean / total) ** 2
    # Any two points are in a line.
    length = np.diff(starts, append=len(line))
    return (along2 > np.maximum(_LONGER**2 * thick / total, _SHORTEST**2 / 12)) & (length > 2)


def _echoes(
    place: Int[np.ndarray, "points"],
    lines: int,
    at: Float[np.ndarray, "points"],
    strength: Float[np.ndarray, "points"],
    first: Int[np.ndarray, "runs"],
    last: Int[np.ndarray, "runs"],
) -> Bool[np.ndarray, "points"]:
    """Which points lie beyond the end of what is so much brighter, within a run or in a short one beside it."""
    echo = np.zeros(len(strength), bool)
    brightest = np.maximum.reduceat(strength, first)
    whole = np.zeros(len(first), bool)
    # Of a run and the one before it, either may echo the other.
    one, other = np.s_[1:], np.s_[:-1]
    for end, inwards in ((first, 1), (last, -1)):
        inner = np.clip(end + inwards * np.arange(_ECHO_PX + 1)[:, None], first, last)
        bright = strength[inner].max(axis=0)
        faint = np.logical_and.accumulate(strength[inner] < _ECHO * bright)
        echo[inner[faint]] = True
        # Towards the end of this run lies a run before it, or after it.
        mine, its = (one, other) if inwards > 0 else (other, one)
        beside = np.abs(place[end[mine]] - place[end[its]]) <= _ECHO_PX
        beside &= np.abs(at[end[mine]] - at[end[its]]) <= _ECHO_PX
        beside &= place[end[mine]] // lines == place[end[its]] // lines
        whole[its] |= beside & (brightest[its] < _ECHO * bright[mine])
    return echo | np.repeat(whole, last - first + 1)


def _spilt(
    strength: Float[np.ndarray, "points"], first: Int[np.ndarray, "runs"], last: Int[np.ndarray, "runs"]
) -> Bool[np.ndarray, "points"]:
    """Which points at the ends of runs are beyond the surface's: dimmer than half of what is seen further in."""
    spilt = np.zeros(len(strength), bool)
    for end, other, inwards in ((first, last, 1), (last, first, -1)):
        for _ in range(_MOST_SPILT):
            inner = np.clip(end + inwards * np.arange(1, _FURTHER_IN + 1)[:, None], 0, len(strength) - 1)
            dim = strength[end] < _SPILT * strength[inner].max(axis=0)
            dim &= (other - end) * inwards >= _FURTHER_IN
            spilt[end[dim]] = True
            end = end + inwards * dim
    return spilt
