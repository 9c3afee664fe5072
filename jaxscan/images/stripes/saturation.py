"""From which number on a pixel is full: a sensor's greatest number, whatever the bits of its photographs."""

from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.images.stripes.ranks import median

# A pixel is full from its greatest number on, and what a JPEG makes of it.
FULL: Final = 0.99
# Numbers of 16 bits may come from a sensor of fewer.
_DEPTHS: Final = (10, 12, 14)

# Pixels of a line that are as near to its top as this part of its height; a top is flat if they are no fewer than this,
# and more than this part of those above half the height: of a bell they are a third.
_NEAR, _FEWEST, _FLAT = 0.07, 3, 0.5
# Tops of lines are cut off if at least this part of them is flat, most of these at one number, to this part of it, and
# next to none are higher.
_OFTEN, _ALIKE, _BEYOND, _SELDOM = 0.25, 0.02, 1.04, 0.02
# Pixels that are cut off are no further below than this number of standard deviations, and this part of the number:
# flat tops that are much lower are something else, a lit border beside a shadow.
_SPREADS, _LOWEST = 2.5, 0.12


def greatest_numbers(bits: int) -> list[int]:
    """The possible greatest numbers of a sensor whose photographs have `bits` bits."""
    return [2**b - 1 for b in (*(d for d in _DEPTHS if d < bits), bits)]


def full_number(laser: Int[Array, "frames window lines"], coded: Bool[Array, "frames"]) -> Int[Array, "frames"]:
    """From which number on a pixel is full.

    Args:
        laser: the numbers of windows about a stripe.
        coded: which frames are JPEGs, whose own error lies below a full number too.
    """
    bits = jnp.iinfo(laser.dtype).bits
    depths = jnp.asarray(greatest_numbers(bits), jnp.int32)
    level = laser.astype(jnp.float32)
    top = level.max(1)
    greatest = jnp.where(depths[None] >= top.max(1)[:, None], depths[None], depths[-1]).min(1)
    return jnp.floor(jnp.minimum(FULL * greatest, _plateau(level, top, coded))).astype(jnp.int32)


def has_plateau(full: Int[np.ndarray, "frames"]) -> Bool[np.ndarray, "frames"]:
    """In which frames of 8 bits pixels are full from another number on than the greatest."""
    return full != np.floor(FULL * greatest_numbers(8)[-1])


def _plateau(
    level: Float[Array, "frames window lines"],
    top: Float[Array, "frames lines"],
    coded: Bool[Array, "frames"],
) -> Float[Array, "frames"]:
    """From which number on pixels are cut off, by the lines whose top is flat; infinite where none are."""
    rise = top - level.min(1)
    near = level >= (top - _NEAR * rise)[:, None]
    high = level >= (top - 0.5 * rise)[:, None]
    count = near.sum(1)
    flat = (count >= _FEWEST) & (count > _FLAT * high.sum(1))
    usual = median(jnp.where(flat, top, jnp.nan))
    off = median(jnp.where(flat, jnp.abs(top - usual[:, None]), jnp.nan))
    inside = near & jnp.roll(near, 1, axis=1) & jnp.roll(near, -1, axis=1) & flat[:, None]
    below = jnp.where(inside, (jnp.maximum(usual[:, None, None] - level, 0)) ** 2, 0.0).sum((1, 2))
    spread = jnp.sqrt(below / jnp.maximum(inside.sum((1, 2)), 1))
    beyond = (top > _BEYOND * usual[:, None]).mean(1)
    cut = (flat.mean(1) > _OFTEN) & (off < _ALIKE * usual) & (beyond < _SELDOM)
    lower = jnp.clip(jnp.where(coded, 0.0, _SPREADS * spread), (1 - FULL) * usual, _LOWEST * usual)
    return jnp.where(cut, usual - lower, jnp.inf)
