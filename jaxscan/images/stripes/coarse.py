"""First step of stripe detection: in which block of rows the response to the laser is greatest.

A compiler of loops does this at the speed of memory only as one reduction over blocks of 12 to 18 rows, in integers
as short as will do, with the greatest response and where it is packed into one number: r · 32 + (31 − k).
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxscan.images.stripes.response import Backgrounds, Images, channels, coarse_response
from jaxscan.kept_programs import compiled

# Integers of any shape, of JAX or of NumPy.
Packed = TypeVar("Packed", Array, np.ndarray)

# Five bits hold the place in a block.
_BITS = 5
# Those that divide a usual size come first; a remainder is covered by one more block that overlaps the last.
_BLOCKS = (16, 15, 18, 12, 14, 17, 13)
# A block stands out from those this many blocks away; nearer ones may hold the flanks of the same stripe.
SURROUNDINGS = 3


def block_size(length: int) -> int:
    """How many rows (or columns) make a block, in an image of `length` rows (or columns)."""
    return next((b for b in _BLOCKS if length % b == 0), _BLOCKS[0])


@compiled(static_argnames=("color", "columns"))
def coarse_peaks(
    images: Images, background: Backgrounds | None, ambient: Int[Array, "frames"], color: str, columns: bool
) -> Int[Array, "frames across down"]:
    """The greatest response of each block and where in it, packed.

    Blocks run down the columns and come out as (frames, blocks, columns), or along the rows: (frames, rows, blocks).
    """
    level = coarse_response(channels(images, background, color), ambient[:, None, None])
    axis = 1 if columns else 2
    length = level.shape[axis]
    block = block_size(length)
    whole = length - length % block
    peaks = _reduce_blocks(jax.lax.slice_in_dim(level, 0, whole, axis=axis), block, axis)
    if whole == length:
        return peaks
    last = _reduce_blocks(jax.lax.slice_in_dim(level, length - block, length, axis=axis), block, axis)
    return jnp.concatenate([peaks, last], axis=axis)


def _reduce_blocks(level: Int[Array, "frames rows columns"], block: int, axis: int) -> Int[Array, "frames across down"]:
    shape = level.shape
    split = level.reshape(*shape[:axis], shape[axis] // block, block, *shape[axis + 1 :])
    place = (2**_BITS - 1 - jnp.arange(block, dtype=level.dtype)).reshape(_along(axis + 1, 4))
    return (split * 2**_BITS + place).max(axis + 1)


def stand_out(level: Int[Array, "frames across down"], columns: bool) -> Int[Array, "frames across down"]:
    """Twice how much each block stands out from its surroundings.

    A stripe is narrow and a glare is broad: half the level of the brighter of the surroundings is taken off. What lies
    beyond the image's edge is taken to be as bright as the last block.
    """
    axis = 1 if columns else 2
    n = level.shape[axis]
    far = [(0, 0)] * 3
    far[axis] = (SURROUNDINGS, SURROUNDINGS)
    padded = jnp.pad(level, far, mode="edge")
    before, after = (jax.lax.slice_in_dim(padded, i, i + n, axis=axis) for i in (0, 2 * SURROUNDINGS))
    return 2 * level - jnp.maximum(before, after)


def level_of(peaks: Packed) -> Packed:
    """The response of packed peaks."""
    return peaks >> _BITS


def row_of(peaks: Packed, block: Packed, length: int) -> Packed:
    """The row (or column) of packed peaks."""
    start = block * block_size(length)
    beyond = start - (length - block_size(length))
    # The last block overlaps the one before it.
    return start - beyond * (beyond > 0) + (2**_BITS - 1) - (peaks & (2**_BITS - 1))


@compiled(static_argnames=("length", "columns"))
def choose_peaks(
    peaks: Int[Array, "frames across down"], length: int, columns: bool
) -> tuple[Int[Array, "frames lines"], Int[Array, "frames lines"]]:
    """The row (or column) of each column's (or row's) peak, and by how much it is above its surroundings.

    It is looked for in the block that stands out most. Of equals the first is taken.
    """
    axis = 1 if columns else 2
    n = peaks.shape[axis]
    bits = (n - 1).bit_length()
    score = stand_out(level_of(peaks).astype(jnp.int32), columns)
    # Packed once more, for a reduction that also returns the place of a maximum is ten times slower. A score of 16 bit
    # photographs takes 20 bits, which leaves 11 for the block.
    place = jax.lax.broadcasted_iota(jnp.int32, score.shape, axis)
    best = (score * 2**bits + (n - 1 - place)).max(axis, keepdims=True)
    block = n - 1 - (best & (2**bits - 1))
    peak = jnp.take_along_axis(peaks, block, axis, mode="promise_in_bounds")
    # In light that fills the image a bright block without a stripe stands out as its level does: that is taken off.
    above = (best >> bits) - level_of(peak.astype(jnp.int32))
    return row_of(peak.astype(jnp.int32), block, length).squeeze(axis), above.squeeze(axis)


def _along(axis: int, rank: int) -> list[int]:
    """The shape of a vector along `axis`, for broadcasting against an array of `rank` axes."""
    return [-1 if i == axis else 1 for i in range(rank)]
