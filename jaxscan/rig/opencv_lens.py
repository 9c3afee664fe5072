"""Lens distortion in OpenCV's meaning, its converged inverse, and the ladder of lenses that have some of its terms.

With (x, y) = (X/Z, Y/Z) and r² = x² + y² the distorted coordinates are (D. C. Brown 1966; OpenCV's `calib3d`)

    x_d = x s(r²) + 2 p1 x y + p2 (r² + 2 x²)        s(r²) = (1 + k1 r² + k2 r⁴ + k3 r⁶)
    y_d = y s(r²) + p1 (r² + 2 y²) + 2 p2 x y                / (1 + k4 r² + k5 r⁴ + k6 r⁶)

The inverse has no closed form. It is found by Newton's method, run until it stands still.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscan.kept_programs import compiled
from jaxscan.precision import Leaf
from jaxscan.rig import growing
from jaxscan.rig.lens import solve2
from jaxscan.rig.readable import Readable

Coefficients = tuple[Leaf, ...]

_MAX_NEWTON_STEPS = 60
# The invertible range is looked for up to this radius: 84 degrees from the axis.
_WIDEST_RADIUS = 10.0


class OpenCVLens(Readable):
    """Some of OpenCV's terms. Every coefficient is a leaf of its own, so that each can be held or freed.

    Attributes:
        radial: k1, k2, k3, k4, k5, k6 as far as the lens goes.
        tangential: p1, p2, or nothing.
    """

    kind: ClassVar[str]
    numbers: ClassVar[Mapping[str, int]]
    pinhole: ClassVar[bool] = True

    radial: Coefficients
    tangential: Coefficients

    @classmethod
    def nominal(cls) -> "OpenCVLens":
        """All coefficients 0."""
        return cls(*(tuple(jnp.zeros(()) for _ in range(count)) for count in cls.numbers.values()))

    def distort(self, x: Float[Array, "2"]) -> Float[Array, "2"]:
        """Undistorted to distorted normalised coordinates."""
        return distort(self.radial, self.tangential, x)

    def undistort(self, xd: Float[Array, "2"]) -> Float[Array, "2"]:
        """Distorted to undistorted normalised coordinates."""
        return undistort(self.radial, self.tangential, xd)

    def invertible_radius(self, dtype: Any) -> Float[Array, ""]:
        """The largest undistorted radius up to which the radial terms can be inverted."""
        return invertible_radius(self.radial, dtype)[0]

    def rational(self) -> "Rational":
        """The same lens with all of OpenCV's terms, those that it lacks zero."""
        zero = jnp.zeros(())
        most, most_tangential = Rational.numbers.values()
        radial = self.radial + (zero,) * (most - len(self.radial))
        return Rational(radial, self.tangential + (zero,) * (most_tangential - len(self.tangential)))


class Undistorted(OpenCVLens):
    """No coefficients."""

    kind: ClassVar[str] = "none"
    numbers: ClassVar[Mapping[str, int]] = {"radial": 0, "tangential": 0}


class Radial1(OpenCVLens):
    """k1."""

    kind: ClassVar[str] = "radial1"
    numbers: ClassVar[Mapping[str, int]] = {"radial": 1, "tangential": 0}


class Radial2(OpenCVLens):
    """k1, k2."""

    kind: ClassVar[str] = "radial2"
    numbers: ClassVar[Mapping[str, int]] = {"radial": 2, "tangential": 0}


class Radial3(OpenCVLens):
    """k1, k2, k3."""

    kind: ClassVar[str] = "radial3"
    numbers: ClassVar[Mapping[str, int]] = {"radial": 3, "tangential": 0}


class Brown(OpenCVLens):
    """k1, k2, k3, p1, p2."""

    kind: ClassVar[str] = "brown"
    numbers: ClassVar[Mapping[str, int]] = {"radial": 3, "tangential": 2}


class Rational(OpenCVLens):
    """k1 … k6, p1, p2."""

    kind: ClassVar[str] = "rational"
    numbers: ClassVar[Mapping[str, int]] = {"radial": 6, "tangential": 2}


# The lens ladder: each rung has all the terms of the one before it.
LADDER: Final[dict[str, type[OpenCVLens]]] = {
    kind.kind: kind for kind in (Undistorted, Radial1, Radial2, Radial3, Brown, Rational)
}


def is_off_centre(kind: str) -> bool:
    """Whether a lens of the ladder has terms that are not alike in all directions from its axis."""
    return LADDER[kind].numbers["tangential"] > 0


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
    if tangential:
        return _undistort_tangential(radial, tangential, xd)
    return xd * _radial_scale(radial, xd @ xd) if radial else xd


@compiled(filtered=True)
def invertible_radius(radial: Coefficients, dtype: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Where the distorted radius r s(r²) stops growing: the undistorted radius there, and the distorted one.

    A lens that never folds back within 84 degrees of its axis gets that radius.
    """
    return growing.turning_point(lambda r: _height(radial, r), _WIDEST_RADIUS, dtype)


def _height(radial: Coefficients, r: Float[Array, "*any"]) -> Float[Array, "*any"]:
    return r * radial_factor(radial, r * r)


def _radial_scale(radial: Coefficients, rd2: Float[Array, ""]) -> Float[Array, ""]:
    """The factor from distorted to undistorted coordinates of a radial lens: 1 / s(r²) at r s(r²) = r_d."""
    if not radial:
        return jnp.ones_like(rd2)
    r = growing.inverse(lambda r: _height(radial, r), _WIDEST_RADIUS, jnp.sqrt(rd2))
    return 1 / radial_factor(radial, r * r)


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
        step = -share * solve2(J, error)
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
    return jnp.where(square <= (growing.CLOSE * tolerance * (1 + rd)) ** 2, x, jnp.nan)


def _far_side(radial: Coefficients, tangential: Coefficients, dtype: Any) -> Float[Array, ""]:
    """The undistorted radius beyond the fold from which the distorted one may grow again; no branch of the centre's.

    The slope of the distorted radius along a direction e is d(r s)/dr + 6 r (p2, p1) · e.
    """
    r, rd = growing.samples(lambda r: _height(radial, r), _WIDEST_RADIUS, dtype)
    slope = jnp.diff(rd) / jnp.diff(r)
    folded = jnp.cumsum(slope <= 6 * r[1:] * jnp.sqrt(tangential[0] ** 2 + tangential[1] ** 2)) > 0
    again = folded[:-1] & (slope[1:] > slope[:-1])
    return jnp.where(again.any(), r[1 + jnp.argmax(again)], r[-1])
