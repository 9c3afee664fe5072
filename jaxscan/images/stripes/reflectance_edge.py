"""The maximum-likelihood fit of a stripe that an edge of the surface's reflectance runs along.

Where the reflectance changes within the stripe's width, the bright side pulls every detector that sees a bump and asks
for its middle: with 10:1 by up to 1.2 of the stripe's standard deviations. The light itself is still a Gaussian, and
its bright flank shows where its centre is. With the edge at e and the reflectances e^(±½ ln ρ) on its two sides,

    μ_k = b + A ∫ exp(−½ ((v − c) / s)²) [√ρ (1 − Φ((v − e) / τ)) + Φ((v − e) / τ) / √ρ] dv   over pixel k

θ = (b, ln A, ln s, ln ρ, e, c) is fitted as `likelihood` fits its four, by damped steps (D. Marquardt 1963), from
several places of the edge and both ways that it can face. The fit is taken where it explains the pixels so much better
than the plain profile that chance would seldom do it (the F test of two nested models), down to the sensor's noise, and
nowhere else: what has no edge is not measured better with two more unknowns. A single line's test can be weak, for only
lines are asked whose neighbours show an edge too (`evidence`).
"""

from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.classical import Estimate
from jaxscan.images.stripes.likelihood import LN_HEIGHT_SPREAD, fit
from jaxscan.images.stripes.normal_equations import damped_step, factor, least_of, strain
from jaxscan.images.stripes.pixel_likelihood import squares_left, weigh
from jaxscan.images.stripes.windows import Lines, Outline, Pixels, Sensor, Windows, places

# Gauss and Legendre's nodes and weights over a pixel.
_NODES, _WEIGHTS = (x / 2 for x in np.polynomial.legendre.leggauss(3))
# An edge is smeared by the lens: σ, px. Twice as much or none at all moves the centre by less than 0.1 s.
_SMEAR: Final = 0.3
_STEPS: Final = 12
_BELL = np.float32(1 / (_SMEAR * (2 * np.pi) ** 0.5))
# Where the edge is looked for, in s from the plain profile's centre, and what ln ρ is at the start, either way.
_PLACES, _LN_RATIO = (-1.5, 0.0, 1.5), 1.5
# The plain centre lies on the bright side: the start is moved away from it, by so much of s.
_SHIFT = 0.5
# Standard deviations of the priors: of ln ρ, and of the edge about the plain centre, in s.
_LN_RATIO_SPREAD, _EDGE_SPREAD = 2.0, 2.0
# Marquardt's factor, and the longest steps: in logarithms; of e and c, of s.
_DAMPING, _LONGEST_LN, _LONGEST = 0.02, 0.7, 0.7
# Pixels further out than the plain profile's: an edge makes it narrow.
_FURTHER_PX: Final = 2.0
# The least F with 2 and some 5 degrees of freedom: one line in seven has it by chance, of those beside an edge.
_LEAST_F: Final = 3.0
# What the edge leaves unexplained is at most this multiple of the sensor's own noise: photons and speckle leave more.
_MOST_LEFT: Final = 4.0
# Or else this part of what the plain profile leaves: speckle leaves more than the sensor does.
_MOST_UNEXPLAINED: Final = 0.3
# In place of the light's own scatter: no edge is as simple as this one, so that the brightest pixels do not decide
# alone (squared contrast).
_SPECKLE: Final = 0.1**2


class EdgeProfile(NamedTuple):
    """θ, for each line: b, ln A, ln s, ln ρ, e, c."""

    background: Lines
    ln_height: Lines
    ln_s: Lines
    ln_ratio: Lines
    edge: Lines
    centre: Lines


