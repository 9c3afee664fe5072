"""The weights of a photograph's colours, line by line: those in which its stripe stands out most.

With a the mean colour of the laser on the surface, and C the covariance of the three channels beside the stripe, the
response w · p in which the stripe stands out most has

    w = C⁻¹ a,      m = −2 w_M / w_L,  n = −2 w_N / w_L

(R. A. Fisher 1936). Where an even surface lies beside the stripe, C is the sensor's noise alone: m and n are near
zero, for the other channels would bring nothing but their noise. Where texture or an edge of the room's light does,
it is their light that must cancel, whatever its colour. Lines of one photograph differ in that, so each has

    C = N + S + τ T

with N the covariance of noise, S that of the levels of the windows' two ends in most lines, for no surface is quite
even, and T that in the loudest lines. τ is read off the line's own pixels: off what the other channels show beside
their part of the laser's light, p_M − (a_M / a_L) p_L and p_N − (a_N / a_L) p_L, in which there is neither stripe nor
speckle.
"""

from typing import Any, Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.images.stripes.response import CHROMA, LUMA, MOST_WHITE, ROUNDING

# No two channels are alike to more than this, in variance.
_APART: Final = 1.001
# How far chroma at half resolution is off beside a stripe, grey levels.
_CHROMA_ERROR: Final = 2.0
# The most that m and n are: of a line's own weights, and of those that all lines have.
_MOST, _MOST_OF_ALL = 4.0, 2.0
# Which part of a frame's lines is quiet, and which is loud.
_QUIET, _LOUD = 0.5, 0.75
# A line has texture from this multiple of the quiet lines' squares on: of noise alone hardly any has more.
_NO_NOISE: Final = 2.0
# Of the laser's light the other channels have at most this part of what its own has.
_MOST_OF_OTHERS: Final = 0.9
# Pixels so near to the middle may be of the stripe. Channels are aligned where this part of the quiet lines shows no
# more there than this multiple of the noise.
_SOME: Final = 0.25
_NEAR_PX: Final = 5
_OFF: Final = 2.0
_TINY = 1e-12

# Which channels a covariance's numbers are of, and which of these are variances.
_PAIRS: Final = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_OWN: Final = (0, 3, 5)
# The median of the mean square of five pixels beside their own mean, in parts of the variance: χ² of 4 over 4.
_MEDIAN_OF_SQUARES: Final = 0.839
# This part of the squares of a normal number is less than the second one, in parts of its variance.
_FEW, _FEW_OF_SQUARES = 0.3, 0.1485

# Of L, M and N with one another: LL, LM, LN, MM, MN, NN.
Covariance = tuple[Array, Array, Array, Array, Array, Array]


class OwnWeights(eqx.Module):
    """The weights of each line.

    Attributes:
        weights: m and n.
        louder: variance of the line's noise over that of a line without texture.
        textured: whether it has a texture.
    """

    weights: tuple[Float[Array, "groups 1 lines"], Float[Array, "groups 1 lines"]]
    louder: Float[Array, "groups 1 lines"]
    textured: Bool[Array, "groups 1 lines"]


