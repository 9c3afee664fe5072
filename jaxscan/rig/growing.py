"""The inverse of a height that grows from 0 up to where it turns: the distorted radius of a lens by the undistorted."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

# A function of one number, or of many at once.
Height = Callable[[Float[Array, "*any"]], Float[Array, "*any"]]

_MAX_NEWTON_STEPS = 60
# A root is accepted if the height is met within this multiple of the tolerance of a Newton step.
CLOSE = 100.0
_SAMPLES = 512


def turning_point(height: Height, widest: float, dtype: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Where the height stops growing, and how high it is there; `widest` where it never does before.

    Args:
        height: 0 at 0, and growing from there.
        widest: how far it is looked at.
        dtype: of the numbers.
    """
    r, h = samples(height, widest, dtype)
    last = jnp.argmin(jnp.append(h[1:] > h[:-1], False))
    # The true turn lies within one sample of the last growing one; a parabola through three samples gives its height.
    i = jnp.clip(last, 1, _SAMPLES - 2)
    turns = last < _SAMPLES - 1
    return jnp.where(turns, r[i + 1], r[-1]), jnp.where(turns, _parabola_top(r, h, i), h[last])


def samples(height: Height, widest: float, dtype: Any) -> tuple[Float[Array, "samples"], Float[Array, "samples"]]:
    """Places from 0 to the widest, closer together near 0, and the heights there."""
    r = jnp.linspace(0.0, widest, _SAMPLES, dtype=dtype) ** 2 / widest
    return r, height(r)


def _parabola_top(r: Float[Array, "n"], f: Float[Array, "n"], i: Int[Array, ""]) -> Float[Array, ""]:
    """Height of the parabola through the samples i − 1, i, i + 1."""
    a, b, c = r[i - 1], r[i], r[i + 1]
    left, right = (f[i] - f[i - 1]) / (b - a), (f[i + 1] - f[i]) / (c - b)
    bend = (right - left) / (c - a)
    slope = left + bend * (b - a)
    return f[i] + jnp.where(bend < 0, slope**2 / (-4 * jnp.where(bend < 0, bend, -1.0)), 0.0)


def inverse(height: Height, widest: float, at: Float[Array, ""]) -> Float[Array, ""]:
    """The place before the turning point at which the height is this; NaN where there is none.

    Args:
        height: 0 at 0, and growing from there.
        widest: how far it is looked at.
        at: the height, not negative.
    """
    return inverse_and_steps(height, widest, at)[0]


def inverse_and_steps(height: Height, widest: float, at: Float[Array, ""]) -> tuple[Float[Array, ""], Int[Array, ""]]:
    """What `inverse` gives, and how many Newton steps it took."""
    r_limit, limit = turning_point(height, widest, at.dtype)
    inside = at < limit
    target = jnp.where(inside, at, 0.0)
    tolerance = 4 * jnp.finfo(at.dtype).eps

    def newton(state: Any) -> Any:
        r, _, n, low, high = state
        value, slope = jax.jvp(height, (r,), (jnp.ones_like(r),))
        # The root is kept between bounds, and halved towards where a Newton step would leave them. Beyond the turning
        # point the height falls, beyond a pole of a rational lens it is negative.
        beyond = (value > target) | (slope <= 0) | (value < 0)
        low, high = jnp.where(beyond, low, r), jnp.where(beyond, r, high)
        new = r - (value - target) / jnp.where(slope > 0, slope, 1.0)
        # At the root rounding may put a last Newton step just outside; halving would begin again from there.
        at_root = (jnp.abs(value - target) <= tolerance * (1 + target)) & (slope > 0)
        between = (slope > 0) & (value >= 0) & (new >= low) & (new <= high)
        new = jnp.where(at_root | between, new, 0.5 * (low + high))
        return new, jnp.where(at_root, 0.0, jnp.abs(new - r)), n + 1, low, high

    start = (jnp.minimum(target, r_limit), jnp.full_like(at, jnp.inf), 0, jnp.zeros_like(at), r_limit)
    r, _, n, *_ = jax.lax.while_loop(
        lambda s: (s[1] > tolerance * (1 + s[0])) & (s[2] < _MAX_NEWTON_STEPS), newton, start
    )
    # The turning point's height is an estimate: just beyond the true one there is no root.
    found = inside & (jnp.abs(height(r) - target) <= CLOSE * tolerance * (1 + target))
    return jnp.where(found, r, jnp.nan), n
