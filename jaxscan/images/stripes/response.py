"""How strongly a pixel answers to the laser's colour.

The *response* to a laser of colour L with the other two channels M, N is

    r = 2 L − min(m M + n N, c (m + n) / 2)            grey: r = intensity, or luma where there are colours

with weights m and n, while c, the level of M + N where there is no laser, keeps the burnt-out core of a
stripe, which is white, from cancelling. Where a photograph with the laser off is given it is subtracted first.

Stripes are looked for with m = n = 1, so that neutral light cancels, in integers. They are measured with weights of
their own line (`colours`).

A JPEG mostly keeps luma Y = 0.299 R + 0.587 G + 0.114 B for each pixel, and the colour's differences from it, chroma,
for every second one (4:2:0); so does a video. With S what keeping every second does, and interpolating or repeating it,
such a photograph shows a channel l as Y + S(l − Y): a stripe of a pixel or two comes out wide, crooked, and never full.
Laser light has one colour, whatever it falls on. With g its part in channel l, and q = Σ w g its luma, both in parts of
that in the laser's own channel, the channel at full resolution is

    l + (g / q − 1) (Y − S Y)
"""

from typing import Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxscan.geometry.rotation import A, namespace
from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.kept_programs import compiled

Images = UInt[Array, "frames rows columns *rgb"]
# One for all frames, or one for each.
Backgrounds = UInt[Array, "backgrounds rows columns *rgb"]

# The weights m and n with which neutral light cancels.
NEUTRAL: Final = (1.0, 1.0)
# The variance of rounding to whole grey levels, levels squared: no covariance is smaller.
ROUNDING: Final = 1 / 12
# Parts of red, green and blue in luma (ITU-R BT.601).
LUMA: Final = (0.299, 0.587, 0.114)
_WITH_COLOURS: Final = 4
# A channel that is interpolated to full resolution is full from this part of its greatest number on: what a JPEG
# leaves of luma's detail is off by a few grey levels, and counts threefold.
FULL_OF_LUMA: Final = 0.9
# Chroma is at half resolution where its third differences within pairs are at most this multiple of pure rounding, and
# those across pairs are this multiple of those within; decided from at least this number of pairs.
_OF_ROUNDING, _ACROSS, _TOLD_BY = 1.5, 3.0, 100
# Of light that is whiter than this, in parts of the laser's own channel, the colour does not show.
MOST_WHITE: Final = 0.3
# What red, green and blue take of chroma, Cb and Cr.
CHROMA: Final = np.array([[0.0, 1.402], [-0.344136, -0.714136], [1.772, 0.0]], np.float32)
# How far luma is off there, grey levels; and in a video.
_LUMA_ERROR: Final = 1.0
_LUMA_ERROR_OF_VIDEO: Final = 3.0


def channels(
    pixels: UInt[Array, "..."], background: UInt[Array, "..."] | None, color: str
) -> tuple[Int[Array, "..."], ...]:
    """L, M, N, or the intensity alone: signed, less those of the background.

    Args:
        pixels: the channels in the last of four axes; a grey camera's have three.
        background: the same pixels with the laser off, or None.
        color: of the laser, or grey.
    """
    if color == "grey" and pixels.ndim == _WITH_COLOURS:
        lit = _luma(tuple(pixels[..., i] for i in range(3)), LUMA)
        return (lit if background is None else lit - _luma(tuple(background[..., i] for i in range(3)), LUMA),)
    # 2 L − (M + N) of a difference of bytes stays within ± 1020, and packed in 32 of them still fits 16 bits.
    signed = jnp.int16 if pixels.dtype == jnp.uint8 else jnp.int32

    def level(*channel: int) -> Int[Array, "..."]:
        lit = pixels[(..., *channel)].astype(signed)
        return lit if background is None else lit - background[(..., *channel)].astype(signed)

    return (level(),) if color == "grey" else tuple(level(i) for i in CHANNELS[color])


