"""What each pixel of a stripe says of its mean μ: the score of its likelihood and its information.

A pixel reads y_k = μ_k + noise of variance v_k = read² + shot · A P_k (`bell`), unless it is full: then all that is
known is y_k ≥ z_k, and its likelihood is that of a censored datum, Φ(t_k) with t_k = (μ_k − z_k) / √v_k (J. Tobin
1958). With q = φ / Φ, the inverse Mills ratio, score and information of μ are

    (y − μ) / v,  1 / v               q(t) / √v,  q (q + t) / v       of a full pixel

In a JPEG's burnt-out lines full pixels are numbers as the others are (`Cut`), y = min(μ, F) + error, with F where they
were cut off: the minimum is taken as its mean over a small scatter τ of μ, t = (F − μ) / τ,

    μ Φ(t) + F Φ(−t) − τ φ(t),    of the derivative Φ(t)

Where other light falls beside the stripe (`stray_light`), pixels there that are off by more than L times their noise
count with the variance v (r² / L² v)², r = y − μ, so that their pull goes as 1 / r³; and as much light may lie under
the stripe as half of that, so that the variance of all pixels on their side of c is greater by ¼ ⟨r²⟩ of them.
"""

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxscan.images.stripes.windows import SOFT_GAIN, Cut, Lines, Outline, Pixels, Sensor, Windows, places

_ROOT_HALF, _ROOT_2_OVER_PI, _ROOT_2_PI = 0.70710678, 0.79788456, 2.5066283
# Of a pixel that was cut off τ, and the least σ of what a JPEG leaves in a burnt-out line, in parts of a full pixel.
_SOFT_CUT, _LEFT_BY_JPEG = 0.05, 0.008
# Pixels below this part of the stripe's seen height are beside it.
_BESIDE: Final = 0.3
# L is no less than this.
_LEAST_L: Final = 1.5
# Under the stripe other light is this part of what is seen of it beside the stripe.
_UNDER: Final = 0.5
# Φ of less is 1e-9: there float32 has few digits of it left.
_LEAST_T = -6.0


class Weighed(NamedTuple):
    """What each pixel says of μ; 0 of those that are not used, and the residual of full ones too.

    Attributes:
        score: derivative of its log-likelihood by μ.
        weight: its information.
        residual: y − μ.
    """

    score: Pixels
    weight: Pixels
    residual: Pixels


def weigh(
    background: Lines,
    height: Pixels,
    windows: Windows,
    used: Bool[Array, "groups window lines"],
    sensor: Sensor,
    censored: bool,
) -> Weighed:
    """Compare μ = background + height with the pixels."""
    v = windows.variance(height, sensor)
    residual = windows.response - background - height
    score, weight = residual / v, 1 / v
    if censored:
        t = jnp.maximum(-residual / jnp.sqrt(v), _LEAST_T)
        q = _ROOT_2_OVER_PI * jnp.exp(-0.5 * t * t) / jax.lax.erfc(-_ROOT_HALF * t)
        score = jnp.where(windows.full, q / jnp.sqrt(v), score)
        weight = jnp.where(windows.full, q * (q + t) / v, weight)
        residual = jnp.where(windows.full, 0.0, residual)
    return Weighed(*(jnp.where(used, value, 0.0) for value in (score, weight, residual)))


def squares_left(
    background: Pixels | Lines,
    height: Pixels,
    windows: Windows,
    used: Bool[Array, "groups window lines"],
    sensor: Sensor,
) -> Lines:
    """The squares of what is left, in units of the noise; a full pixel counts where it ought not to be full."""
    residual = windows.response - background - height
    residual = jnp.where(windows.full, jnp.maximum(residual, 0.0), residual)
    return jnp.where(used, residual**2 / windows.variance(height, sensor), 0.0).sum(1, keepdims=True)


def in_stray_light(
    seen: Weighed, height: Pixels, outline: Outline, sensor: Sensor, centre: Lines
) -> tuple[Weighed, Bool[Array, "groups window lines"]]:
    """The same with little weight of those pixels beside the stripe that other light reaches, and which these are.

    Under the stripe such light is not seen: pixels on the same side of the centre have less weight too.
    """
    beyond = seen.residual**2 * seen.weight / stray_from(sensor) ** 2
    other = is_beside(height, outline) & (beyond > 1)
    left = places(height.shape[1]) < centre
    hidden2 = sum(jnp.where(side, _UNDER**2 * _mean(seen.residual**2, other & side), 0.0) for side in (left, ~left))
    by = jnp.where(other, beyond**-2, 1.0) / (1 + hidden2 * seen.weight)
    return seen._replace(score=by * seen.score, weight=by * seen.weight), other


def _mean(values: Pixels, where: Bool[Array, "groups window lines"]) -> Lines:
    """Of some pixels of each line; 0 of none."""
    return jnp.where(where, values, 0.0).sum(1, keepdims=True) / jnp.maximum(where.sum(1, keepdims=True), 1)


def weigh_cut(
    background: Lines,
    height: Pixels,
    jacobian: tuple[Pixels, ...],
    response: Pixels,
    cut: Cut,
    used: Bool[Array, "groups window lines"],
    sensor: Sensor,
) -> tuple[tuple[Pixels, ...], Weighed]:
    """J, in lines that are cut off of what they show, and the comparison of min(μ, F) with their pixels.

    What a JPEG leaves is alike in all pixels of the stripe, and hides photons' noise and speckle: all have one weight.
    """
    mu, tau = background + height, _SOFT_CUT * sensor.span
    t = (cut.ceiling - mu) / tau
    share = 0.5 * jax.lax.erfc(-_ROOT_HALF * t)
    shown = mu * share + cut.ceiling * (1 - share) - tau / _ROOT_2_PI * jnp.exp(-0.5 * t * t)
    slopes = tuple(jnp.where(cut.lines, cut.smoothed(J * share), J) for J in jacobian)
    residual = response - cut.smoothed(shown)
    v = SOFT_GAIN * jnp.maximum(sensor.read, _LEFT_BY_JPEG * sensor.span) ** 2
    return slopes, Weighed(*(jnp.where(used, x, 0.0) for x in (residual / v, 1 / v, residual)))


def is_beside(height: Pixels, outline: Outline) -> Bool[Array, "groups window lines"]:
    """Which pixels are beside the stripe, by its A P."""
    return height < _BESIDE * (outline.top - outline.floor)


def stray_from(sensor: Sensor) -> Lines:
    """L of each line: what the worst pixel beside the stripe is usually off by; ∞ where that is not known."""
    return jnp.where(sensor.off_beside > 0, jnp.maximum(_LEAST_L, sensor.off_beside), jnp.inf)
