"""Lens distortion in OpenCV's meaning, and its converged inverse.

With (x, y) = (X/Z, Y/Z) and r² = x² + y² the distorted coordinates are (D. C. Brown 1966; OpenCV's `calib3d`)

    x_d = x s(r²) + 2 p1 x y + p2 (r² + 2 x²)        s(r²) = (1 + k1 r² + k2 r⁴ + k3 r⁶)
    y_d = y s(r²) + p1 (r² + 2 y²) + 2 p2 x y                / (1 + k4 r² + k5 r⁴ + k6 r⁶)

The inverse has no closed form. It is found by Newton's method, run until it stands still, and differentiated by
the implicit function theorem: from x_d = f(x, k) follows dx = f_x⁻¹ (dx_d − f_k dk), whatever the iterations did.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscan.precision import Leaf

Coefficients = tuple[Leaf, ...]

_MAX_NEWTON_STEPS = 60
# What counts as a root: a distorted coordinate met within so many times the tolerance of a Newton step.
_CLOSE = 100.0
# The invertible range is looked for up to this radius: 84 degrees from the axis.
_WIDEST_RADIUS = 10.0
_RADIUS_SAMPLES = 512


def radial_factor(radial: Coefficients, r2: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """s(r²)."""
    factor = _horner(radial[:3], r2)
    return factor / _horner(radial[3:], r2) if len(radial) > 3 else factor


def _horner(coefficients: Coefficients, r2: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """1 + c1 r² + c2 r⁴ + …."""
    total = jnp.ones_like(r2)
    if coefficients:
        tail = jnp.zeros_like(r2)
        for c in reversed(coefficients):
            tail = (tail + c) * r2
        total = total + tail
    return total


def distort(radial: Coefficients, tangential: Coefficients, x: Float[Array, "2"]) -> Float[Array, "2"]:
    """Undistorted to distorted normalised coordinates."""
    r2 = x[0] ** 2 + x[1] ** 2
    distorted = x * radial_factor(radial, r2)
    if tangential:
        p1, p2 = tangential
        xy = 2 * x[0] * x[1]
        distorted = distorted + jnp.stack([p1 * xy + p2 * (r2 + 2 * x[0] ** 2), p1 * (r2 + 2 * x[1] ** 2) + p2 * xy])
    return distorted


def undistort(radial: Coefficients, tangential: Coefficients, xd: Float[Array, "2"]) -> Float[Array, "2"]:
    """Distorted to undistorted normalised coordinates; NaN outside the invertible range of the lens."""
    if not radial and not tangential:
        return xd
    return _undistort((radial, tangential), xd)


@jax.custom_jvp
def _undistort(lens: tuple[Coefficients, Coefficients], xd: Float[Array, "2"]) -> Float[Array, "2"]:
    radial, tangential = lens
    if tangential:
        return _undistort_tangential(radial, tangential, xd)
    return xd * _radial_scale(radial, xd @ xd)


@_undistort.defjvp
def _undistort_jvp(primals: Any, tangents: Any) -> Any:
    (radial, tangential), xd = primals
    lens_dot, xd_dot = tangents
    x = _undistort((radial, tangential), xd)
    _, moved = jax.jvp(lambda radial, tangential: distort(radial, tangential, x), (radial, tangential), lens_dot)
    J = jax.jacfwd(lambda x: distort(radial, tangential, x))(x)
    return x, _solve2(J, xd_dot - moved)


def undistorted_change(
    radial: Coefficients, tangential: Coefficients, x: Float[Array, "2"], xd_dot: Float[Array, "2"]
) -> Float[Array, "2"]:
    """How undistorted coordinates x move when the distorted ones move by xd_dot: f_x⁻¹ xd_dot."""
    return _solve2(jax.jacfwd(lambda x: distort(radial, tangential, x))(x), xd_dot)


def _solve2(J: Float[Array, "2 2"], b: Float[Array, "2"]) -> Float[Array, "2"]:
    det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    return jnp.stack([J[1, 1] * b[0] - J[0, 1] * b[1], J[0, 0] * b[1] - J[1, 0] * b[0]]) / det


def invertible_radius(radial: Coefficients, dtype: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Where the distorted radius r s(r²) stops growing: the undistorted radius there, and the distorted one.

    A lens that never folds back within 84 degrees of its axis gets that radius.
    """
    r, rd = _radii(radial, dtype)
    growing = jnp.cumprod(rd[1:] > rd[:-1])
    last = growing.sum()
    # The true turn lies within one sample of the last growing one; a parabola through three samples gives its height.
    i = jnp.clip(last, 1, _RADIUS_SAMPLES - 2)
    folds = last < _RADIUS_SAMPLES - 1
    return jnp.where(folds, r[i + 1], r[-1]), jnp.where(folds, _parabola_top(r, rd, i), rd[last])


