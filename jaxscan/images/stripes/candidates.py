"""Several stripes in a column: reflections, or two lit surfaces. Candidates with strengths, and rules to choose by.

A candidate is a block that stands out at least as much as either neighbour, and a quarter as much as the line's best:
two stripes in neighbouring blocks, some 16 rows apart, count as one.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscan.detectors import Choice
from jaxscan.images.stripes.coarse import SURROUNDINGS, block_size, level_of, row_of, stand_out
from jaxscan.images.stripes.coherent import support
from jaxscan.kept_programs import compiled

# How many candidates of a line are kept.
_MOST = 4
_LEAST_OF_BEST = 0.25
# A step of this number of pixels from one line to the next costs as much as the best candidate's strength. A jump of
# any length costs this multiple of it: two jumps, there and back, cost more than a reflection a few lines long gains.
_STEP_PX, _JUMP = 12.0, 4.0
# The same where support in time counts, against which strength counts so little: glints are bright.
_STEP_PX_IN_TIME, _JUMP_IN_TIME, _STRENGTH = 36.0, 3.3, 0.1


@compiled(static_argnames=("length", "columns"))
def candidates(
    peaks: Int[Array, "frames across down"], length: int, columns: bool
) -> tuple[Int[Array, "frames lines most"], Float[Array, "frames lines most"]]:
    """The rows (or columns) of each line's candidates and their strengths, the strongest first.

    A strength is how much the candidate stands out, in parts of the line's best; 0 where there are fewer.
    """
    down = 1 if columns else 2
    score = jnp.moveaxis(stand_out(level_of(peaks), columns), down, 2)
    block = jax.lax.broadcasted_iota(jnp.int32, score.shape, 2)
    row = row_of(jnp.moveaxis(peaks, down, 2).astype(jnp.int32), block, length)
    beyond = [(0, 0), (0, 0), (1, 1)]
    around = jnp.pad(score, beyond, constant_values=jnp.iinfo(score.dtype).min)
    best = score.max(2, keepdims=True)
    stands = (score >= around[..., :-2]) & (score > around[..., 2:]) & (score > 0)
    part = jnp.where(stands, score / jnp.maximum(best, 1), 0.0).astype(jnp.float32)
    strength, at = jax.lax.top_k(jnp.where(part >= _LEAST_OF_BEST, part, 0.0), min(_MOST, score.shape[2]))
    return jnp.take_along_axis(row, at, axis=2), strength


def rivals(
    peaks: Int[np.ndarray, "down lines"], taken: Int[np.ndarray, "lines"], least: float, length: int
) -> tuple[Int[np.ndarray, "some"], Int[np.ndarray, "some"]]:
    """The lines and rows of all candidates of one frame beside those that are taken, however faint beside these.

    Args:
        peaks: of each block, packed.
        taken: the row that is taken in each line.
        least: how far a candidate rises above the lowest blocks near it, on either side.
        length: rows of the image.
    """
    level = level_of(peaks)
    padded = np.pad(level, ((SURROUNDINGS, SURROUNDINGS), (0, 0)), mode="edge")
    down = len(level)
    before, after = (
        np.minimum.reduce([padded[first + i : first + i + down] for i in range(SURROUNDINGS)])
        for first in (0, SURROUNDINGS + 1)
    )
    rise = level - np.maximum(before, after)
    beside = slice(SURROUNDINGS - 1, SURROUNDINGS - 1 + down), slice(SURROUNDINGS + 1, SURROUNDINGS + 1 + down)
    stands = (rise > least) & (level >= padded[beside[0]]) & (level > padded[beside[1]])
    block, line = np.nonzero(stands)
    row = row_of(peaks[block, line].astype(np.int32), block, length)
    other = np.abs(row - taken[line]) > block_size(length) / 2
    line, row, rise = line[other], row[other], rise[block, line][other]
    if len(line) > _MOST * len(taken):
        tallest = np.sort(np.argpartition(rise, -_MOST * len(taken))[-_MOST * len(taken) :])
        line, row = line[tallest], row[tallest]
    return line, row


def highest(
    peaks: Int[np.ndarray, "down lines"],
    line: Int[np.ndarray, "some"],
    row: Int[np.ndarray, "some"],
    reach: int,
    length: int,
) -> Int[np.ndarray, "some"]:
    """The greatest response within `reach` rows of each place, from the maxima of the blocks around it."""
    greatest = np.zeros(len(line), peaks.dtype)
    for by in {-reach, 0, reach}:
        block = ((row + by) // block_size(length)).clip(0, len(peaks) - 1)
        packed = peaks[block, line]
        near = np.abs(row_of(packed.astype(np.int32), block, length) - row) <= reach
        greatest = np.maximum(greatest, np.where(near, packed, 0))
    return level_of(greatest)


def choose(
    rows: Int[np.ndarray, "frames lines most"], strength: Float[np.ndarray, "frames lines most"], rule: Choice
) -> Int[np.ndarray, "frames lines"]:
    """One candidate of each line, by a rule of `CHOICES` that looks at candidates alone.

    For `coherent` the frames are consecutive ones of a scan, and a frame's choice depends on `coherent.HALO` frames
    before it and after it: give these too where the scan has them, and leave their own choices.
    """
    if rule == "strongest":
        which = np.zeros(rows.shape[:2], np.int64)
    elif rule == "continuous":
        which = _continuous(rows, _gain(strength, strength), _STEP_PX, _JUMP)
    elif rule == "coherent":
        gain = _gain(support(rows, strength) + _STRENGTH * strength, strength)
        which = _continuous(rows, gain, _STEP_PX_IN_TIME, _JUMP_IN_TIME)
    else:
        far = np.iinfo(rows.dtype).max if rule == "first" else -1
        at = np.where(strength > 0, rows, far)
        which = at.argmin(axis=2) if rule == "first" else at.argmax(axis=2)
    return np.take_along_axis(rows, which[..., None], axis=2)[..., 0]


def _gain(
    value: Float[np.ndarray, "frames lines most"], strength: Float[np.ndarray, "frames lines most"]
) -> Float[np.ndarray, "frames lines most"]:
    return np.where(strength > 0, value, -1.0)


def _continuous(
    rows: Int[np.ndarray, "frames lines most"],
    gain: Float[np.ndarray, "frames lines most"],
    step_px: float,
    jump: float,
) -> Int[np.ndarray, "frames lines"]:
    """The sequence with the greatest sum of gains less the cost of its steps, by dynamic programming."""
    frames, lines, most = rows.shape
    total, came_from = gain[:, 0], np.zeros((frames, lines, most), np.int64)
    for i in range(1, lines):
        step = np.abs(rows[:, i, :, None] - rows[:, i - 1, None, :]) / step_px
        reached = total[:, None, :] - np.minimum(step, jump)
        came_from[:, i] = reached.argmax(axis=2)
        total = gain[:, i] + reached.max(axis=2)
    which = np.zeros((frames, lines), np.int64)
    which[:, -1] = total.argmax(axis=1)
    for i in range(lines - 1, 0, -1):
        which[:, i - 1] = np.take_along_axis(came_from[:, i], which[:, i, None], axis=1)[:, 0]
    return which
