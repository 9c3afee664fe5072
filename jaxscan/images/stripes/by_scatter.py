"""σ of a stripe by how much its centres scatter along it.

With c_x the centre in line x, on a smooth surface

    c_x − 3 c_(x+k) + 3 c_(x+2k) − c_(x+3k)

is error alone: of variance σ_x² + 9 σ_(x+k)² + 9 σ_(x+2k)² + σ_(x+3k)². That is all errors together, whatever their
causes are. In photographs that a program has worked on, no other σ is right. What a JPEG leaves in the blocks of 8 x 8
pixels that a stripe crosses is alike over the columns of one block, so that neither a line's own pixels nor its
neighbours show it, and it hides speckle; k ≥ 8 is from block to block. What depends on the place in a pixel is alike in
lines that the stripe passes at the same place; it shows over distances along which the stripe moves.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.ranks import ranked

# How far lines are apart whose third differences are taken: in different blocks of a JPEG; where there are none.
IN_BLOCKS: Final = (8, 12)
ALONE: Final = (2, 3, 5, *IN_BLOCKS, 20, 30, 45)
# Over a distance along which half of the lines differ by this, the place in a pixel changes, px: σ is read over the
# shortest of these.
_MOVES_PX, _SHORTEST = 0.35, 2
_THIRD: Final = (1, -3, 3, -1)
# At a step between two neighbouring lines another surface begins, px.
_STEP_PX: Final = 1.0
# The scatter is read at this quantile: of a normal number it is this number of σ. What is more than this number of σ
# away is no error but an edge of the surface; it is first estimated from the median, for which it is this number, and
# then this number of times.
_USUAL, _USUAL_OVER_SIGMA, _FAR, _MEDIAN_OVER_SIGMA, _LOOKS = 0.8, 1.2816, 4.0, 0.6745, 4
# σ of a line goes with this power of σ of independent pixels: 1/2 on twelve scans of a cup, 0.5 to 1.4 in drawn JPEGs
# whose stripe is dim in part. The usual power, how far a frame's is from it, and the largest.
_USUAL_POWER, _OFF_BY_POWER, _MOST_POWER = 0.5, 0.5, 2.0
# The standard deviation of the logarithm of a normal number, if this part of the usual stands for all smaller ones; and
# the number of third differences that say what one does, because lines of one block are alike.
_SCATTER_OF_LN, _SMALL, _ALIKE = 1.1, 0.02, 8
# As few differences as this say nothing: from block to block, and over distances along which the stripe moves. More
# scatter than speckle of contrast 0.7 makes, this times √σ of the stripe in px, is the surface's own.
_FEWEST, _FEWEST_MOVING, _MOST = 100, 60, 0.3
# Where σ is not read, that of smoothed windows is larger by this factor than that of independent pixels: the usual one
# of drawn stripes and photographs of a cup, with speckle and without (1 to 3).
_USUAL_FACTOR = 1.8
# The middle two of four lines hold nine tenths of a third difference's variance: where both are burnt out, it is.
_BURNT: Final = 2
# How far a frame's σ is off that its pixels show, relative to it; n lines show their scatter to √(2 / n). More than
# `_MOST_OFF` between the two, in their logarithms, is the surface's own.
_OFF_BY_PIXELS, _MOST_OFF = 0.12, 0.35
# How far lines are apart that show it: near ones, unless grains of speckle go on from one to the next.
_NEAR, _BEYOND_GRAINS = (1, 2, 3), (5, 8)
# A stripe is level if lines so far apart are less than this apart, px: its blocks have the same error.
_LEVEL_BY, _LEVEL_PX = 40, 0.4

Lines = Float[np.ndarray, "frames lines"]


def sigma_by_scatter(
    sigma: Lines,
    position: Lines,
    width: Lines,
    burnt: Bool[np.ndarray, "frames lines"],
    smooth: Bool[np.ndarray, "frames"],
    least_apart: int = IN_BLOCKS[0],
    moving: bool = False,
    most: Float[np.ndarray, "frames"] | float = np.inf,
) -> Lines:
    """σ of lines in photographs whose pixels do not show it, of each frame from how much its lines differ.

    Which of a frame's lines are better, σ of independent pixels says: by half, as is usual, or by as much as the
    frame's lines show (`_power`). Burnt-out lines and others, which are measured in different ways, have a scatter of
    their own where there are enough of them.
    A level stripe has the same error in all blocks, so that there σ is no less than that of independent pixels.

    Args:
        sigma: of each line's centre, of independent pixels, px; NaN where there is none.
        position: the centre, px.
        width: of the stripe, full at half height, px.
        burnt: whether some pixel near the line's stripe is full.
        smooth: in which frames windows were smoothed.
        least_apart: how far lines are apart of which differences are taken, at the least.
        moving: whether they are taken over the shortest distances along which the stripe moves, because an error that
            changes with the place in a pixel shows over no others.
        most: by which factor σ can be too small in each frame: more is the surface's own.
    """
    known = np.isfinite(sigma) & np.isfinite(position)
    usual = ranked(sigma, known, 0.5)[:, None]
    position = np.where(known, position, np.float32(0))
    # Without any noise all lines are alike.
    ln = np.log(np.where(known & (sigma > 0) & (usual > 0), sigma, 1) / np.where(known & (usual > 0), usual, 1))
    # σ of a few burnt-out lines among others is without the speckle that a JPEG hides.
    some = (2 * (burnt & known).sum(axis=1) < known.sum(axis=1))[:, None]
    ln = np.where(burnt & some, np.maximum(ln, 0), ln)
    steps = surfaces(position, known)
    otherwise = np.where(smooth[:, None], np.float32(_USUAL_FACTOR), np.float32(1)) * sigma
    apart = [k for k in (ALONE if moving else IN_BLOCKS) if least_apart <= k < sigma.shape[1] / 3]
    if not apart:
        return otherwise
    of_one = [of_one_surface(steps, k) for k in apart]
    used = np.concatenate(_of_moving(of_one, position, apart) if moving else of_one, axis=1)
    # How many of the middle two lines are burnt out, and the mean of their logarithms.
    kind, middle = (np.concatenate([_in_the_middle(x, k) for k in apart], axis=1) for x in (burnt.astype(int), ln / 2))

    def differences(shape: Lines) -> Float[np.ndarray, "frames some"]:
        return np.concatenate([third_differences(position, shape, k) for k in apart], axis=1)

    shape = np.exp(_power(differences(np.ones_like(ln)), used, kind, middle)[:, None] * ln)
    values = differences(shape)
    fewest = _FEWEST_MOVING if moving else _FEWEST
    by = np.where(burnt, *(_scatter_of_kind(values, used, kind == one, fewest)[:, None] for one in (_BURNT, 0)))
    found = np.where(known, by * shape, np.float32(np.nan))
    level = _is_level(position, steps)[:, None]
    found = np.where(level, np.maximum(found, sigma), found)
    with np.errstate(invalid="ignore"):
        told = by < _MOST * np.sqrt(ranked(width, known, 0.5)[:, None] / FWHM)
        # Where pixels say that there is no error at all, no factor is too large.
        told &= ~(by >= usual * np.broadcast_to(most, len(sigma))[:, None])
    return np.where(told, found, otherwise).astype(np.float32)


_Used = list[Bool[np.ndarray, "frames some"]]


def _of_moving(used: _Used, position: Lines, apart: list[int]) -> _Used:
    """Those over the shortest distances along which the stripe moves; over the shortest of all where few are.

    Over longer ones than it needs the surface's own bends count.
    """
    over = np.array([moves(position, some, k, _MOVES_PX) for k, some in zip(apart, used, strict=True)])
    over &= np.cumsum(over, axis=0) <= _SHORTEST
    count = sum(by * some.sum(axis=1) for by, some in zip(over, used, strict=True))
    over = np.where(count < _FEWEST_MOVING, np.arange(len(apart))[:, None] < _SHORTEST, over)
    return [some & by[:, None] for some, by in zip(used, over, strict=True)]


def agreed(sigma: Lines, position: Lines, grained: Bool[np.ndarray, "frames"]) -> Lines:
    """σ that pixels show, of each frame by what they and the scatter of its lines say together.

    Either says it with an error of its own: noise and speckle are read from some windows of a frame.

    Args:
        sigma: of each line's centre, as its pixels show it, px; NaN where there is none.
        position: the centre, px.
        grained: in which frames speckle goes on from line to line.
    """
    # Without any noise σ is 0, and stays so.
    known = (sigma > 0) & np.isfinite(position)
    here, own = np.where(known, position, np.float32(0)), np.where(known, sigma, np.float32(1))
    ratio = np.zeros(len(sigma))
    for which, apart in ((grained, _BEYOND_GRAINS), (~grained, _NEAR)):
        if which.any():
            ratio[which] = _over_said(here[which], own[which], known[which], apart)
    ln = np.log(np.where(ratio > 0, ratio, 1)).clip(-_MOST_OFF)
    ln = np.where(ln > _MOST_OFF, 0, ln)
    share = _OFF_BY_PIXELS**2 / (_OFF_BY_PIXELS**2 + 2 / np.maximum(known.sum(axis=1), 1))
    return sigma * np.exp(share * ln).astype(np.float32)[:, None]


def _over_said(
    position: Lines, sigma: Lines, known: Bool[np.ndarray, "frames lines"], apart: tuple[int, ...]
) -> Float[np.ndarray, "frames"]:
    """The scatter of each frame's third differences over the one that σ says; 0 or NaN of few."""
    steps, apart = surfaces(position, known), tuple(k for k in apart if 3 * k < position.shape[1])
    if not apart:
        return np.zeros(len(position))
    values = np.concatenate([third_differences(position, sigma, k) for k in apart], axis=1)
    used = np.concatenate([of_one_surface(steps, k) for k in apart], axis=1)
    with np.errstate(invalid="ignore"):
        near = used & (values < _FAR * _scatter(values, used)[:, None])
    return np.sqrt((np.where(near, values, 0) ** 2).sum(axis=1) / np.maximum(near.sum(axis=1), 1))


