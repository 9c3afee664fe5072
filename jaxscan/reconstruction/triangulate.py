"""The triangulation kernel: (u, v, step) → point, as one fused pass over millions of stripe points.

With x the undistorted ray of pixel (u, v), ω the light plane and t = −per_step the point of the object frame is

    X_j = (a_j · x) / (ω · x) + t_j n,   a_j the unit vector of coordinate j.

Written so, with the coefficients as arguments, XLA makes one loop of it that reads u, v and n once and writes the
(points, 3) output once. The inverse of the lens costs no iteration there: the factor from distorted to undistorted
coordinates is a function of r_d² alone, found in float64 once for a rig and kept as a polynomial S (in powers of
2ρ − 1, ρ = r_d² / reach: powers of ρ would cancel, and cost float32 its precision). A lens with tangential terms Δ adds
fixed-point corrections x ← S(|x_d − Δ(x)|²) (x_d − Δ(x)), each of which divides the error by about the size of the
tangential terms, and is compared with the exact inverse over the image.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.errors import InputError
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Camera, Rig
from jaxscan.rig.lens import Coefficients, distort, invertible_radius, undistort

# Most lenses need the lowest one and so share a compiled kernel.
_LOWEST_DEGREE, _HIGHEST_DEGREE = 6, 16
_FIT_SAMPLES = 400
# The polynomial is made no better than this (pixels), and a lens whose polynomial is worse than the second is refused.
_FIT_GOAL_PX = 5e-5
_FIT_LIMIT_PX = 1e-3
# How near to the fold of a lens the polynomial is tried.
_SHARES_OF_THE_FOLD = (0.999, 0.99, 0.97, 0.94, 0.9)
# How many corrections for the tangential terms are tried.
_CORRECTIONS = (3, 6, 12)
# Pixels along each side of the image at which the inverse of a tangential lens is compared with the exact one.
_GRID = 100


class Kernel(eqx.Module):
    """A rig made ready for triangulation: arrays alone, so that another rig of the same lens does not compile anew.

    Attributes:
        principal: u₀, v₀, pixels.
        inverse_focal: 1 / f_u, 1 / f_v.
        factor: coefficients c_i of S = Σ c_i (2ρ − 1)^i with ρ = r_d² / reach.
        inverse_reach: one over the largest r_d² that has an inverse; pixels beyond it give NaN.
        tangential: p1, p2, or empty.
        axes: the unit vectors a_j in rows.
        omega: the light plane, 1/mm, for each coordinate: to divide all three by one number is a pass of its own.
        back: −per_step of the stage, mm.
        corrections: how many the tangential terms need.
    """

    principal: Float[Array, "2"]
    inverse_focal: Float[Array, "2"]
    factor: Float[Array, "coefficients"]
    inverse_reach: Float[Array, ""]
    tangential: Float[Array, "tangential"]
    axes: Float[Array, "3 3"]
    omega: Float[Array, "3 3"]
    back: Float[Array, "3"]
    corrections: int = eqx.field(static=True)

    @staticmethod
    def create(rig: Rig, laser: str = "", dtype: str = "float32") -> "Kernel":
        """The kernel of one laser of a rig.

        Raises:
            InputError: the rig has no such laser, or the inverse of its lens is no smooth function over the image.
        """
        camera, plane = rig.camera, rig.laser(laser)
        factor, reach, corrections = lens_inverse(camera)
        back = np.zeros(3) if rig.stage is None else -np.stack(rig.stage.per_step)
        arrays = (
            np.stack(camera.principal),
            1 / np.stack(camera.focal),
            factor,
            1 / reach,
            camera.tangential,
            np.eye(3),
            np.tile(np.stack(plane.plane), (3, 1)),
            back,
        )
        return Kernel(*(jnp.asarray(np.asarray(array, np.float64), dtype) for array in arrays), corrections=corrections)

    def point(self, u: Float[Array, ""], v: Float[Array, ""], steps: Float[Array, ""]) -> Float[Array, "3"]:
        """One stripe pixel at a motor step count to its point (mm, object frame); NaN where it sees no sheet."""
        xd = (u - self.principal[0]) * self.inverse_focal[0]
        yd = (v - self.principal[1]) * self.inverse_focal[1]
        x, y, margin = _undistort(self.factor, self.inverse_reach, self.tangential, self.corrections, xd, yd)
        inverse_depth = self.omega[:, 0] * x + self.omega[:, 1] * y + self.omega[:, 2]
        point = (self.axes[:, 0] * x + self.axes[:, 1] * y + self.axes[:, 2]) / inverse_depth + self.back * steps
        # One comparison: a loop over the conjunction of two is not vectorised, and takes seven times as long.
        return jnp.where(jnp.minimum(inverse_depth, margin) > 0, point, jnp.nan)


def _undistort(
    factor: Float[Array, "coefficients"],
    inverse_reach: Float[Array, ""],
    tangential: Float[Array, "tangential"],
    corrections: int,
    xd: Float[Array, ""],
    yd: Float[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Undistorted coordinates, and how far within the polynomial's reach the pixel lies: 1 − ρ."""

    def radial(
        xd: Float[Array, ""], yd: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        rho = (xd * xd + yd * yd) * inverse_reach
        # Held at the reach: a correction that starts beyond it must not be thrown about by the polynomial's tail.
        at = 2 * jnp.minimum(rho, 1.0) - 1
        s = jnp.zeros_like(rho)
        for c in factor[::-1]:
            s = s * at + c
        return xd * s, yd * s, 1 - rho

    x, y, margin = radial(xd, yd)
    if tangential.size:
        for _ in range(corrections):
            moved = distort((), (tangential[0], tangential[1]), jnp.stack([x, y])) - jnp.stack([x, y])
            x, y, margin = radial(xd - moved[0], yd - moved[1])
    return x, y, margin


@jax.jit
def triangulate(
    kernel: Kernel, u: Float[Array, "points"], v: Float[Array, "points"], steps: Float[Array, "points"]
) -> Float[Array, "points 3"]:
    """Stripe pixels to points of the object frame (mm), in the kernel's precision."""
    return jax.vmap(kernel.point)(u, v, steps)


@partial(jax.jit, donate_argnames="out", keep_unused=True)
def triangulate_into(
    out: Float[Array, "points 3"],
    kernel: Kernel,
    u: Float[Array, "points"],
    v: Float[Array, "points"],
    steps: Float[Array, "points"],
) -> Float[Array, "points 3"]:
    """As `triangulate`, into the memory of `out`, an array that is used up.

    For millions of points at a time: memory that is asked for anew is fetched page by page, which takes longer than the
    points.
    """
    return triangulate(kernel, u, v, steps)


def lens_inverse(camera: Camera) -> tuple[Float[np.ndarray, "coefficients"], float, int]:
    """The factor from distorted to undistorted radial coordinates as a polynomial in 2 r_d² / reach − 1.

    Least squares at Chebyshev points, in float64, over the whole image. Where the lens folds back inside the image no
    polynomial follows its inverse up to the fold; the reach then ends a little before it.

    Returns:
        The coefficients, the reach, and how many corrections the tangential terms need.

    Raises:
        InputError: the inverse is not met to a thousandth of a pixel.
    """
    columns, rows = camera.image_size
    sides = (np.linspace(-0.5, size - 0.5, _GRID) for size in (columns, rows))
    pixels = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    xd = (pixels - np.stack(camera.principal)) / np.stack(camera.focal)
    focal = float(np.max(np.stack(camera.focal)))
    with float64():
        radial, tangential = as_float64((camera.radial, camera.tangential))
        fold = float(invertible_radius(radial, jnp.float64)[1]) if radial else np.inf
        # The radius is looked up after the tangential terms have been taken off.
        exact, looked_up = (np.asarray(x) for x in _exact(radial, tangential, jnp.asarray(xd)))
        widest = 1.001 * float(np.nanmax(np.where(np.isfinite(looked_up), looked_up, np.linalg.norm(xd, axis=1))))
        for share in _SHARES_OF_THE_FOLD:
            reach = min(widest, share * fold)
            rho = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_FIT_SAMPLES) + 0.5) / _FIT_SAMPLES)
            distorted = reach * np.sqrt(rho)
            factor = np.asarray(_undistort_radii(radial, jnp.asarray(distorted))) / distorted
            coefficients, error = _fit(rho, factor, distorted * focal)
            if error > _FIT_LIMIT_PX:
                continue
            if not tangential:
                return coefficients, reach**2, 0
            for corrections in _CORRECTIONS:
                polynomial = (jnp.asarray(coefficients), jnp.asarray(1 / reach**2), jnp.stack(tangential))
                x, y, margin = (np.asarray(z) for z in _over_image(*polynomial, corrections, *jnp.asarray(xd.T)))
                off = np.hypot(x - exact[:, 0], y - exact[:, 1])[margin > 0] * focal
                if (off <= _FIT_LIMIT_PX).all():
                    return coefficients, reach**2, corrections
    raise InputError(
        f"the inverse of the lens {camera.lens} with radial {[float(k) for k in camera.radial]} and tangential "
        f"{[float(p) for p in camera.tangential]} is not smooth over the image, no polynomial follows it: calibrate "
        "with a simpler lens"
    )