def _radii(radial: Coefficients, dtype: Any) -> tuple[Float[Array, "samples"], Float[Array, "samples"]]:
    """Undistorted radii from 0 to the widest, closer together near the axis, and the distorted ones."""
    r = jnp.linspace(0.0, _WIDEST_RADIUS, _RADIUS_SAMPLES, dtype=dtype) ** 2 / _WIDEST_RADIUS
    return r, r * radial_factor(radial, r * r)


def _parabola_top(r: Float[Array, "n"], f: Float[Array, "n"], i: Int[Array, ""]) -> Float[Array, ""]:
    """Height of the parabola through the samples i − 1, i, i + 1."""
    a, b, c = r[i - 1], r[i], r[i + 1]
    left, right = (f[i] - f[i - 1]) / (b - a), (f[i + 1] - f[i]) / (c - b)
    bend = (right - left) / (c - a)
    slope = left + bend * (b - a)
    return f[i] + jnp.where(bend < 0, slope**2 / (-4 * jnp.where(bend < 0, bend, -1.0)), 0.0)


def _radial_scale(radial: Coefficients, rd2: Float[Array, ""]) -> Float[Array, ""]:
    """The factor from distorted to undistorted coordinates of a radial lens: 1 / s(r²) at r s(r²) = r_d."""
    if not radial:
        return jnp.ones_like(rd2)
    r, _ = _invert_radius(radial, jnp.sqrt(rd2))
    return 1 / radial_factor(radial, r * r)


def _invert_radius(radial: Coefficients, rd: Float[Array, ""]) -> tuple[Float[Array, ""], Int[Array, ""]]:
    """The undistorted radius at a distorted one, NaN beyond the fold, and how many Newton steps it took."""
    r_limit, rd_limit = invertible_radius(radial, rd.dtype)
    inside = rd < rd_limit
    target = jnp.where(inside, rd, 0.0)
    tolerance = 4 * jnp.finfo(rd.dtype).eps

    def height(r: Float[Array, ""]) -> Float[Array, ""]:
        return r * radial_factor(radial, r * r)

    def newton(state: Any) -> Any:
        r, _, n, low, high = state
        value, slope = jax.jvp(height, (r,), (jnp.ones_like(r),))
        # The root is kept between bounds, and halved towards where a Newton step would leave them. Beyond the fold the
        # height falls, beyond a pole of a rational lens it is negative.
        beyond = (value > target) | (slope <= 0) | (value < 0)
        low, high = jnp.where(beyond, low, r), jnp.where(beyond, r, high)
        new = r - (value - target) / jnp.where(slope > 0, slope, 1.0)
        # At the root rounding may put a last Newton step just outside; halving would begin anew from there.
        at_root = (jnp.abs(value - target) <= tolerance * (1 + target)) & (slope > 0)
        between = (slope > 0) & (value >= 0) & (new >= low) & (new <= high)
        new = jnp.where(at_root | between, new, 0.5 * (low + high))
        return new, jnp.where(at_root, 0.0, jnp.abs(new - r)), n + 1, low, high

    start = (jnp.minimum(target, r_limit), jnp.full_like(rd, jnp.inf), 0, jnp.zeros_like(rd), r_limit)
    r, _, n, *_ = jax.lax.while_loop(
        lambda s: (s[1] > tolerance * (1 + s[0])) & (s[2] < _MAX_NEWTON_STEPS), newton, start
    )
    # The fold's height is an estimate: just beyond the true one there is no root.
    found = inside & (jnp.abs(height(r) - target) <= _CLOSE * tolerance * (1 + target))
    return jnp.where(found, r, jnp.nan), n


