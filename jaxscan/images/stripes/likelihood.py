"""The maximum-likelihood fit of a stripe's profile.

The profile is a bell over pixels, μ_k = b + A P_k (`bell`). With g and w the score and the information of each pixel's
likelihood (`pixel_likelihood`), θ = (b, ln A, ln s, c) is refined by Newton's steps, J = ∂μ / ∂θ, v as it stands,

    (Jᵀ diag(w) J + Λ) Δθ = Jᵀ g − Λ (θ − θ₀)

The weights Λ are those of a prior. That of s is what the other lines of the photograph say, that of A a factor of e²
either way about the start: they decide what the pixels leave open, where the whole core is full. The last pivot of the
Cholesky factor, c being last, is 1 / σ_c with the other three unknown.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxscan.images.stripes.bell import FWHM, Profile, hermite, pixels
from jaxscan.images.stripes.classical import Estimate
from jaxscan.images.stripes.grain import innovations
from jaxscan.images.stripes.normal_equations import factor, gradient, solve
from jaxscan.images.stripes.pixel_likelihood import Weighed, in_stray_light, is_beside, stray_from, weigh, weigh_cut
from jaxscan.images.stripes.windows import Lines, Outline, Pixels, Sensor, Windows, places

# Newton's steps: from the outline of an unsaturated stripe two reach the minimum to a hundredth of σ.
_STEPS, STEPS_CENSORED = 2, 8
# Of a stripe that is burnt out most lines reach it in this number, and the others are fitted once more.
FEW_STEPS_CENSORED = 4
# With correlated speckle this number of steps follows: one comes within 0.04 σ of the minimum from there.
_STEPS_GRAINED, _STEPS_GRAINED_CENSORED = 1, 3
# The model holds around the stripe, not for the rest of the window: up to this number of standard deviations, plus
# pixels, beyond the point where it falls to half its seen height. Pixels further out hold 1 % of the information on
# the centre.
REACH, REACH_PX, _REACH_ROUGH = 1.3, 2.0, 3.0
LN_HEIGHT_SPREAD = 2.0
# Squared contrast of speckle that makes a stripe ragged.
ROUGH = 0.3**2
# A step in c, of s, and in ln s and ln A, after which another one would lead nowhere.
_ARRIVED = 0.01
# The longest step: in c, of s; in the logarithms.
_LONGEST = 0.7
_HALF_MAXIMUM = 5.545177  # 8 ln 2
_PIXEL_VARIANCE = 1 / 12
_LEAST_S, _MOST_OVER = 0.35, 100.0
# The fit's own scatter is weighted against this number of degrees of freedom of the sensor's noise.
FREEDOM_OF_NOISE = 10.0
# Pixels are strained if the RMS residual exceeds `_STRAIN` times the noise and this part of the peak together.
_USUAL_MISFIT, _STRAIN = 0.03, 1.5
# With other light out of the way, what is left is noise up to this multiple of its squares' own scatter.
_CHANCE = 3.0
_LEAST_WEIGHT = 1e-12
# Other light is found from this multiple of L on.
_FOUND = 2.0


class Fit(NamedTuple):
    """A profile and the quantities that show how well it is known.

    Attributes:
        profile: θ.
        height: A P of each pixel, before the last step, as are those that follow but for the residual.
        jacobian: J of each pixel.
        weight: w of each pixel; 0 of those beyond the model's reach.
        residual: y − μ of each free pixel, 0 of the others.
        standard: the same as independent numbers of unit variance.
        used: which pixels are within the model's reach.
        free: which of these are not full, nor in other light.
        factor: the Cholesky factor, row by row.
        inverse_sigma: 1 / σ of the centre, where the last step has led.
        moved_by: how far the last step has led: the greatest of its parts in c, of s, and in ln s and ln A.
    """

    profile: Profile
    height: Pixels
    jacobian: tuple[Pixels, ...]
    weight: Pixels
    residual: Pixels
    standard: Pixels
    used: Bool[Array, "groups window lines"]
    free: Bool[Array, "groups window lines"]
    factor: list[list[Lines]]
    inverse_sigma: Lines
    moved_by: Lines


class Misfit(NamedTuple):
    """What a fitted profile leaves, for each line.

    Attributes:
        strained: whether it is off by more than noise.
        h3: the third Gauss-Hermite coefficient of the residual, in parts of the height.
        h4: the fourth.
        ln_light: ln of A s: of all its light, but for a factor.
        settled: whether more steps would change nothing.
        stray: whether a pixel beside the stripe is off by more than noise makes it.
    """

    strained: Bool[Array, "groups 1 lines"]
    h3: Lines
    h4: Lines
    ln_light: Lines
    settled: Bool[Array, "groups 1 lines"]
    stray: Bool[Array, "groups 1 lines"]


def likelihood(
    windows: Windows,
    outline: Outline,
    sensor: Sensor,
    censored: bool,
    grained: bool = False,
    stray: bool = False,
    steps: int | Array | None = None,
) -> tuple[Estimate, Misfit]:
    """The maximum-likelihood centre of each stripe, and what its profile leaves.

    σ is that of the fit, scaled by how the line's own residuals compare with the sensor's noise: a profile that is not
    the model's is known less well.

    Args:
        windows: the response.
        outline: where to start.
        sensor: its noise.
        censored: whether there are full pixels.
        grained: whether speckle goes on from pixel to pixel.
        stray: whether other light falls beside the stripe.
        steps: the most of Newton's steps with independent pixels.
    """
    more = _STEPS_GRAINED_CENSORED if censored else _STEPS_GRAINED
    found = fit(windows, outline, sensor, censored, steps, grain_steps=more if grained else 0, stray=stray)
    squares = (found.standard**2).sum(1, keepdims=True)
    freedom = jnp.maximum(found.free.sum(1, keepdims=True) - len(Profile._fields), 0)
    scatter = (FREEDOM_OF_NOISE + squares) / (FREEDOM_OF_NOISE + freedom)
    if stray:
        other = (found.used & ~(found.free | windows.full)).sum(1, keepdims=True)
        # Twice the integral of their pull, r / v up to L and L⁴ v / r³ beyond, is 2 L² of pixels that are far off.
        more = jnp.where(other > 0, 2 * other * stray_from(sensor) ** 2, 0.0)
        scatter = (FREEDOM_OF_NOISE + squares + more) / (FREEDOM_OF_NOISE + freedom + other)
    sigma = jnp.sqrt(scatter) / found.inverse_sigma
    profile = found.profile
    within = (profile.centre > outline.start) & (profile.centre < outline.end)
    if stray:
        strained = squares > freedom + _CHANCE * jnp.sqrt(2 * freedom)
    else:
        # The shot noise is itself taken from residuals, so it is not asked here.
        usual = windows.read2(sensor) + (_USUAL_MISFIT * (outline.top - outline.floor)) ** 2
        strained = (found.residual**2).sum(1, keepdims=True) > _STRAIN**2 * usual * jnp.maximum(freedom, 1)
    width = FWHM * jnp.exp(windows.as_it_is(profile.ln_s))
    estimate = Estimate(profile.centre, sigma, width, jnp.isfinite(sigma) & within)
    light, settled = profile.ln_height + profile.ln_s, found.moved_by < _ARRIVED
    off = off_beside(found.standard**2, found, outline) > _FOUND * stray_from(sensor)
    return estimate, Misfit(strained, *_gauss_hermite(profile, found.residual), light, settled, off)


def off_beside(squares: Pixels, found: Fit, outline: Outline) -> Lines:
    """How far the worst pixel beside each stripe is off, in parts of its noise; 0 where none is seen.

    Args:
        squares: of what a fit leaves, over the variance of the noise.
        found: the fit.
        outline: of the stripe.
    """
    beside = found.free & is_beside(found.height, outline)
    return jnp.sqrt(jnp.where(beside, squares, 0.0).max(1, keepdims=True))


def _gauss_hermite(profile: Profile, residual: Pixels) -> tuple[Lines, Lines]:
    """h₃ and h₄ of a residual: its projections on the Hermite polynomials He₃ and He₄ times the Gaussian."""
    z = (places(residual.shape[1]) - profile.centre) / jnp.exp(profile.ln_s)
    bell = residual * jnp.exp(-0.5 * z * z - profile.ln_height - profile.ln_s)
    *_, He3, He4 = hermite(z, 4)
    return (bell * He3).sum(1, keepdims=True), (bell * He4).sum(1, keepdims=True)


def fit(
    windows: Windows,
    outline: Outline,
    sensor: Sensor,
    censored: bool,
    steps: int | Array | None = None,
    further_px: float = 0.0,
    grain_steps: int = 0,
    stray: bool = False,
) -> Fit:
    """The profile that makes the pixels likeliest.

    Args:
        windows: the response.
        outline: where to start.
        sensor: its noise.
        censored: whether there are full pixels.
        steps: how many of Newton's steps are taken with independent pixels.
        further_px: how much further out than usual pixels are used.
        grain_steps: how many steps follow with pixels whose speckle is correlated.
        stray: whether other light falls beside the stripe.
    """
    sensor = replace(sensor, ln_s=windows.as_seen(sensor.ln_s))
    start = first_guess(windows, outline, sensor, censored)
    reach = outline.width / 2 + REACH * jnp.exp(start.ln_s) + REACH_PX + further_px
    # A dark grain splits a stripe, so that its outline shows little. And the light's tails determine the centre as
    # well as its flanks do, down to the sensor's noise.
    rough = (sensor.speckle > ROUGH) & (sensor.ln_s_spread < 1)
    start = start._replace(ln_s=jnp.where(rough, sensor.ln_s, start.ln_s))
    reach = jnp.where(rough, jnp.maximum(reach, _REACH_ROUGH * jnp.exp(sensor.ln_s) + REACH_PX), reach)
    mean = start._replace(ln_s=sensor.ln_s)
    precision = Profile(*(jnp.zeros(()), jnp.asarray(LN_HEIGHT_SPREAD**-2), sensor.ln_s_spread**-2, jnp.zeros(())))
    used = jnp.abs(places(windows.response.shape[1]) - start.centre) <= reach

    cut = windows.cut if censored else None
    free = used & ~windows.full if censored else used
    if cut is not None:
        free |= used & cut.lines

    def step(profile: Profile, grain: bool) -> Fit:
        height, jacobian = pixels(profile, windows.response.shape[1], sensor.shape)
        seen = weigh(profile.background, height, windows, used, sensor, censored)
        own = free
        if stray:
            seen, other = in_stray_light(seen, height, outline, sensor, profile.centre)
            own = free & ~other
        if cut is not None:
            jacobian, as_number = weigh_cut(profile.background, height, jacobian, windows.response, cut, used, sensor)
            seen = jax.tree.map(partial(jnp.where, cut.lines), as_number, seen)
        if grain:
            *basis, score = _independent(jacobian, height, seen, free, sensor, windows.gain)
            weight = jnp.ones_like(score)
        else:
            basis, score, weight = jacobian, seen.score, seen.weight
        L = factor(basis, weight, precision)
        newton = solve(L, gradient(basis, score, precision, profile, mean))
        longest = (jnp.inf, 2 * _LONGEST, _LONGEST, _LONGEST * jnp.exp(profile.ln_s))
        change = [jnp.clip(by, -most, most) for by, most in zip(newton, longest, strict=True)]
        moved = Profile(*(now + by for now, by in zip(profile, change, strict=True)))
        # To first order, which spares an evaluation: of two steps it is a third of the work.
        left = seen.residual - sum(J * by for J, by in zip(jacobian, change, strict=True))
        if grain:
            standard = score - sum(J * by for J, by in zip(basis, change, strict=True))
        else:
            standard = jnp.sqrt(seen.weight) * left
        # In even noise σ_c goes as √s / A.
        inverse_sigma = L[-1][-1] * jnp.exp(change[1] - change[2] / 2)
        left, standard = (jnp.where(own, value, 0.0) for value in (left, standard))
        by = jnp.abs(change[-1]) / jnp.exp(profile.ln_s)
        for part in change[1:-1]:
            by = jnp.maximum(by, jnp.abs(part))
        return Fit(moved, height, jacobian, seen.weight, left, standard, used, own, L, inverse_sigma, by)

    if steps is None:
        steps = STEPS_CENSORED if censored else _STEPS
    # The last step, of either kind, shows how well the profile is known.
    plain, grained = (steps, grain_steps - 1) if grain_steps else (steps - 1, 0)

    def moved(state: tuple[Array, Profile, Lines]) -> tuple[Array, Profile, Lines]:
        taken, now, far = state
        found = step(now, False)
        # A line that has arrived stays, whatever the others that are looked at with it.
        then = jax.tree.map(partial(jnp.where, far), found.profile, now)
        return taken + 1, then, far & ~(found.moved_by < _ARRIVED)

    everywhere = jnp.ones(start.centre.shape, bool)
    _, profile, _ = jax.lax.while_loop(
        lambda state: (state[0] < plain) & state[2].any(), moved, (jnp.asarray(0), start, everywhere)
    )
    if grained:
        profile = jax.lax.fori_loop(0, grained, lambda _, profile: step(profile, True).profile, profile)
    return step(profile, grain_steps > 0)


def _independent(
    jacobian: Sequence[Pixels],
    height: Pixels,
    seen: Weighed,
    free: Bool[Array, "groups window lines"],
    sensor: Sensor,
    gain: Pixels | None,
) -> list[Pixels]:
    """J and the residual as independent numbers of unit variance.

    A full pixel has no speckle of its own: it is a datum of the variance 1 / w that is off by g / w.
    """
    weight = jnp.maximum(seen.weight, _LEAST_WEIGHT)
    light = jnp.where(free, jnp.maximum(height, 0.0), 0.0)
    if gain is not None:
        light = light * jnp.sqrt(gain)
    used = jnp.where(seen.weight > 0, 1.0, 0.0)
    own = jnp.where(free, 1 / weight - sensor.speckle * light**2, 1 / weight)
    return innovations([*jacobian, seen.score / weight], light, own, used, sensor.speckle, sensor.grain)


def first_guess(windows: Windows, outline: Outline, sensor: Sensor, censored: bool) -> Profile:
    """θ₀ from the outline: a Gaussian's width at two heights determines s and A.

    Of a full stripe these are the width d₁ of its full core, at the height z, and d₂ at z / 2: d₂² − d₁² = 8 ln 2 s²,
    which is weighted against the estimate of s from the other lines, and A = z e^(d₁² / 8 s²).
    """
    z = outline.top - outline.floor
    s2 = outline.width**2 / _HALF_MAXIMUM
    # What smoothing and pixel took from the peak.
    A = z * jnp.sqrt(1 + 1 / s2)
    if censored:
        core2 = windows.full.sum(1, keepdims=True).astype(jnp.float32) ** 2
        own = jnp.maximum((outline.width**2 - core2) / _HALF_MAXIMUM, _LEAST_S**2)
        # An end that is off by a pixel turns ln s by so much.
        spread = outline.width / (_HALF_MAXIMUM * own)
        share = sensor.ln_s_spread**2 / (sensor.ln_s_spread**2 + spread**2)
        burnt2 = jnp.exp(2 * (1 - share) * sensor.ln_s) * own**share
        burnt = core2 > 0
        A = jnp.where(burnt, z * jnp.exp(jnp.minimum(core2 / (8 * burnt2), jnp.log(_MOST_OVER))), A)
        s2 = jnp.where(burnt, burnt2 + _PIXEL_VARIANCE, s2)
    s2 = jnp.maximum(s2 - _PIXEL_VARIANCE, _LEAST_S**2)
    return Profile(outline.floor, jnp.log(jnp.maximum(A, 1.0)), 0.5 * jnp.log(s2), outline.middle)