def beyond_usual(sigma: Lines, widened: Lines) -> Lines:
    """σ that has been widened line by line, by no more than is beyond the usual: that is in the scatter already.

    Args:
        sigma: as `sigma_by_scatter` gives it, px.
        widened: the same as it was widened.
    """
    more = widened**2 - sigma**2
    usual = ranked(np.nan_to_num(more), np.isfinite(more), 0.5)[:, None]
    return np.sqrt(sigma**2 + np.maximum(more - np.nan_to_num(usual), 0)).astype(np.float32)


def surfaces(position: Lines, known: Bool[np.ndarray, "frames lines"]) -> Int[np.ndarray, "frames lines"]:
    """On which surface each line is, counted: between two lines that are a step apart another one begins."""
    step = ~(known[:, 1:] & known[:, :-1]) | (np.abs(np.diff(position, axis=1)) > _STEP_PX)
    return np.pad(np.cumsum(step, axis=1), ((0, 0), (1, 0)))


def of_one_surface(steps: Int[np.ndarray, "frames lines"], apart: int) -> Bool[np.ndarray, "frames some"]:
    """Which third differences of lines so far apart are of one surface, as `surfaces` counts them."""
    first, _, _, last = _taken(steps.shape[1], apart)
    return steps[:, last] == steps[:, first]