def numbers(pixels: UInt[Array, "..."], color: str) -> UInt[Array, "..."]:
    """The channel that shows whether a pixel is full: the laser's channel; of a grey laser the greatest."""
    if color != "grey":
        return pixels[..., CHANNELS[color][0]]
    return pixels.max(-1) if pixels.ndim == _WITH_COLOURS else pixels


def coarse_response(levels: tuple[Int[Array, "..."], ...], ambient: Int[Array, "..."]) -> Int[Array, "..."]:
    """The response with m = n = 1, in the integers of the levels."""
    if len(levels) == 1:
        (level,) = levels
        return level if jnp.issubdtype(level.dtype, jnp.integer) else jnp.rint(level).astype(jnp.int32)
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
    cap = jnp.where(m + n > 0, ambient.astype(jnp.float32) * (m + n) / 2, jnp.inf)
    return 2 * laser - jnp.minimum(m * others[0] + n * others[1], cap)


def noise_gain(weights: tuple[A, A], color: str) -> A:
    """σ of the noise of the response over that of one channel, with weights m and n.

    Args:
        weights: m and n.
        color: of the laser; of a grey one the response is the intensity.
    """
    m, n = weights
    xp = namespace(m)
    return xp.ones_like(m) if color == "grey" else xp.sqrt(4 + m**2 + n**2)


class Detail(eqx.Module):
    """What luma's detail gives back to channels whose colours are at half resolution: each frame's, or each line's.

    Attributes:
        gains: how far L, M and N gain by it, g / q − 1; 0 where colours are at full resolution, or need none.
        repeated: whether both pixels of a pair show the colour that they share, as in a video, or it is interpolated.
    """

    gains: tuple[Float[Array, "*of"], Float[Array, "*of"], Float[Array, "*of"]]
    repeated: Bool[Array, "*of"]


@compiled(static_argnames="color")
def half_chroma(
    lit: UInt[Array, "frames window lines rgb"], first: Int[Array, "frames lines"], color: str
) -> tuple[Bool[Array, "frames"], Bool[Array, "frames"]]:
    """Whether the colours of each frame are at half resolution along its windows; and whether they are repeated.

    Two pixels that share their chroma, and their neighbours, lie on a straight line once it has been interpolated: its
    third difference d₊₂ − 3 d₊₁ + 3 d − d₋₁ is what rounding leaves. Where it has been repeated it is their first
    difference. One between two pairs is not.

    Args:
        lit: the pixels, 8 bits.
        first: the row (or column) of each window's first pixel.
        color: of the laser.
    """
    levels = channels(lit, None, color)
    chroma = levels[0] - _luma(levels, _luma_weights(color))
    # A pixel out of the range of numbers was cut off when it was decoded.
    whole = ((lit > 0) & (lit < jnp.iinfo(lit.dtype).max)).all(-1)
    own, *rest = _luma_weights(color)
    of_luma = (1 - own) ** 2 + sum(w * w for w in rest)
    odd = (first[:, None] + jnp.arange(lit.shape[1])[None, :, None]) % 2 == 1

    def usual(off: Array, where: Array) -> tuple[Float[Array, "frames"], Int[Array, "frames"]]:
        count = where.sum((1, 2))
        return jnp.where(where, off**2, 0.0).sum((1, 2)) / jnp.maximum(count, 1), count

    def in_pairs(off: Array, known: Array, within: Array, rounding: float) -> Bool[Array, "frames"]:
        (inside, count), (across, others) = usual(off, known & within), usual(off, known & ~within)
        told = jnp.minimum(count, others) >= _TOLD_BY
        return told & (inside < _OF_ROUNDING * ROUNDING * rounding) & (across > _ACROSS * inside)

    third = chroma[:, 3:] - chroma[:, :-3] - 3 * (chroma[:, 2:-1] - chroma[:, 1:-2])
    known = whole[:, 3:] & whole[:, 2:-1] & whole[:, 1:-2] & whole[:, :-3]
    # 20 = 1 + 9 + 9 + 1; what is repeated has the same chroma twice, rounded once.
    interpolated = in_pairs(third, known, odd[:, :-3], 20 * (of_luma + float((CHROMA[CHANNELS[color][0]] ** 2).sum())))
    first_off = chroma[:, 1:] - chroma[:, :-1]
    repeated = in_pairs(first_off, whole[:, 1:] & whole[:, :-1], ~odd[:, :-1], 2 * of_luma)
    return interpolated | repeated, repeated


