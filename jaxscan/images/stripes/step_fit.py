"""The maximum-likelihood fit of a stripe beside which the light of the room has a step.

The silhouette of an object, or the edge of a shadow, lies along the stripe: on one of its sides a grey photograph is
brighter. A profile on an even background takes a part of the step for the stripe's own light, and is drawn towards it.
With a step of height h at e, smeared by the lens (σ of τ px),

    μ_k = b + A P_k(c, s) + h Φ((k − e) / τ)

θ = (b, ln A, ln s, h, e, c) is fitted as `reflectance_edge` fits its six numbers, from several places of the step. The
fit is taken where it explains the pixels so much better than the even background that chance would seldom do it (the F
test of two nested models), down to the noise.
"""

from functools import partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.images.stripes.bell import FWHM, Profile, pixels
from jaxscan.images.stripes.classical import Estimate
from jaxscan.images.stripes.likelihood import FREEDOM_OF_NOISE, LN_HEIGHT_SPREAD, fit
from jaxscan.images.stripes.normal_equations import damped_step, factor, least_of, strain
from jaxscan.images.stripes.pixel_likelihood import squares_left, weigh
from jaxscan.images.stripes.windows import Lines, Outline, Pixels, Sensor, Windows, places

# How far a step is smeared by lens and pixel: σ, px.
_SMEAR: Final = 0.7
_BELL: Final = np.float32(1 / (_SMEAR * (2 * np.pi) ** 0.5))
_STEPS: Final = 12
# Where the step is looked for, px from the peak; pixels at either end of the window that show its height.
_PLACES: Final = (-6.0, -4.0, -2.5, -1.0, 1.0, 2.5, 4.0, 6.0)
_ENDS: Final = 4
# Marquardt's factor, and the longest steps: in logarithms; of e and c, px.
_DAMPING, _LONGEST_LN, _LONGEST_PX = 0.02, 0.7, 1.0
# Pixels further out than the plain profile's: they show how high the step is.
_FURTHER_PX: Final = 4.0
# The least F with 2 and some degrees of freedom; what is left is at most this multiple of the noise.
_LEAST_F, _MOST_LEFT = 6.0, 4.0


class StepProfile(NamedTuple):
    """θ, for each line: b, ln A, ln s, h, e, c."""

    background: Lines
    ln_height: Lines
    ln_s: Lines
    step: Lines
    edge: Lines
    centre: Lines


def uneven(windows: Windows, sensor: Sensor) -> Lines:
    """How much brighter the window's one end is than its other one, over the noise of that."""
    r = windows.response
    differ = r[:, -_ENDS:].mean(1, keepdims=True) - r[:, :_ENDS].mean(1, keepdims=True)
    return differ / (jnp.sqrt(windows.read2(sensor)) * np.float32((2 / _ENDS) ** 0.5))


def fit_beside_a_step(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """The centre of each stripe beside a step; `found` where there is one.

    Args:
        windows: the response.
        outline: where to start.
        sensor: its noise.
    """
    plain = fit(windows, outline, sensor, censored=True, further_px=_FURTHER_PX)
    r, size = windows.response, windows.response.shape[1]
    ln_s = windows.as_seen(sensor.ln_s)
    zero = jnp.zeros_like(plain.profile.centre)
    s = jnp.exp(zero + ln_s)
    low, high = (x.mean(1, keepdims=True) for x in (r[:, :_ENDS], r[:, -_ENDS:]))
    peak = outline.at.astype(r.dtype)
    used = jnp.abs(places(size) - peak) <= FWHM / 2 * s + 4 * s + 2 + _FURTHER_PX
    mean = StepProfile(zero, plain.profile.ln_height, zero + ln_s, zero, zero, zero)
    precision = StepProfile(zero, zero + LN_HEIGHT_SPREAD**-2, zero + sensor.ln_s_spread**-2, zero, zero, zero)

    left = partial(squares_left, windows=windows, used=used, sensor=sensor)

    def modelled(theta: StepProfile) -> tuple[Pixels, Pixels, tuple[Pixels, ...]]:
        """The background with its step, the stripe's light, and the derivatives of both together."""
        x = (places(size) - theta.edge) / np.float32(_SMEAR)
        beyond = 0.5 * (1 + jax.lax.erf(np.float32(0.5**0.5) * x))
        height, (one, by_height, by_s, by_centre) = pixels(
            Profile(theta.background, theta.ln_height, theta.ln_s, theta.centre), size, sensor.shape
        )
        by_edge = -theta.step * _BELL * jnp.exp(-0.5 * x * x)
        return theta.background + theta.step * beyond, height, (one, by_height, by_s, beyond, by_edge, by_centre)

    def marquardt(_: int, theta: StepProfile) -> StepProfile:
        ground, height, jacobian = modelled(theta)
        seen = weigh(ground, height, windows, used, sensor, censored=True)
        longest = (jnp.inf, _LONGEST_LN, _LONGEST_LN / 2, jnp.inf, _LONGEST_PX, _LONGEST_PX)
        return damped_step(theta, jacobian, seen.score, seen.weight, precision, mean, _DAMPING, longest)

    def from_start(place: jax.Array) -> tuple[StepProfile, Lines]:
        ground = jnp.where(place > 0, low, high)
        theta = StepProfile(
            zero + low,
            jnp.log(jnp.maximum(outline.top - ground, 1.0)),
            zero + ln_s,
            high - low,
            peak + place,
            peak,
        )
        theta = jax.lax.fori_loop(0, _STEPS, marquardt, theta)
        ground, height, _ = modelled(theta)
        misfit = left(ground, height) + strain(theta, precision, mean)
        inside = (theta.edge > -0.5) & (theta.edge < size - 0.5) & (jnp.abs(theta.centre - peak) < FWHM * s + 1)
        return theta, jnp.where(jnp.isfinite(misfit) & inside, misfit, jnp.inf)

    theta, misfit = least_of(jax.lax.map(from_start, jnp.asarray(_PLACES, jnp.float32)))
    ground, height, jacobian = modelled(theta)
    seen = weigh(ground, height, windows, used, sensor, censored=True)
    without = left(plain.profile.background, plain.height)
    freedom = jnp.maximum((used & ~windows.full).sum(1, keepdims=True) - len(StepProfile._fields), 1)
    f = (without - misfit) / 2 / (jnp.maximum(misfit, 1e-6) / freedom)
    scatter = (FREEDOM_OF_NOISE + misfit) / (FREEDOM_OF_NOISE + freedom)
    sigma = jnp.sqrt(scatter) / factor(jacobian, seen.weight, precision)[-1][-1]
    found = jnp.isfinite(sigma) & jnp.isfinite(misfit) & (f > _LEAST_F) & (misfit < _MOST_LEFT * freedom)
    return Estimate(theta.centre, sigma, FWHM * jnp.exp(windows.as_it_is(theta.ln_s)), found)
