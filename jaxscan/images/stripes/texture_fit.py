"""The maximum-likelihood fit of a stripe on a surface whose colours the other channels show.

An edge of the surface's colour, or of the room's light, beside or under a stripe is seen by the channels in which the
laser hardly shines too. So the laser's own channel is fitted, with what the others show as a part of its ground:

    μ_k = b + A P_k(c, s) + β_M M′_k + β_N N′_k,    M′ = p_M − (a_M / a_L) p_L,  N′ = p_N − (a_N / a_L) p_L

in which M′ and N′ have nothing of the laser's light, nor of its speckle. θ = (b, ln A, ln s, β_M, β_N, c) is fitted as
`likelihood` fits its four numbers; β are the line's own, for each edge has colours of its own. Their noise counts as
that of the pixel,

    v_k = (1, −β)ᵀ N (1, −β) + shot · A P_k + C² (A P_k)²,    N of (p_L, M′, N′)
"""

from dataclasses import replace
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxscan.images.stripes.bell import FWHM, Profile, pixels
from jaxscan.images.stripes.classical import Estimate
from jaxscan.images.stripes.likelihood import FREEDOM_OF_NOISE, LN_HEIGHT_SPREAD, REACH, REACH_PX, first_guess
from jaxscan.images.stripes.normal_equations import damped_step, factor, strain
from jaxscan.images.stripes.pixel_likelihood import squares_left, weigh
from jaxscan.images.stripes.windows import Lines, Outline, Pixels, Sensor, Windows, places

_STEPS: Final = 8
# How far ln s may be from the usual one: σ, no more than this, for texture makes other lines look broad or narrow.
_MOST_SPREAD: Final = 0.15
# How far β may be from what cancels most of the frame's texture: σ.
_SPREAD: Final = 1.0
# Pixels further out than the plain profile's: they show which colours the surface has.
_FURTHER_PX: Final = 4.0
# Marquardt's factor, and the longest steps: in logarithms; of β; of c, px.
_DAMPING, _LONGEST_LN, _LONGEST_BETA, _LONGEST_PX = 0.01, 0.7, 0.7, 0.7
# A stripe's light stands out by this multiple of what is known of it. What is left is at most this multiple of the
# noise, in squares, or this part of what the plain profile has taken for the stripe's height. The centre is at most
# this far from where it was looked for, px.
_STANDS, _MOST_LEFT, _MOST_OFF, _FURTHEST_PX = 5.0, 4.0, 0.05, 4.0
# A peak is looked for so near to the middle of the window; an outline is that of this peak if it is so near to it.
_NEAR_PX, _SAME_PX = 4.0, 1.5


class TexturedProfile(NamedTuple):
    """θ, for each line: b, ln A, ln s, β_M, β_N, c."""

    background: Lines
    ln_height: Lines
    ln_s: Lines
    first: Lines
    second: Lines
    centre: Lines


class Textured(NamedTuple):
    """What lines show in texture.

    Attributes:
        estimate: the centre of each stripe, `found` where there is one.
        light: the laser's light in each pixel, as the response has it.
        of_surface: lines in which texture is all that stands out.
    """

    estimate: Estimate
    light: Pixels
    of_surface: Bool[Array, "groups 1 lines"]


