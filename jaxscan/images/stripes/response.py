"""How strongly a pixel answers to the laser's colour.

The *response* to a laser of colour L with the other two channels M, N is

    r = 2 L − min(m M + n N, c (m + n) / 2)            grey: r = intensity

with weights m, n from 0 to 2, while c, the level of M + N where there is no laser, keeps the burnt-out core of a
stripe, which is white, from cancelling. Where a photograph with the laser off is given it is subtracted first.

Stripes are looked for with m = n = 1, so that neutral light cancels, in integers. They are measured with weights of
their own photograph. With a the mean colour of the laser on the surface, and C the covariance of the three channels
beside the stripe, texture and noise together, the response w · p in which the stripe stands out most has

    w = C⁻¹ a,      m = −2 w_M / w_L,  n = −2 w_N / w_L

(R. A. Fisher 1936). Under warm light it is warm texture that cancels; where there is none, m and n are near zero, for
the other channels would bring nothing but their noise.
"""

from typing import Final

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxscan.images.stripe_settings import CHANNELS

Images = UInt[Array, "frames rows columns *rgb"]
# One for all frames, or one for each.
Backgrounds = UInt[Array, "backgrounds rows columns *rgb"]

# The weights m and n with which neutral light cancels.
NEUTRAL: Final = (1.0, 1.0)
# Rounding's own variance, grey levels squared: no covariance is smaller.
_ROUNDING = 1 / 12


def channels(
    pixels: UInt[Array, "..."], background: UInt[Array, "..."] | None, color: str
) -> tuple[Int[Array, "..."], ...]:
    """L, M, N, or the intensity alone: signed, less those of the background.

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

    return (level(),) if color == "grey" else tuple(level(i) for i in CHANNELS[color])


def coarse_response(levels: tuple[Int[Array, "..."], ...], ambient: Int[Array, "..."]) -> Int[Array, "..."]:
    """The response with m = n = 1, in the integers of the levels."""
    if len(levels) == 1:
        return levels[0]
    laser, *others = levels
    return 2 * laser - jnp.minimum(others[0] + others[1], ambient.astype(laser.dtype))


def response(
    levels: tuple[Int[Array, "groups window lines"], ...],
    weights: tuple[Float[Array, "groups 1 _"], Float[Array, "groups 1 _"]] | tuple[float, float],
    ambient: Int[Array, "groups 1 _"],
) -> Float[Array, "groups window lines"]:
    """The response with weights of one's own.

    Args:
        levels: as `channels` gives them.
        weights: m and n.
        ambient: c.
    """
    if len(levels) == 1:
        return levels[0].astype(jnp.float32)
    laser, *others = (level.astype(jnp.float32) for level in levels)
    m, n = weights
    return 2 * laser - jnp.minimum(m * others[0] + n * others[1], ambient.astype(jnp.float32) * (m + n) / 2)


def channel_weights(
    levels: tuple[Int[Array, "frames window lines"], ...],
    stripe: Float[Array, "frames window lines"],
    beside: Bool[Array, "frames window lines"],
) -> tuple[Float[Array, "frames"], Float[Array, "frames"]]:
    """The weights m and n in which the stripe stands out most from texture and noise, for each frame.

    Args:
        levels: the three channels.
        stripe: how much each pixel is of the stripe; 0 where it is not, or where it is full.
        beside: which pixels are beside it.
    """
    count = beside.sum(1, keepdims=True)
    off = [level - jnp.where(beside, level, 0).sum(1, keepdims=True) / jnp.maximum(count, 1) for level in levels]
    # Each line's own mean costs it a degree of freedom.
    freedom = jnp.maximum((count - 1).sum((1, 2)), 1)
    C = [[jnp.where(beside, p * q, 0.0).sum((1, 2)) / freedom for q in off] for p in off]
    rows = [jnp.stack([value + _ROUNDING * (i == j) for j, value in enumerate(row)], -1) for i, row in enumerate(C)]
    a = jnp.stack([(stripe * p).sum((1, 2)) for p in off], -1)
    # C⁻¹ a but for its length, which the weights do not ask: the rows of the adjugate are cross products.
    w = jnp.stack([(jnp.cross(rows[i - 2], rows[i - 1]) * a).sum(-1) for i in range(3)], -1)
    ratio = -2 * w[:, 1:] / jnp.maximum(w[:, :1], jnp.finfo(jnp.float32).tiny)
    # Where nothing stands out in the laser's own channel, neutral light cancels.
    m, n = jnp.where(w[:, :1] > 0, jnp.clip(ratio, 0.0, 2.0), 1.0).T
    return m, n
