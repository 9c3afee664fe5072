"""How strongly a pixel answers to the laser's colour.

The *response* to a laser of colour L with the other two channels M, N is

    r = 2 L − min(M + N, c)            grey: r = intensity

so that neutral light cancels, while c, the level of M + N where there is no laser, keeps the burnt-out core of a
stripe, which is white, from cancelling too. Where a photograph with the laser off is given it is subtracted first.
"""

from typing import Final

import jax.numpy as jnp
from jaxtyping import Array, Int, UInt

Images = UInt[Array, "frames rows columns *rgb"]
# One for all frames, or one for each.
Backgrounds = UInt[Array, "backgrounds rows columns *rgb"]

CHANNELS: Final = {"red": (0, 1, 2), "green": (1, 0, 2), "blue": (2, 0, 1)}
COLORS: Final = (*CHANNELS, "grey")


def split(
    pixels: UInt[Array, "..."], background: UInt[Array, "..."] | None, color: str
) -> tuple[Int[Array, "..."], Int[Array, "..."]]:
    """2 L and M + N, signed, less those of the background; of grey pixels the intensity and zero.

    Args:
        pixels: the channels in the last axis; grey has no such axis.
        background: the same pixels with the laser off, or None.
        color: of the laser, or grey.
    """
    # 2 L − (M + N) of a difference of bytes stays within ± 1020, and packed in 32 of them still fits 16 bits.
    signed = jnp.int16 if pixels.dtype == jnp.uint8 else jnp.int32

    def level(*channel: int) -> Int[Array, "..."]:
        lit = pixels[(..., *channel)].astype(signed)
        return lit if background is None else lit - background[(..., *channel)].astype(signed)

    if color == "grey":
        intensity = level()
        return intensity, jnp.zeros_like(intensity)
    laser, *others = (level(i) for i in CHANNELS[color])
    return 2 * laser, others[0] + others[1]
