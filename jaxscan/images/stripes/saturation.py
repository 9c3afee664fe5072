"""From which number on a pixel is full: a sensor's greatest number, whatever the bits of its photographs."""

from typing import Final

import jax.numpy as jnp
from jaxtyping import Array, Int

# A pixel is full from its greatest number on, and what a JPEG makes of it.
FULL: Final = 0.99
# Numbers of 16 bits may come from a sensor of fewer.
_DEPTHS: Final = (10, 12, 14)


def greatest_numbers(bits: int) -> list[int]:
    """The possible greatest numbers of a sensor whose photographs have `bits` bits."""
    return [2**b - 1 for b in (*(d for d in _DEPTHS if d < bits), bits)]


def full_number(laser: Int[Array, "frames window lines"]) -> Int[Array, "frames"]:
    """From which number on a pixel is full: near the greatest that the sensor can have given."""
    bits = jnp.iinfo(laser.dtype).bits
    depths = jnp.asarray(greatest_numbers(bits), jnp.int32)
    top = laser.astype(jnp.int32).max((1, 2))
    greatest = jnp.where(depths[None] >= top[:, None], depths[None], depths[-1]).min(1)
    return jnp.floor(FULL * greatest).astype(jnp.int32)
