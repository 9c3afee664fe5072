"""Which neighbours of a range image are neighbours on the surface, and which have a depth edge between them.

Along a line of the grid (a frame, or a column over the frames) let Δᵢ = Pᵢ₊₁ − Pᵢ. On a smooth surface Δ changes little
from one pair to the next, whatever the slope; at a depth edge it is like neither of its neighbours. So i and i + 1 are
linked where, for j = i − 1 or j = i + 1,

    |Δᵢ − Δⱼ| ≤ 3 √6 σ + |Δⱼ| / 3,     at most 3 √6 σ + one spacing,

√6 σ being the standard deviation of Pᵢ₊₁ − 2 Pᵢ + Pᵢ₋₁, and |Δⱼ| the spacing times the local slope. They are linked,
too, where the surface between them rises by no more than 45°, for that is as much as the sampling shows; and never
where it rises by more than `STEEPEST`. Frames of unequal steps are compared for equal steps.
"""

from contextlib import suppress
from dataclasses import astuple, dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Shaped

from jaxscan.axis_details import is_detail
from jaxscan.errors import InputError
from jaxscan.reconstruction import RangeImage
from jaxscan.robust import NORMAL_MAD

# The steepest rise of a surface over its own spacing that is not taken for a jump.
STEEPEST: Final = np.radians(80.0)
_SECOND_DIFFERENCE: Final = np.sqrt(6.0)
_SIGMAS: Final = 3.0
_CHANGE_OF_SLOPE: Final = 1 / 3
# Frames are not neighbours if their gap exceeds this multiple of the usual gap.
_LARGEST_GAP: Final = 2.5
# Frames that are linked at a time: they stay in the processor's cache.
_FRAMES_AT_ONCE: Final = 32
# Points that a median is taken of.
_SAMPLE: Final = 200_000


@dataclass(frozen=True)
class Sampling:
    """How densely and how well a range image samples its surface.

    Attributes:
        across_mm: from one column to the next, in the median.
        along_mm: from one frame to the next, in the median.
        noise_mm: σ of a point against its neighbours.
        step: motor steps from one frame to the next, in the median.
    """

    across_mm: float
    along_mm: float
    noise_mm: float
    step: float


@dataclass(frozen=True)
class Links:
    """Which neighbours are linked.

    Attributes:
        across: point (f, c) with (f, c + 1).
        along: point (f, c) with (f + 1, c), none from one sweep to the next; where a scan of one sweep is a turn that
            closes, the last frame's with the first's too.
    """

    across: Bool[np.ndarray, "frames columns-1"]
    along: Bool[np.ndarray, "gaps columns"]