def fit_in_texture(windows: Windows, outline: Outline, sensor: Sensor) -> Textured:
    """Stripes in texture.

    Args:
        windows: with their colours.
        outline: where to start.
        sensor: its noise.
    """
    assert windows.colours is not None
    assert windows.own is not None
    colours, own = windows.colours, windows.own
    level, one, other = colours.channels
    # In the laser's own channel its light counts once, in the response twice.
    sensor = replace(sensor, shot=sensor.shot / 2)
    size, ln_s = level.shape[1], windows.as_seen(sensor.ln_s)
    start, used = _start(windows, outline, sensor)
    zero, loose = jnp.zeros_like(start.centre), jnp.full_like(start.centre, _SPREAD**-2)
    mean = start._replace(ln_s=zero + ln_s)
    precision = TexturedProfile(
        zero,
        zero + LN_HEIGHT_SPREAD**-2,
        zero + jnp.minimum(sensor.ln_s_spread, _MOST_SPREAD) ** -2,
        loose,
        loose,
        zero,
    )

    def modelled(theta: TexturedProfile) -> tuple[Pixels, Pixels, tuple[Pixels, ...], Windows]:
        """The ground, the stripe's light, the derivatives of both together, and the pixels with their noise."""
        height, (ones, by_height, by_s, by_centre) = pixels(
            Profile(theta.background, theta.ln_height, theta.ln_s, theta.centre), size, sensor.shape
        )
        ground = theta.background + theta.first * one + theta.second * other
        louder = colours.noise(theta.first, theta.second) / colours.quiet
        seen = replace(windows, response=level, own=replace(own, louder=louder))
        return ground, height, (ones, by_height, by_s, one, other, by_centre), seen

    def marquardt(_: int, theta: TexturedProfile) -> TexturedProfile:
        ground, height, jacobian, seen = modelled(theta)
        by = weigh(ground, height, seen, used, sensor, censored=True)
        longest = (jnp.inf, _LONGEST_LN, _LONGEST_LN / 2, _LONGEST_BETA, _LONGEST_BETA, _LONGEST_PX)
        return damped_step(theta, jacobian, by.score, by.weight, precision, mean, _DAMPING, longest)

    theta = jax.lax.fori_loop(0, _STEPS, marquardt, start)
    ground, height, jacobian, seen = modelled(theta)
    by = weigh(ground, height, seen, used, sensor, censored=True)
    misfit = squares_left(ground, height, seen, used, sensor) + strain(theta, precision, mean)
    freedom = jnp.maximum((used & ~windows.full).sum(1, keepdims=True) - len(TexturedProfile._fields), 1)
    scatter = (FREEDOM_OF_NOISE + misfit) / (FREEDOM_OF_NOISE + freedom)
    sigma = jnp.sqrt(scatter) / factor(jacobian, by.weight, precision)[-1][-1]
    # The last pivot of a factor is what is known of the last number. Where there is no stripe there is no speckle.
    alone = weigh(ground, jnp.zeros_like(height), seen, used, sensor, censored=True).weight
    without = (*jacobian[:1], *jacobian[2:], jacobian[1])
    flat = (*precision[:1], *precision[2:], zero)
    left = misfit / freedom
    stands = factor(without, alone, flat)[-1][-1] > _STANDS * jnp.sqrt(jnp.maximum(left, 1.0))
    off = jnp.sqrt((by.residual**2).sum(1, keepdims=True) / freedom)
    fits = jnp.isfinite(sigma) & ((left < _MOST_LEFT) | (off < _MOST_OFF * jnp.exp(start.ln_height)))
    found = fits & stands & (jnp.abs(theta.centre - start.centre) < _FURTHEST_PX)
    estimate = Estimate(theta.centre, sigma, FWHM * jnp.exp(windows.as_it_is(theta.ln_s)), found)
    return Textured(estimate, 2 * height, fits & ~stands)


def _start(
    windows: Windows, outline: Outline, sensor: Sensor
) -> tuple[TexturedProfile, Bool[Array, "groups window lines"]]:
    """Where to start in each line, and which pixels are used.

    Of an outline that texture has torn open only its peak counts, and the usual width.
    """
    assert windows.colours is not None
    colours = windows.colours
    level, one, other = colours.channels
    size = level.shape[1]
    plain = first_guess(windows, outline, sensor, censored=False)
    k, ln_s = places(size), jnp.zeros_like(plain.centre) + windows.as_seen(sensor.ln_s)
    # The stripe is where it was looked for, in the middle of the window: elsewhere texture may be brighter.
    near = jnp.where(jnp.abs(k - (size - 1) / 2) <= _NEAR_PX, outline.smooth, -jnp.inf)
    peak = near.argmax(1, keepdims=True).astype(k.dtype)
    whole = outline.whole & (jnp.abs(plain.centre - peak) < _SAME_PX)
    centre = jnp.where(whole, plain.centre, peak)
    ln_s = jnp.where(whole, jnp.clip(plain.ln_s, ln_s - 1, ln_s + 1), ln_s)
    stands = jnp.maximum(near.max(1, keepdims=True) - _beside(outline.smooth, centre, jnp.exp(ln_s)), 1.0)
    ln_height = jnp.where(whole, plain.ln_height, jnp.log(stands)) - jnp.log(2.0)
    used = jnp.abs(k - centre) <= (FWHM / 2 + REACH) * jnp.exp(ln_s) + REACH_PX + _FURTHER_PX
    ground = jnp.where(used, level - colours.first * one - colours.second * other, 0.0)
    background = ground.sum(1, keepdims=True) / used.sum(1, keepdims=True)
    first, second = (jnp.broadcast_to(x, background.shape) for x in (colours.first, colours.second))
    return TexturedProfile(background, ln_height, ln_s, first, second, centre), used


def _beside(smooth: Pixels, peak: Lines, s: Lines) -> Lines:
    """The brighter of a stripe's two sides."""
    size = smooth.shape[1]
    away = jnp.ceil(FWHM * s) + 1
    at = [jnp.clip(peak + by, 0, size - 1).astype(jnp.int32) for by in (-away, away)]
    before, after = (jnp.take_along_axis(smooth, each, axis=1) for each in at)
    return jnp.maximum(before, after)
