"""The inverse of a lens without iterations: what takes a distorted ray to the undistorted one, as polynomials.

OpenCV's lens terms have theirs (`opencv_inverse`). Of any other lens the exact inverse is computed at pixels all over
the image, and followed, by least squares, by

    x = S(|x_d|²) x_d + P(x_d),

S as there. P is for what is not symmetric about the axis: a polynomial in both coordinates, of the lowest degree that
is good enough. A lens that is symmetric needs none, and has the compiled kernel of OpenCV's radial lenses.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.errors import InputError
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction.opencv_inverse import (
    FIT_GOAL_PX,
    FIT_LIMIT_PX,
    HIGHEST_DEGREE,
    LOWEST_DEGREE,
    SHARES_OF_THE_FOLD,
    LensInverse,
    opencv_inverse,
    polynomial,
)
from jaxscan.rig import Camera, Lens
from jaxscan.rig.opencv_lens import OpenCVLens

# Pixels along each side of the image at which the inverse is compared with the exact one.
_GRID = 100
# Of P.
_DEGREES = (3, 5, 7, 9)


class FittedInverse(eqx.Module):
    """The inverse of a lens that is not symmetric about its axis.

    Attributes:
        symmetric: S.
        rest: coefficients of P for x and for y: c_ij of (x_d / r)^i (y_d / r)^j, r the reach of S.
    """

    symmetric: LensInverse
    rest: Float[Array, "2 degrees degrees"]

    def __call__(self, xd: Float[Array, ""], yd: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Undistorted coordinates; NaN beyond the reach, where nothing holds."""
        x, y = self.symmetric(xd, yd)
        scale = jnp.sqrt(self.symmetric.inverse_reach)
        of_x, of_y = (polynomial(scale * xd, [polynomial(scale * yd, row) for row in rows]) for rows in self.rest)
        return x + of_x, y + of_y


def lens_inverse(camera: Camera) -> LensInverse | FittedInverse:
    """The inverse of a camera's lens over its image, in float64.

    Raises:
        InputError: the inverse is not met to a thousandth of a pixel.
    """
    columns, rows = camera.image_size
    sides = (np.linspace(-0.5, size - 0.5, _GRID) for size in (columns, rows))
    pixels = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    xd = (pixels - np.stack(camera.principal)) / np.stack(camera.focal)
    focal = float(np.max(np.stack(camera.focal)))
    with float64():
        lens = as_float64(camera.lens)
        found = opencv_inverse(lens, xd, focal) if isinstance(lens, OpenCVLens) else _fitted(lens, xd, focal)
    if found is not None:
        return found
    values = " and ".join(f"{name} {[float(leaf) for leaf in getattr(lens, name)]}" for name in lens.numbers)
    raise InputError(
        f"the inverse of the lens {lens.kind} with {values} is not smooth over the image, no polynomial follows it: "
        "calibrate with a simpler lens"
    )


def _fitted(lens: Lens, xd: Float[np.ndarray, "n 2"], focal: float) -> LensInverse | FittedInverse | None:
    exact, radius = np.asarray(_undistorted(lens, jnp.asarray(xd))), np.linalg.norm(xd, axis=1)
    fold = float(radius[~np.isfinite(exact).all(axis=1)].min(initial=np.inf))
    for share in SHARES_OF_THE_FOLD:
        reach = min(1.001 * float(radius.max()), share * fold)
        within = radius < reach
        factor, rest = _factor(xd[within] / reach, exact[within] / reach, reach * focal)
        if _worst(rest, reach * focal) <= FIT_GOAL_PX:
            return LensInverse.symmetric(factor, reach)
        further, rest = _polynomial_rest(xd[within] / reach, rest, reach * focal)
        if _worst(rest, reach * focal) <= FIT_LIMIT_PX:
            return FittedInverse(LensInverse.symmetric(factor, reach), jnp.asarray(reach * further))
    return None


def _factor(
    u: Float[np.ndarray, "n 2"], x: Float[np.ndarray, "n 2"], scale: float
) -> tuple[Float[np.ndarray, "coefficients"], Float[np.ndarray, "n 2"]]:
    """S, of the lowest degree that does as well as any, and what it leaves; coordinates in units of the reach."""
    fits = []
    for degree in range(LOWEST_DEGREE, HIGHEST_DEGREE + 1, 2):
        basis = np.polynomial.chebyshev.chebvander(2 * (u**2).sum(axis=1) - 1, degree)
        columns = (u[:, :, None] * basis[:, None]).reshape(-1, degree + 1)
        coefficients = np.linalg.lstsq(columns, x.reshape(-1))[0]
        rest = x - (columns @ coefficients).reshape(-1, 2)
        fits.append((coefficients, rest))
        if _worst(rest, scale) <= FIT_GOAL_PX:
            break
    least = min(_worst(rest, scale) for _, rest in fits)
    coefficients, rest = next(fit for fit in fits if _worst(fit[1], scale) <= 1.1 * least)
    return np.polynomial.chebyshev.cheb2poly(coefficients), rest


def _polynomial_rest(
    u: Float[np.ndarray, "n 2"], x: Float[np.ndarray, "n 2"], scale: float
) -> tuple[Float[np.ndarray, "2 degrees degrees"], Float[np.ndarray, "n 2"]]:
    """P, of the lowest degree that is good enough, and what it leaves; coordinates in units of the reach."""
    found, rest = np.zeros((2, 1, 1)), x
    for degree in _DEGREES:
        i, j = np.nonzero(np.add.outer(np.arange(degree + 1), np.arange(degree + 1)) <= degree)
        along, across = (np.polynomial.chebyshev.chebvander(u[:, k], degree) for k in (0, 1))
        columns = along[:, i] * across[:, j]
        coefficients = np.linalg.lstsq(columns, x)[0]
        rest = x - columns @ coefficients
        chebyshev = np.zeros((2, degree + 1, degree + 1))
        chebyshev[:, i, j] = coefficients.T
        # To powers, along one coordinate and then along the other.
        powers = np.zeros((degree + 1, degree + 1))
        for k in range(degree + 1):
            powers[k, : k + 1] = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[k])
        found = powers.T @ chebyshev @ powers
        if _worst(rest, scale) <= FIT_GOAL_PX:
            break
    return found, rest


def _worst(rest: Float[np.ndarray, "n 2"], scale: float) -> float:
    """The largest error, pixels."""
    return float(np.linalg.norm(rest, axis=1).max(initial=0.0)) * scale


@eqx.filter_jit
def _undistorted(lens: Lens, xd: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    return jax.vmap(lens.undistort)(xd)