def third_differences(position: Lines, sigma: Lines, apart: int) -> Float[np.ndarray, "frames some"]:
    """Third differences over their σ, all positive.

    Args:
        position: of each line, px.
        sigma: of each line, px.
        apart: how far the lines are apart of which they are taken.
    """
    at = _taken(position.shape[1], apart)
    bends = sum(by * position[:, here] for by, here in zip(_THIRD, at, strict=True))
    variance = sum(by * by * sigma[:, here] ** 2 for by, here in zip(_THIRD, at, strict=True))
    return np.abs(bends) / np.sqrt(variance)


def moves(
    position: Lines, used: Bool[np.ndarray, "frames some"], apart: int, least_px: float
) -> Bool[np.ndarray, "frames"]:
    """In which frames the stripe moves from one line to the next that is so far apart.

    Args:
        position: of each line, px.
        used: which third differences are asked.
        apart: how far their lines are apart.
        least_px: by how much half of them differ at the least.
    """
    first, second, *_ = _taken(position.shape[1], apart)
    moved = np.where(used, np.abs(position[:, second] - position[:, first]), 0)
    return ranked(moved, used, 0.5) >= least_px


def _taken(size: int, apart: int) -> list[slice]:
    """The first to the last line of each third difference."""
    reach = 3 * apart
    return [slice(k * apart, size - reach + k * apart) for k in range(len(_THIRD))]