def _fit(
    rho: Float[np.ndarray, "n"], exact: Float[np.ndarray, "n"], weight: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "coefficients"], float]:
    """The polynomial of the lowest degree that is good enough, and its worst error, weighted (pixels)."""
    degree, error, fit = _LOWEST_DEGREE if np.ptp(exact) else 0, np.inf, np.polynomial.Chebyshev([1.0])
    while error > _FIT_GOAL_PX and degree <= _HIGHEST_DEGREE:
        fit = np.polynomial.Chebyshev.fit(rho, exact, degree, domain=[0, 1])
        error = float(np.abs((fit(rho) - exact) * weight).max())
        degree += 2
    power = fit.convert(kind=np.polynomial.Polynomial, domain=[0, 1], window=[-1, 1])
    return power.coef, error if np.isfinite(error) else np.inf


@jax.jit
def _undistort_radii(radial: tuple[Float[Array, ""], ...], rd: Float[Array, "n"]) -> Float[Array, "n"]:
    along = jnp.stack([rd, jnp.zeros_like(rd)], axis=-1)
    return jax.vmap(lambda x: undistort(radial, (), x))(along)[:, 0]


@jax.jit
def _exact(
    radial: Coefficients, tangential: Coefficients, xd: Float[Array, "n 2"]
) -> tuple[Float[Array, "n 2"], Float[Array, "n"]]:
    """Undistorted coordinates, and the distorted radius that the radial terms alone would give them."""
    x = jax.vmap(lambda xd: undistort(radial, tangential, xd))(xd)
    return x, jax.vmap(lambda x: jnp.linalg.norm(distort(radial, (), x)))(x)


_over_image = jax.jit(jax.vmap(_undistort, (None, None, None, None, 0, 0)), static_argnums=3)
