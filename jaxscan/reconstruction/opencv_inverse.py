"""The inverse of OpenCV's lens terms without iterations, as polynomials.

The factor from distorted to undistorted coordinates of a radial lens is a function of r_d² alone. It is found in
float64 once for a camera and kept as a polynomial S (in powers of 2ρ − 1, ρ = r_d² / reach: powers of ρ would cancel,
and cost float32 its precision).

Brown's tangential terms are, with w = (p2, p1), Δ(x) = |x|² w + 2 (w · x) x. Turning x, x_d and w together changes
nothing, so Δ as a function of the distorted ray is

    Δ = F x_d + G w,    F and G functions of |x_d|² and m = w · x_d alone,

each a polynomial of low degree, for Δ is small: F of the second order in m, G of the first. What is left is a radial
lens, x = S(|x_d − Δ|²) (x_d − Δ). Where that is not near enough, fixed-point corrections Δ ← Δ(x) follow, each of which
divides the error by about the size of the tangential terms.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.kept_programs import compiled
from jaxscan.rig.opencv_lens import Coefficients, OpenCVLens, distort, invertible_radius, undistort

# Degrees of S. Most lenses need the lowest one and so share a compiled kernel.
LOWEST_DEGREE, HIGHEST_DEGREE = 6, 16
_FIT_SAMPLES = 400
# The polynomial is made no better than this (pixels), and a lens whose inverse is worse than the second is refused.
FIT_GOAL_PX = 5e-5
FIT_LIMIT_PX = 1e-3
# How near to the fold of a lens the polynomial is tried.
SHARES_OF_THE_FOLD = (0.999, 0.99, 0.97, 0.94, 0.9)
# Of F and G: orders of m, and degree in ρ. For a usual lens they err by 2e-4 px.
_ORDERS_ALONG, _ORDERS_ACROSS, _SHIFT_DEGREE = 3, 2, 4
# How many corrections for the tangential terms are tried.
_CORRECTIONS = (0, 1, 3, 6, 12)


class LensInverse(eqx.Module):
    """Distorted to undistorted rays: arrays alone, so that another lens of the same kind does not compile again.

    Attributes:
        factor: coefficients c_i of S = Σ c_i (2ρ − 1)^i with ρ = r_d² / reach.
        inverse_reach: one over the largest r_d² that has an inverse.
        tangential: p1, p2, or empty.
        along: of F, for each order of m; empty without tangential terms.
        across: of G.
        corrections: how many the tangential terms need.
    """

    factor: Float[Array, "coefficients"]
    inverse_reach: Float[Array, ""]
    tangential: Float[Array, "tangential"]
    along: Float[Array, "orders shift"]
    across: Float[Array, "fewer shift"]
    corrections: int = eqx.field(static=True)

    @staticmethod
    def symmetric(factor: Float[np.ndarray, "coefficients"], reach: float) -> "LensInverse":
        """That of a lens that is symmetric about its axis.

        Args:
            factor: coefficients of S.
            reach: the largest r_d that has an inverse.
        """
        none = jnp.zeros((0, _SHIFT_DEGREE + 1))
        return LensInverse(jnp.asarray(factor), jnp.asarray(1 / reach**2), jnp.zeros(0), none, none, 0)

    def __call__(self, xd: Float[Array, ""], yd: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Undistorted coordinates; NaN beyond the reach, where nothing holds."""
        if not self.tangential.size:
            return self._radial(xd, yd, jnp.nan)
        p1, p2 = self.tangential
        m, t = self._invariants(xd, yd)
        F, G = (polynomial(m, [polynomial(t, row) for row in rows]) for rows in (self.along, self.across))
        at = xd - F * xd - G * p2, yd - F * yd - G * p1
        for _ in range(self.corrections):
            # Held at the reach: a correction that starts beyond it must not be thrown about by the polynomial's tail.
            x, y = self._radial(*at, self.factor.sum())
            moved = distort((), (p1, p2), jnp.stack([x, y])) - jnp.stack([x, y])
            at = xd - moved[0], yd - moved[1]
        return self._radial(*at, jnp.nan)

    def _radial(
        self, xd: Float[Array, ""], yd: Float[Array, ""], beyond: Float[Array, ""] | float
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The radial lens alone, with a factor of one's own beyond the reach."""
        t = self._place(xd, yd)
        s = jnp.where(t < 1, polynomial(t, self.factor), beyond)
        return xd * s, yd * s

    def _place(self, xd: Float[Array, "*n"], yd: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """2ρ − 1."""
        return (xd * xd + yd * yd) * (2 * self.inverse_reach) - 1

    def _invariants(self, xd: Float[Array, "*n"], yd: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
        """m, and 2ρ − 1 of the distorted ray, held at the reach."""
        p1, p2 = self.tangential
        t = self._place(xd, yd)
        # Not `minimum`, which asks for NaN too.
        return p2 * xd + p1 * yd, jnp.where(t < 1, t, 1.0)


def polynomial(x: Float[Array, "*n"], coefficients: Float[Array, "coefficients"] | list) -> Float[Array, "*n"]:
    """Σ c_i x^i by halves, each of powers of x²: steps wait for one another, and these are half as many (G. Estrin)."""
    terms = list(coefficients)
    while len(terms) > 1:
        ends = terms[-1:] if len(terms) % 2 else []
        terms = [low + high * x for low, high in zip(terms[::2], terms[1::2], strict=False)] + ends
        x = x * x
    return jnp.broadcast_to(terms[0], x.shape)


def opencv_inverse(lens: OpenCVLens, xd: Float[np.ndarray, "n 2"], focal: float) -> LensInverse | None:
    """The inverse of a lens, in float64; None where it is not met to a thousandth of a pixel.

    Least squares against the exact inverse. Where the lens folds back inside the image no polynomial follows its
    inverse up to the fold; the reach then ends a little before it. Inside a `float64` block.

    Args:
        lens: with float64 leaves.
        xd: distorted rays all over the image.
        focal: pixels.
    """
    radial, tangential = lens.radial, lens.tangential
    fold = float(invertible_radius(radial, jnp.float64)[1]) if radial else np.inf
    # The radius is looked up after the tangential terms have been taken off.
    exact, straight = (np.asarray(x) for x in _exact(radial, tangential, jnp.asarray(xd)))
    looked_up = np.linalg.norm(straight, axis=1)
    widest = 1.001 * float(np.nanmax(np.where(np.isfinite(looked_up), looked_up, np.linalg.norm(xd, axis=1))))
    for share in SHARES_OF_THE_FOLD:
        reach = min(widest, share * fold)
        factor, error = _fit_factor(radial, reach, focal)
        if error > FIT_LIMIT_PX:
            continue
        inverse = LensInverse.symmetric(factor, reach)
        if not tangential:
            return inverse
        within = looked_up < reach
        inverse = _with_shift(inverse, np.stack(tangential), xd[within], (xd - straight)[within])
        for corrections in _CORRECTIONS:
            inverse = replace(inverse, corrections=corrections)
            x, y = (np.asarray(z) for z in _over_image(inverse, *jnp.asarray(xd.T)))
            off = np.hypot(x - exact[:, 0], y - exact[:, 1])[np.isfinite(x)] * focal
            if (off <= FIT_LIMIT_PX).all():
                return inverse
    return None


def _fit_factor(radial: Coefficients, reach: float, focal: float) -> tuple[Float[np.ndarray, "coefficients"], float]:
    """S at Chebyshev points up to the reach, of the lowest degree that is good enough, and its worst error (pixels)."""
    rho = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_FIT_SAMPLES) + 0.5) / _FIT_SAMPLES)
    distorted = reach * np.sqrt(rho)
    exact = np.asarray(_undistort_radii(radial, jnp.asarray(distorted))) / distorted
    degree, error, fit = LOWEST_DEGREE if np.ptp(exact) else 0, np.inf, np.polynomial.Chebyshev([1.0])
    while error > FIT_GOAL_PX and degree <= HIGHEST_DEGREE:
        fit = np.polynomial.Chebyshev.fit(rho, exact, degree, domain=[0, 1])
        error = float(np.abs((fit(rho) - exact) * distorted).max()) * focal
        degree += 2
    power = fit.convert(kind=np.polynomial.Polynomial, domain=[0, 1], window=[-1, 1])
    return power.coef, error if np.isfinite(error) else np.inf