def _in_the_middle(each: Num[np.ndarray, "frames lines"], apart: int) -> Num[np.ndarray, "frames some"]:
    """The sum over the middle two lines of each third difference."""
    _, second, third, _ = _taken(each.shape[1], apart)
    return each[:, second] + each[:, third]


def _power(
    bends: Float[np.ndarray, "frames some"],
    used: Bool[np.ndarray, "frames some"],
    kind: Int[np.ndarray, "frames some"],
    ln: Float[np.ndarray, "frames some"],
) -> Float[np.ndarray, "frames"]:
    """Which power of σ of independent pixels the scatter of each frame's lines follows.

    The logarithm of a difference rises with that of σ by this slope. Where σ is alike in all lines, or where these are
    few, it is the usual power.

    Args:
        bends: third differences.
        used: which are of one surface.
        kind: of how many burnt-out lines each is: between the kinds nothing is compared.
        ln: the logarithm of σ of independent pixels in the middle of each.
    """
    usual = ranked(bends, used, 0.5)[:, None]
    with np.errstate(invalid="ignore"):
        used = used & (usual > 0) & (bends < _FAR / _MEDIAN_OVER_SIGMA * usual)
    y = np.log(np.maximum(np.where(used, bends, 1) / np.where(usual > 0, usual, 1), _SMALL))
    square, product = np.zeros(len(used)), np.zeros(len(used))
    for one in range(_BURNT + 1):
        here = used & (kind == one)
        count = np.maximum(here.sum(axis=1, keepdims=True), 1)
        u, v = (np.where(here, each - (each * here).sum(axis=1, keepdims=True) / count, 0) for each in (ln, y))
        square, product = square + (u * u).sum(axis=1), product + (u * v).sum(axis=1)
    of_lines, of_usual = 1 / (_SCATTER_OF_LN**2 * _ALIKE), 1 / _OFF_BY_POWER**2
    power = (of_lines * product + of_usual * _USUAL_POWER) / (of_lines * square + of_usual)
    return power.clip(0, _MOST_POWER)


def _scatter_of_kind(
    values: Float[np.ndarray, "frames some"],
    used: Bool[np.ndarray, "frames some"],
    kind: Bool[np.ndarray, "frames some"],
    fewest: int,
) -> Float[np.ndarray, "frames"]:
    """The scatter of differences of one kind; of all where there are few of these."""
    few = (used & kind).sum(axis=1) < fewest
    return _scatter(values, used & (kind | few[:, None]), fewest)


def _scatter(
    values: Float[np.ndarray, "frames some"], used: Bool[np.ndarray, "frames some"], fewest: int = _FEWEST
) -> Float[np.ndarray, "frames"]:
    """The standard deviation of each frame's values, all positive, without those that are far off; NaN of few."""
    count = used.sum(axis=1)
    ordered = np.sort(np.where(used, values, np.inf), axis=1)
    frames = np.arange(len(values))

    def ranked(share: float, count: Int[np.ndarray, "frames"]) -> Float[np.ndarray, "frames"]:
        return ordered[frames, (share * np.maximum(count - 1, 0)).astype(int)]

    by = ranked(0.5, count) / _MEDIAN_OVER_SIGMA
    for _ in range(_LOOKS):
        by = ranked(_USUAL, (ordered < _FAR * by[:, None]).sum(axis=1)) / _USUAL_OVER_SIGMA
    return np.where(count >= fewest, by, np.nan)


def _is_level(position: Lines, steps: Int[np.ndarray, "frames lines"]) -> Bool[np.ndarray, "frames"]:
    """In which frames the stripe stays where it is, from one block to the next."""
    if position.shape[1] <= _LEVEL_BY:
        return np.ones(len(position), bool)
    one = steps[:, _LEVEL_BY:] == steps[:, :-_LEVEL_BY]
    moved = ranked(np.abs(position[:, _LEVEL_BY:] - position[:, :-_LEVEL_BY]), one, 0.5)
    return ~(moved >= _LEVEL_PX)