def _undistort_tangential(radial: Coefficients, tangential: Coefficients, xd: Float[Array, "2"]) -> Float[Array, "2"]:
    """Damped Newton in two dimensions, from the radial solution, which never leaves the branch of the centre.

    The distorted coordinates are the gradient of a potential. Where its Hessian J is positive definite around the
    centre the potential is convex, and has one such point; beyond the fold Newton's method alone would find others.
    """

    def at(x: Float[Array, "2"]) -> tuple[Float[Array, "2"], Float[Array, "2 2"], Float[Array, ""]]:
        error = distort(radial, tangential, x) - xd
        return error, jax.jacfwd(lambda x: distort(radial, tangential, x))(x), error @ error

    def on_branch(x: Float[Array, "2"], J: Float[Array, "2 2"]) -> Bool[Array, ""]:
        return (J[0, 0] > 0) & (J[0, 0] * J[1, 1] > J[0, 1] * J[1, 0]) & (x @ x <= wall**2)

    def newton(state: Any) -> Any:
        x, error, J, square, share, _, n = state
        step = -share * _solve2(J, error)
        new = x + step
        error_new, J_new, square_new = at(new)
        taken = on_branch(new, J_new) & (square_new < square)
        x, error, J, square = jax.tree.map(
            lambda a, b: jnp.where(taken, a, b), (new, error_new, J_new, square_new), (x, error, J, square)
        )
        return x, error, J, square, jnp.where(taken, 1.0, share / 4), jnp.abs(step).max(), n + 1

    _, rd_limit = invertible_radius(radial, xd.dtype)
    wall = _far_side(radial, tangential, xd.dtype)
    # A start within the fold of the radial part, from which there is a way to wherever the tangential part moves it.
    rd = jnp.sqrt(xd @ xd)
    start = xd * jnp.where(rd > 0.9 * rd_limit, 0.9 * rd_limit / rd, 1.0)
    start = start * _radial_scale(radial, start @ start)
    start = jnp.where(on_branch(start, at(start)[1]), start, 0.0)
    tolerance = 4 * jnp.finfo(xd.dtype).eps
    one = jnp.ones_like(rd)
    x, _, _, square, *_ = jax.lax.while_loop(
        lambda s: (s[5] > tolerance * (1 + jnp.abs(s[0]).max())) & (s[6] < _MAX_NEWTON_STEPS),
        newton,
        (start, *at(start), one, jnp.inf * one, 0),
    )
    return jnp.where(square <= (_CLOSE * tolerance * (1 + rd)) ** 2, x, jnp.nan)


def _far_side(radial: Coefficients, tangential: Coefficients, dtype: Any) -> Float[Array, ""]:
    """The undistorted radius beyond the fold from which the distorted one may grow again; no branch of the centre's.

    The slope of the distorted radius along a direction e is d(r s)/dr + 6 r (p2, p1) · e.
    """
    r, rd = _radii(radial, dtype)
    slope = jnp.diff(rd) / jnp.diff(r)
    folded = jnp.cumsum(slope <= 6 * r[1:] * jnp.sqrt(tangential[0] ** 2 + tangential[1] ** 2)) > 0
    again = folded[:-1] & (slope[1:] > slope[:-1])
    return jnp.where(again.any(), r[1 + jnp.argmax(again)], r[-1])