class Colours(eqx.Module):
    """What a frame shows of its colours: one number for each frame, or for each line of a window.

    Attributes:
        laser: a.
        noise: N, grey levels squared.
        even: N + S.
        texture: T.
        lowest: the least that m and n may be.
        by_line: whether lines have weights of their own. Of a JPEG, whose quiet parts have lost their noise, and of
            channels that are means of neighbouring pixels, all lines together show it, and have the same. So they have
            where the laser looks white.
        aligned: whether the other channels show the laser's light as its own does, a part of it. A mosaic's channels,
            coarse ones, or those of a lens that separates colours, show it elsewhere or broader.
    """

    laser: tuple[Float[Array, "*of"], Float[Array, "*of"], Float[Array, "*of"]]
    noise: Covariance
    even: Covariance
    texture: Covariance
    lowest: tuple[Float[Array, "*of"], Float[Array, "*of"]]
    by_line: Bool[Array, "*of"]
    aligned: Bool[Array, "*of"]

    def weights(self, tau: Array | float) -> tuple[Array, Array]:
        """M and n where the texture is τ times that of the loudest lines."""
        LL, LM, LN, MM, MN, NN = (n + tau * t for n, t in zip(self.even, self.texture, strict=True))
        # Channels that differ by nothing have no inverse in numbers of 24 bits.
        LL, MM, NN = (_APART * x for x in (LL, MM, NN))
        L, M, N = self.laser
        low_m, low_n = self.lowest
        # C⁻¹ a but for its length, which the weights do not ask: the adjugate's rows.
        own = (MM * NN - MN * MN) * L + (LN * MN - LM * NN) * M + (LM * MN - LN * MM) * N
        first = (LN * MN - LM * NN) * L + (LL * NN - LN * LN) * M + (LM * LN - LL * MN) * N
        second = (LM * MN - LN * MM) * L + (LM * LN - LL * MN) * M + (LL * MM - LM * LM) * N
        most = jnp.where(self.by_line, _MOST, _MOST_OF_ALL)
        m, n = _ratio(first, own, low_m, most), _ratio(second, own, low_n, most)
        # Where one of them would be negative it is none, and the other one is what it is without.
        m_alone = _ratio(LL * M - LM * L, MM * L - LM * M, low_m, most)
        n_alone = _ratio(LL * N - LN * L, NN * L - LN * N, low_n, most)
        no_m, no_n = self.by_line & (m == 0), self.by_line & (n == 0)
        return jnp.where(no_n & ~no_m, m_alone, m), jnp.where(no_m & ~no_n, n_alone, n)

    def noise_of(self, weights: tuple[Array, Array]) -> Array:
        """Variance of the noise of the response with weights m and n."""
        LL, LM, LN, MM, MN, NN = self.noise
        m, n = weights
        return 4 * (LL - m * LM - n * LN) + m * m * MM + 2 * m * n * MN + n * n * NN

    def of_lines(self, levels: tuple[Array, ...], full: Bool[Array, "groups window lines"]) -> "OwnWeights":
        """The weights of each line.

        Args:
            levels: the three channels in windows about the stripes.
            full: which pixels show no colour.
        """
        tau = self.texture_of(levels, ~full & ~(in_the_middle(full) & ~self.aligned))
        weights = self.weights(tau)
        quiet = jnp.maximum(self.noise_of(self.weights(0.0)), _TINY)
        return OwnWeights(weights, self.noise_of(weights) / quiet, tau > 0)

    def texture_of(
        self, levels: tuple[Array, ...], seen: Bool[Array, "groups window lines"]
    ) -> Float[Array, "groups 1 lines"]:
        """τ of each line: how much of the loudest lines' texture some of its pixels show."""
        squares, texture = self.beside_laser(levels, seen)
        shows = self.by_line & (squares > _NO_NOISE)
        return jnp.where(shows, squares - 1, 0.0) / jnp.maximum(texture, _TINY)

    def beside_laser(
        self, levels: tuple[Array, ...], seen: Bool[Array, "groups window lines"]
    ) -> tuple[Float[Array, "groups 1 lines"], Float[Array, "groups 1 _"]]:
        """What the other two channels show beside the laser's light, together: the squares over those of noise.

        And the same of the loudest lines' texture.
        """
        L, M, N = self.laser
        by_M, by_N = (part / jnp.maximum(L, _TINY) for part in (M, N))
        one, other = (
            1 / jnp.sqrt(self.noise[own] - 2 * by * self.noise[across] + by * by * self.noise[0])
            for by, own, across in ((by_M, 3, 1), (by_N, 5, 2))
        )
        of_laser = one * by_M + other * by_N
        noise, texture = (
            of_laser**2 * LL
            - 2 * of_laser * (one * LM + other * LN)
            + one**2 * MM
            + 2 * one * other * MN
            + other**2 * NN
            for LL, LM, LN, MM, MN, NN in (self.noise, self.texture)
        )
        # About the first pixel, whose level may be far larger than what differs.
        x = one * levels[1] + other * levels[2] - of_laser * levels[0]
        x = jnp.where(seen, x - x[:, :1], 0.0)
        count = jnp.maximum(seen.sum(1, keepdims=True), 1)
        squares = (x * x).sum(1, keepdims=True) / count - (x.sum(1, keepdims=True) / count) ** 2
        return squares / noise, texture / noise


def in_the_middle(window: Array) -> Bool[Array, "1 window 1"]:
    """Which pixels of a window are so near to its middle that a stripe may be in them."""
    size = window.shape[1]
    return jnp.abs(jnp.arange(size)[None, :, None] - (size - 1) / 2) <= _NEAR_PX


def _ratio(each: Array, own: Array, least: Array, most: Array) -> Array:
    """A channel's weight over that of the laser's own, which is −2 in the response."""
    ratio = -2 * each / jnp.maximum(own, jnp.finfo(jnp.float32).tiny)
    # Where nothing stands out in the laser's own channel, neutral light cancels.
    return jnp.where(own > 0, jnp.clip(ratio, least, most), 1.0)