def _with_shift(
    inverse: LensInverse,
    tangential: Float[np.ndarray, "2"],
    xd: Float[np.ndarray, "n 2"],
    shift: Float[np.ndarray, "n 2"],
) -> LensInverse:
    """The inverse with F and G, such that F x_d + G w is nearest to the shift Δ."""
    inverse = replace(inverse, tangential=jnp.asarray(tangential))
    m, powers = (np.asarray(z) for z in inverse._invariants(*jnp.asarray(xd.T)))
    of_radius = np.vander(powers, _SHIFT_DEGREE + 1, increasing=True)
    orders = m[:, None] ** np.arange(_ORDERS_ALONG)
    basis = (orders[:, :, None] * of_radius[:, None]).reshape(len(m), -1)
    across = basis[:, : _ORDERS_ACROSS * (_SHIFT_DEGREE + 1)]
    columns = np.concatenate([xd[:, :, None] * basis[:, None], tangential[::-1, None] * across[:, None]], axis=2)
    columns = columns.reshape(-1, columns.shape[2])
    # Orders of m are orders of a thousandth.
    scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    found = np.linalg.lstsq(columns / scale, shift.reshape(-1))[0] / scale
    rows = jnp.asarray(found.reshape(-1, _SHIFT_DEGREE + 1))
    return replace(inverse, along=rows[:_ORDERS_ALONG], across=rows[_ORDERS_ALONG:])


@compiled()
def _undistort_radii(radial: Coefficients, rd: Float[Array, "n"]) -> Float[Array, "n"]:
    along = jnp.stack([rd, jnp.zeros_like(rd)], axis=-1)
    return jax.vmap(lambda x: undistort(radial, (), x))(along)[:, 0]


@compiled()
def _exact(
    radial: Coefficients, tangential: Coefficients, xd: Float[Array, "n 2"]
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"]]:
    """Undistorted rays, and as the radial terms alone would distort them."""
    x = jax.vmap(lambda xd: undistort(radial, tangential, xd))(xd)
    return x, jax.vmap(lambda x: distort(radial, (), x))(x)


@compiled()
def _over_image(inverse: LensInverse, xd: Float[Array, "n"], yd: Float[Array, "n"]) -> tuple[Float[Array, "n"], ...]:
    return jax.vmap(inverse)(xd, yd)