def fit_reflectance_edge(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """The centre of each stripe with an edge in it; `found` where there is one.

    Args:
        windows: the response.
        outline: where to start.
        sensor: its noise.
    """
    # Where an edge runs along a whole stripe, the residuals that shot noise and speckle were taken from are the edge's.
    zero = jnp.zeros_like(sensor.shot)
    sensor = replace(sensor, shot=zero, speckle=zero + _SPECKLE, grain=zero)
    plain = fit(windows, outline, sensor, censored=True, further_px=_FURTHER_PX)
    used, size = plain.used, windows.response.shape[1]
    s = jnp.exp(plain.profile.ln_s)
    zero = jnp.zeros_like(s)
    mean = EdgeProfile(zero, plain.profile.ln_height, zero + sensor.ln_s, zero, plain.profile.centre, zero)
    precision = EdgeProfile(
        zero,
        zero + LN_HEIGHT_SPREAD**-2,
        zero + sensor.ln_s_spread**-2,
        zero + _LN_RATIO_SPREAD**-2,
        (_EDGE_SPREAD * s) ** -2,
        zero,
    )

    left = partial(squares_left, windows=windows, used=used, sensor=sensor)

    def marquardt(step: int, theta: EdgeProfile) -> EdgeProfile:
        height, jacobian = _pixels(theta, size)
        seen = weigh(theta.background, height, windows, used, sensor, censored=True)
        far = _LONGEST * jnp.exp(theta.ln_s)
        longest = (jnp.inf, _LONGEST_LN, _LONGEST_LN / 2, _LONGEST_LN, far, far)
        return damped_step(theta, jacobian, seen.score, seen.weight, precision, mean, _DAMPING, longest)

    def from_start(start: jax.Array) -> tuple[EdgeProfile, Lines]:
        side, place = start
        theta = EdgeProfile(
            plain.profile.background,
            plain.profile.ln_height,
            jnp.maximum(plain.profile.ln_s, sensor.ln_s),
            zero + side * _LN_RATIO,
            plain.profile.centre + place * s,
            plain.profile.centre + side * _SHIFT * s,
        )
        theta = jax.lax.fori_loop(0, _STEPS, marquardt, theta)
        misfit = left(theta.background, _pixels(theta, size)[0]) + strain(theta, precision, mean)
        return theta, jnp.where(jnp.isfinite(misfit), misfit, jnp.inf)

    starts = jnp.asarray([(side, place) for side in (1.0, -1.0) for place in _PLACES], jnp.float32)
    theta, misfit = least_of(jax.lax.map(from_start, starts))
    height, jacobian = _pixels(theta, size)
    seen = weigh(theta.background, height, windows, used, sensor, censored=True)
    without = left(plain.profile.background, plain.height)
    freedom = jnp.maximum((used & ~windows.full).sum(1, keepdims=True) - len(EdgeProfile._fields), 1)
    f = (without - misfit) / 2 / (jnp.maximum(misfit, 1e-6) / freedom)
    sigma = jnp.sqrt(jnp.maximum(misfit / freedom, 1.0)) / factor(jacobian, seen.weight, precision)[-1][-1]
    explained = (f > _LEAST_F) & ((misfit < _MOST_LEFT * freedom) | (misfit < _MOST_UNEXPLAINED * without))
    near = jnp.abs(theta.centre - plain.profile.centre) < FWHM * jnp.exp(theta.ln_s)
    return Estimate(theta.centre, sigma, FWHM * jnp.exp(theta.ln_s), jnp.isfinite(sigma) & explained & near)


def _pixels(theta: EdgeProfile, size: int) -> tuple[Pixels, tuple[Pixels, ...]]:
    """μ − b and J of each pixel."""
    _, ln_height, ln_s, ln_ratio, edge, centre = theta
    s, bright, dark = jnp.exp(ln_s), jnp.exp(ln_ratio / 2), jnp.exp(-ln_ratio / 2)
    value = by_s = by_ratio = by_edge = by_centre = jnp.zeros((1, size, 1), jnp.float32)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        v = places(size) + np.float32(node)
        z, x = (v - centre) / s, (v - edge) / np.float32(_SMEAR)
        light = np.float32(weight) * jnp.exp(ln_height - 0.5 * z * z)
        beyond = 0.5 * (1 + jax.lax.erf(np.float32(0.5**0.5) * x))
        here, there = light * bright * (1 - beyond), light * dark * beyond
        value += here + there
        by_s += (here + there) * z * z
        by_ratio += (here - there) / 2
        by_edge += light * (bright - dark) * jnp.exp(-0.5 * x * x)
        by_centre += (here + there) * z
    return value, (jnp.ones_like(value), value, by_s, by_ratio, _BELL * by_edge, by_centre / s)