def detail_of(
    levels: tuple[Float[Array, "frames window lines"], ...],
    flank: int,
    half: Bool[Array, "frames"],
    repeated: Bool[Array, "frames"],
    color: str,
) -> tuple[Detail, Bool[Array, "frames"]]:
    """What luma's detail gives back, and in which frames.

    The laser's colour is determined by sums over the windows, which halving and interpolating leave unchanged.
    Where all channels are full of it, it does not show, and the photograph is taken as it is.

    Args:
        levels: the three channels.
        flank: number of pixels at either end of a window that give its background.
        half: whether the frame's colours are at half resolution.
        repeated: whether pixels of a pair have the same colour.
        color: of the laser.
    """
    size = levels[0].shape[1]
    light = [
        level.sum(1) - size * jnp.concatenate([level[:, :flank], level[:, -flank:]], axis=1).mean(1) for level in levels
    ]
    lit = light[0] > 0
    others = [
        jnp.nanmedian(jnp.where(lit, jnp.clip(each / jnp.where(lit, light[0], 1.0), 0.0, 1.0), jnp.nan), axis=1)
        for each in light[1:]
    ]
    g = [jnp.ones(len(half)), *(jnp.nan_to_num(each) for each in others)]
    q = _luma(tuple(g), _luma_weights(color))
    half = half & (others[0] + others[1] < 2 * MOST_WHITE)
    laser, first, second = (jnp.where(half, each / q - 1, 0.0) for each in g)
    return Detail((laser, first, second), repeated), half


def luma_error(
    detail: Detail,
    half: Bool[Array, "frames"],
    weights: tuple[Float[Array, "frames"], Float[Array, "frames"]],
) -> Float[Array, "frames"]:
    """σ of the response by what keeping luma coarsely leaves; 0 where colours are at full resolution."""
    laser, first, second = (1 + by for by in detail.gains)
    m, n = weights
    error = jnp.where(detail.repeated, _LUMA_ERROR_OF_VIDEO, _LUMA_ERROR)
    return jnp.where(half, error * jnp.abs(2 * laser - m * first - n * second), 0.0)


def detailed(
    levels: tuple[Array, ...], first: Int[Array, "groups lines"], detail: Detail, color: str
) -> tuple[Float[Array, "groups window lines"], ...]:
    """The channels at full resolution.

    Args:
        levels: as they were decoded.
        first: the row (or column) of each window's first pixel.
        detail: as `detail_of` gives it, of each line.
        color: of the laser.
    """
    Y = _luma(levels, _luma_weights(color))
    size = Y.shape[1]
    padded = jnp.pad(Y, [(0, 0), (2, 2), (0, 0)], mode="edge")
    before, further = padded[:, 1 : 1 + size], padded[:, :size]
    after, beyond = padded[:, 3 : 3 + size], padded[:, 4 : 4 + size]
    begins = (first[:, None] + jnp.arange(size)[None, :, None]) % 2 == 0
    # Of a pair's two pixels the mean, and where it is interpolated a quarter of the next pair's towards that side.
    pair = Y + jnp.where(begins, after, before)
    smooth = jnp.where(detail.repeated, 4 * pair, 3 * pair + jnp.where(begins, before + further, after + beyond)) / 8
    return tuple(level + by * (Y - smooth) for level, by in zip(levels, detail.gains, strict=True))


def _luma_weights(color: str) -> tuple[float, float, float]:
    """Weights of L, M and N in luma."""
    laser, first, second = CHANNELS[color]
    return LUMA[laser], LUMA[first], LUMA[second]


def _luma(levels: tuple[Array, ...], weights: tuple[float, float, float]) -> Float[Array, "..."]:
    return sum((w * level for w, level in zip(weights, levels, strict=True)), start=jnp.zeros((), jnp.float32))