class InTexture(eqx.Module):
    """A window's channels, taken apart into the laser's own and what the others show without its light.

    Attributes:
        channels: p_L, M′ and N′, the means of the last two taken out.
        first: β_M that cancels the frame's texture as the line's weights do.
        second: β_N.
        covariance: N of p_L, M′ and N′, its upper triangle.
        quiet: the variance of the response of a quiet line, by the same N.
    """

    channels: tuple[Array, Array, Array]
    first: Array
    second: Array
    covariance: Covariance
    quiet: Array

    def noise(self, first: Array, second: Array) -> Array:
        """The variance of p_L − β_M M′ − β_N N′."""
        LL, LM, LN, MM, MN, NN = self.covariance
        return LL - 2 * (first * LM + second * LN) + first**2 * MM + 2 * first * second * MN + second**2 * NN


def in_texture(levels: tuple[Array, ...], colours: Colours, lines: OwnWeights) -> InTexture:
    """The channels of windows, of the lines' own colours and weights."""
    own, *others = levels
    L, *parts = colours.laser
    by_M, by_N = (jnp.clip(part / jnp.maximum(L, _TINY), 0.0, _MOST_OF_OTHERS) for part in parts)
    apart = []
    for level, by in zip(others, (by_M, by_N), strict=True):
        beside = level - by * own
        apart.append(beside - beside.mean(1, keepdims=True))
    LL, LM, LN, MM, MN, NN = colours.noise
    covariance = (
        LL,
        LM - by_M * LL,
        LN - by_N * LL,
        MM - 2 * by_M * LM + by_M**2 * LL,
        MN - by_M * LN - by_N * LM + by_M * by_N * LL,
        NN - 2 * by_N * LN + by_N**2 * LL,
    )
    m, n = lines.weights
    # 2 L − m M − n N is (2 − m by_M − n by_N) L − m M′ − n N′.
    whole = jnp.maximum(2 - m * by_M - n * by_N, 1.0)
    quiet = jnp.maximum(colours.noise_of(colours.weights(0.0)), _TINY)
    return InTexture((own, *apart), m / whole, n / whole, covariance, quiet)


def colours_of(
    levels: tuple[Float[Array, "frames window lines"], ...],
    stripe: Float[Array, "frames window lines"],
    flank: int,
    full: Bool[Array, "frames window lines"],
    half: Bool[Array, "frames"] | None,
    interpolated: Bool[Array, ""] | None,
    coded: Bool[Array, "frames"],
    color: str,
) -> Colours:
    """The colours of each frame.

    Where colours are at half resolution, what keeping them coarsely leaves counts as noise: luma is the better light
    where there is no texture. Then m and n may be negative, down to those of luma.

    Args:
        levels: the three channels.
        stripe: how much each pixel is of the stripe; 0 where it is not, or where it is full.
        flank: number of pixels at either end of a window that are beside it.
        full: which pixels show no colour.
        half: whether the frame's colours are at half resolution; None where those of none are.
        interpolated: whether the other channels are means of neighbouring pixels; None where they are not.
        coded: which frames are known as JPEGs.
        color: of the laser.
    """
    ends = [jnp.concatenate([level[:, :flank], level[:, -flank:]], axis=1) for level in levels]
    both = [end - end.mean(1, keepdims=True) for end in ends]
    # An edge between the two ends is no noise: each of them has a mean of its own.
    each = [
        jnp.concatenate([x - x.mean(1, keepdims=True) for x in (level[:, :flank], level[:, -flank:])], axis=2)
        for level in levels
    ]
    least, lowest = _at_half_resolution(half, color, len(levels[0]))
    # What stands out of the line's mean.
    light = [(stripe * (x - end.mean(1, keepdims=True))).sum((1, 2)) for x, end in zip(levels, ends, strict=True)]
    length = jnp.maximum(jnp.sqrt(sum(x * x for x in light)), _TINY)
    L, M, N = (x / length for x in light)
    # Of a laser that looks white the others show as much as its own channel does.
    every = coded | (L <= 0) | (M + N > 2 * MOST_WHITE * L)
    every = every if half is None else every | half
    every = every if interpolated is None else every | interpolated
    loudness = _loudness(_squares(both))
    quiet, loud = (jnp.quantile(loudness, part, axis=1, keepdims=True) for part in (_QUIET, _LOUD))
    noise = _noise(each)
    even = [n + s for n, s in zip(noise, _uneven(levels, flank, noise), strict=True)]
    everything, loudest = _covariance(both, jnp.ones_like(loudness, bool)), _covariance(both, loudness >= loud)
    N_, even_, T = (
        tuple(jnp.where(every, a, c) + least[i][j] for a, c, (i, j) in zip(everything, some, _PAIRS, strict=True))
        for some in (noise, even, loudest)
    )
    found = Colours((L, M, N), N_, even_, T, lowest, ~every, jnp.ones(len(every), bool))
    return eqx.tree_at(lambda x: x.aligned, found, _aligned(found, levels, loudness <= quiet, full))