def sampling(image: RangeImage) -> Sampling:
    """The spacing of a range image, and the noise of its points from the data themselves.

    σ is the median absolute second difference along the columns, scaled for a normal distribution; where the file knows
    a larger part of the pixel (`sigma_pixel`) it is that.

    Raises:
        InputError: there are no two frames, nothing moved between them, or there are no neighbours.
    """
    if len(image.steps) < 2:
        raise InputError("a surface takes at least two frames, and there is one: scan while an axis moves")
    if not image.moving:
        raise InputError(
            f"all {len(image.steps)} frames are of one place, {_place(image)}, so that none is beside another: give "
            "the motor steps of what moved between them in scan.toml, and reconstruct again"
        )
    if len(sweeps := image.sweeps()) > 1:
        return _of_sweeps(sweeps)
    # Every Nth frame with the one after it; there are as many columns as it takes. In a turn that closes these
    # are the same ones whichever frame comes first.
    gaps, frames = image.gaps(), len(image.steps)
    start = int(np.argmin(image.steps % image.full_turn)) if image.full_turn and len(gaps) == frames else 0
    some = (start + np.arange(0, len(gaps), max(1, image.valid.size // _SAMPLE))) % frames
    P, Q = (image.points[which].astype(np.float64) for which in (some, (some + 1) % frames))
    with np.errstate(invalid="ignore"):
        across, along = np.linalg.norm(P[:, 1:] - P[:, :-1], axis=2), np.linalg.norm(Q - P, axis=2)
        second = P[:, 2:] - 2 * P[:, 1:-1] + P[:, :-2]
    if not (np.isfinite(across).any() and np.isfinite(along).any()):
        raise InputError("no point has neighbours in its frame and in the next: check the scan's stripes and steps")
    across_mm, along_mm = float(np.nanmedian(across)), float(np.nanmedian(along))
    # The component in which the noise is: that in which second differences are largest.
    second = second[(np.abs(second) < 3 * across_mm).all(axis=2)]
    noise = 0.0
    if len(second) > 2:
        direction = np.linalg.svd(second, full_matrices=False)[2][0]
        noise = float(NORMAL_MAD * np.median(np.abs(second @ direction)) / _SECOND_DIFFERENCE)
    known = image.sigma_pixel[image.valid]
    if np.isfinite(known).any():
        noise = max(noise, float(np.nanmedian(known)))
    return Sampling(across_mm, along_mm, noise, float(np.median(np.abs(gaps))))


def _of_sweeps(sweeps: list[RangeImage]) -> Sampling:
    """The median of those that have frames and neighbours."""
    each = []
    for sweep in sweeps:
        with suppress(InputError):
            each.append(astuple(sampling(sweep)))
    if not each:
        raise InputError(
            "no point has neighbours in its frame and in the next: the axes that move change from frame to frame; "
            "scan in sweeps along which the same axes move"
        )
    return Sampling(*(float(x) for x in np.median(each, axis=0)))


def _place(image: RangeImage) -> str:
    at = {axis: int(np.asarray(steps)[0]) for axis, steps in image.positions.items() if not is_detail(axis)}
    return ", ".join(f"{axis} {step}" for axis, step in at.items())


def links(image: RangeImage, how: Sampling | None = None) -> Links:
    """Link the neighbours of a range image.

    Raises:
        InputError: as `sampling`.
    """
    how = how or sampling(image)
    if len(sweeps := image.sweeps()) > 1:
        return _joined([links(sweep, how) for sweep in sweeps])
    gap = image.gaps().astype(np.float32)
    # Its own: other sweeps may go along other axes.
    step = float(np.median(np.abs(gap))) if len(gap) else 0.0
    near = (gap != 0) & (np.abs(gap) <= _LARGEST_GAP * step)
    relative = np.where(near, gap / (step or 1.0), 1.0).astype(np.float32)
    frames, columns = image.valid.shape
    across, along = np.empty((frames, columns - 1), bool), np.empty((len(gap), columns), bool)
    for start in range(0, frames, _FRAMES_AT_ONCE):
        stop = min(start + _FRAMES_AT_ONCE, frames)
        # A pair of frames is compared with the pair before and the pair after.
        low, high = start - 1, stop + 2
        if len(gap) < frames:
            low, high = max(low, 0), min(high, frames)
        some = np.arange(low, high) % frames
        valid, own = image.valid[some], slice(start - low, stop - low)
        xyz = [np.ascontiguousarray(image.points[some, :, i]) for i in range(3)]
        with np.errstate(invalid="ignore"):
            pairs = valid[:, 1:] & valid[:, :-1]
            across[start:stop] = _along_axis(1, [x[own] for x in xyz], pairs[own], how, how.across_mm)
            pairs = valid[1:] & valid[:-1] & near[some[:-1], None]
            along[start:stop] = _along_axis(0, xyz, pairs, how, how.along_mm, relative[some[:-1]])[own]
    return Links(across, along)


def _joined(sweeps: list[Links]) -> Links:
    """The links of several sweeps, one behind the other; none is linked to another, or with its own beginning."""
    across = np.concatenate([linked.across for linked in sweeps])
    along = np.zeros((len(across), across.shape[1] + 1), bool)
    first = 0
    for linked in sweeps:
        frames = len(linked.across)
        along[first : first + frames - 1] = linked.along[: frames - 1]
        first += frames
    return Links(across, along[:-1])


def next_frame(values: Shaped[np.ndarray, "frames *each"], gaps: int) -> Shaped[np.ndarray, "gaps *each"]:
    """For each gap, what the frame behind it has; behind the last gap of a turn that closes that is the first frame."""
    return values[1:] if gaps < len(values) else np.roll(values, -1, axis=0)


def of_both_gaps(values: Shaped[np.ndarray, "gaps *each"], frames: int) -> Shaped[np.ndarray, "frames *each"]:
    """For each frame, the sum of what the gaps before and behind it have."""
    if len(values) == frames:
        return values + np.roll(values, 1, axis=0)
    total = np.zeros((frames, *values.shape[1:]), values.dtype)
    total[:-1] += values
    total[1:] += values
    return total


def _along_axis(
    axis: int,
    xyz: list[Float[np.ndarray, "frames columns"]],
    pairs: Bool[np.ndarray, "frames columns"],
    how: Sampling,
    spacing_mm: float,
    relative: Float[np.ndarray, "gaps"] | None = None,
) -> Bool[np.ndarray, "frames columns"]:
    """Links along one axis: `pairs` says where both points are, `relative` how far apart the frames are."""

    def after(x: np.ndarray) -> np.ndarray:
        return x[1:] if axis == 0 else x[:, 1:]

    def before(x: np.ndarray) -> np.ndarray:
        return x[:-1] if axis == 0 else x[:, :-1]

    spacing, tolerance = np.float32(spacing_mm), np.float32(_SIGMAS * _SECOND_DIFFERENCE * how.noise_mm)
    delta = [after(x) - before(x) for x in xyz]
    if relative is not None and not (relative == 1).all():
        delta = [d / relative[:, None] for d in delta]
    length2 = _sum_of_squares(delta)
    # Of each pair and the next one: the change of Δ, and the limits on it by the one and by the other.
    change = np.sqrt(_sum_of_squares([after(d) - before(d) for d in delta]))
    limit = tolerance + np.minimum(np.float32(_CHANGE_OF_SLOPE) * np.sqrt(length2), spacing)
    both = after(pairs) & before(pairs)
    linked = length2 <= 2 * spacing**2
    before(linked)[...] |= both & (change <= after(limit))
    after(linked)[...] |= both & (change <= before(limit))
    linked &= pairs
    linked &= length2 <= np.float32((spacing_mm / np.cos(STEEPEST)) ** 2)
    return linked


def _sum_of_squares(parts: list[Float[np.ndarray, "frames columns"]]) -> Float[np.ndarray, "frames columns"]:
    total = parts[0] * parts[0]
    for part in parts[1:]:
        total += part * part
    return total