def _at_half_resolution(half: Bool[Array, "frames"] | None, color: str, frames: int) -> tuple[Any, tuple[Array, Array]]:
    """The least covariance of the channels, (channels, channels, 1) or for each frame, and the lowest m and n."""
    least = ROUNDING * np.eye(3, dtype=np.float32)[..., None]
    zero = jnp.zeros(frames)
    if half is None:
        return least, (zero, zero)
    error = np.float32(_CHROMA_ERROR) * CHROMA[list(CHANNELS[color])]
    own, first, second = (LUMA[i] for i in CHANNELS[color])
    lowest = jnp.where(half, -2 * first / own, 0.0), jnp.where(half, -2 * second / own, 0.0)
    return least + jnp.where(half, (error @ error.T)[..., None], 0.0), lowest


def _noise(ends: list[Float[Array, "frames some lines"]]) -> list[Array]:
    """The covariance of the channels' noise by what the ends of lines leave of their means.

    The usual end decides how much noise there is, the quieter half of them what channels have in common.
    """
    squares = _squares(ends)
    loudness = _loudness(squares)
    quieter = loudness <= jnp.quantile(loudness, _QUIET, axis=1, keepdims=True)
    usual = [jnp.median(x, axis=1) / _MEDIAN_OF_SQUARES for x in squares]
    shape = _covariance(ends, quieter)
    by = [jnp.sqrt(x / jnp.maximum(shape[i], _TINY)) for x, i in zip(usual, _OWN, strict=True)]
    return [c * by[i] * by[j] for c, (i, j) in zip(shape, _PAIRS, strict=True)]


def _uneven(levels: tuple[Array, ...], flank: int, noise: list[Array]) -> list[Array]:
    """S: a quarter of the covariance of the difference between the two ends, by those lines in which it is less.

    An edge of paint between the ends is in some lines, or in half of them.
    """
    differ = [level[:, -flank:].mean(1) - level[:, :flank].mean(1) for level in levels]
    squares = [x * x for x in differ]
    loudness = _loudness(squares)
    less = loudness <= jnp.quantile(loudness, _QUIET, axis=1, keepdims=True)
    shape = [jnp.where(less, differ[i] * differ[j], 0.0).sum(1) / jnp.maximum(less.sum(1), 1) for i, j in _PAIRS]
    usual = [jnp.quantile(x, _FEW, axis=1) / _FEW_OF_SQUARES for x in squares]
    # Noise makes them differ as well.
    own = [jnp.maximum(x - 2 / flank * noise[i], 0.0) for x, i in zip(usual, _OWN, strict=True)]
    by = [jnp.sqrt(x / jnp.maximum(shape[i], _TINY)) / 2 for x, i in zip(own, _OWN, strict=True)]
    return [c * by[i] * by[j] for c, (i, j) in zip(shape, _PAIRS, strict=True)]


def _squares(off: list[Float[Array, "frames some lines"]]) -> list[Float[Array, "frames lines"]]:
    return [(x * x).sum(1) / (x.shape[1] - 1) for x in off]


def _loudness(squares: list[Float[Array, "frames lines"]]) -> Float[Array, "frames lines"]:
    """The squares of all channels, each in parts of its usual one."""
    return sum(
        (x / jnp.maximum(jnp.median(x, axis=1, keepdims=True), ROUNDING) for x in squares), jnp.zeros_like(squares[0])
    )


def _covariance(off: list[Float[Array, "frames some lines"]], lines: Bool[Array, "frames lines"]) -> list[Array]:
    """Of the channels in some lines: LL, LM, LN, MM, MN, NN."""
    freedom = jnp.maximum(lines.sum(1), 1) * (off[0].shape[1] - 1)
    return [jnp.where(lines, (off[i] * off[j]).sum(1), 0.0).sum(1) / freedom for i, j in _PAIRS]


def _aligned(
    colours: Colours,
    levels: tuple[Array, ...],
    quiet: Bool[Array, "frames lines"],
    full: Bool[Array, "frames window lines"],
) -> Bool[Array, "frames"]:
    of_lines = jax.tree.map(lambda x: x[:, None, None], colours)
    squares, _ = of_lines.beside_laser(levels, in_the_middle(full) & ~full)
    # Paint under the stripe is in some lines, a lens's colours in all.
    return jnp.nanquantile(jnp.where(quiet, squares[:, 0], jnp.nan), _SOME, axis=1) < _OFF
