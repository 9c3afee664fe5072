"""The inverse of a lens and a sensor without iterations: what takes a distorted ray to the undistorted one.

OpenCV's lens terms have theirs (`opencv_inverse`), and so has a field of shifts on top (`field_inverse`). Of any other
lens the exact inverse is computed at pixels all over the image, and followed, by least squares, by

    x = S(|x_d|²) x_d + P(x_d),

S as there. P is for what is not symmetric about the axis: a polynomial in both coordinates, of the lowest degree that
is good enough. A lens that is symmetric needs none, and has the compiled kernel of OpenCV's radial lenses.

A tilted sensor comes before: a projective map whose divisor is linear in both coordinates. Its reciprocal is a
polynomial too, for XLA's division takes longer than all of the lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.errors import InputError
from jaxscan.kept_programs import compiled
from jaxscan.precision import Leaf, as_float64, float64
from jaxscan.reconstruction.field_inverse import FieldInverse, field_inverse
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
from jaxscan.rig.splined import Splined
from jaxscan.rig.tilted_sensor import off_sensor

# Pixels along each side of the image at which the inverse is compared with the exact one.
_GRID = 100
# Every Nth of them is used in the fit.
_EVERY = 3
# Degrees of S and of P that are tried: without P first, up to the fold or a little before it.
_SYMMETRIC = tuple((degree, None) for degree in range(LOWEST_DEGREE, HIGHEST_DEGREE + 1, 2))
# Of the reciprocal of a tilted sensor: what 10° ask for, so that most have one compiled kernel.
_LOWEST_OF_TILT = 5
# By how much its divisor is taken to differ over the image, where it differs by nothing.
_LEAST_HALF = 1e-9
# Of more numbers none are named.
_MOST_NAMED = 16
_WITH_REST = tuple((HIGHEST_DEGREE, rest) for rest in (3, 5, 7, 9))


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


class TiltedInverse(eqx.Module):
    """The inverse of a lens behind which the sensor is tilted.

    Attributes:
        along: m of x_d = m₀ x_t / w, y_d = (m₁ x_t + m₂ y_t) / w.
        across: n of the place t = n₀ + n₁ x_t + n₂ y_t, between −1 and 1 over the image.
        reciprocal: coefficients c_i of 1 / w = Σ c_i t^i.
        lens: that of the lens.
    """

    along: Float[Array, "3"]
    across: Float[Array, "3"]
    reciprocal: Float[Array, "coefficients"]
    lens: LensInverse | FittedInverse | FieldInverse

    def __call__(self, xt: Float[Array, ""], yt: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Undistorted coordinates; NaN beyond the reach of the lens, where nothing holds."""
        i = polynomial(self.across[0] + self.across[1] * xt + self.across[2] * yt, self.reciprocal)
        return self.lens(self.along[0] * xt * i, (self.along[1] * xt + self.along[2] * yt) * i)


def lens_inverse(camera: Camera) -> LensInverse | FittedInverse | FieldInverse | TiltedInverse:
    """The inverse of a camera's lens and sensor over its image, in float64.

    Raises:
        InputError: the inverse is not met to a thousandth of a pixel, or a part of the tilted sensor sees nothing.
    """
    columns, rows = camera.image_size
    sides = (np.linspace(-0.5, size - 0.5, _GRID) for size in (columns, rows))
    pixels = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    xt = (pixels - np.stack(camera.principal)) / np.stack(camera.focal)
    focal = float(np.max(np.stack(camera.focal)))
    with float64():
        lens, tilt = as_float64((camera.lens, camera.tilt))
        xd = np.asarray(jax.vmap(lambda xt: off_sensor(tilt, xt))(jnp.asarray(xt)))
        if not np.isfinite(xd).all():
            angles = " and ".join(f"{np.degrees(float(angle)):.1f}°" for angle in tilt)
            raise InputError(
                f"the sensor is tilted by {angles}, so far that a part of it sees nothing: calibrate again"
            )
        found = _inverse(lens, xd, focal)
        if found is not None:
            return _tilted(found, tilt, xt, focal) if tilt else found
    few = [name for name, count in lens.numbers.items() if count <= _MOST_NAMED]
    values = " and ".join(f"{name} {[float(leaf) for leaf in getattr(lens, name)]}" for name in few)
    raise InputError(
        f"the inverse of the lens {lens.kind} with {values} is not smooth over the image, no polynomial follows it: "
        "calibrate with a simpler lens"
    )


def _inverse(
    lens: Lens, xd: Float[np.ndarray, "n 2"], focal: float
) -> LensInverse | FittedInverse | FieldInverse | None:
    if isinstance(lens, OpenCVLens):
        return opencv_inverse(lens, xd, focal)
    return field_inverse(lens, xd, focal) if isinstance(lens, Splined) else _fitted(lens, xd, focal)


def _tilted(
    lens: LensInverse | FittedInverse | FieldInverse, tilt: Sequence[Leaf], xt: Float[np.ndarray, "n 2"], focal: float
) -> TiltedInverse:
    """With the way from the sensor to the lens before it; 1 / w to the last degree that its pixels ask for."""
    (cx, sx), (cy, sy) = ((np.cos(float(angle)), np.sin(float(angle))) for angle in tilt)
    divisor = np.array([1.0, -cx * sy, sx])
    w = divisor[0] + xt @ divisor[1:]
    middle, half = (w.max() + w.min()) / 2, max(np.ptp(w) / 2, _LEAST_HALF)
    # Of 1 / (middle + half t) each further Chebyshev term is smaller by this factor.
    ratio = half / (middle + np.sqrt(middle**2 - half**2))
    largest = focal * float(np.abs(xt).max()) / np.sqrt(middle**2 - half**2)
    degree = max(_LOWEST_OF_TILT, int(np.ceil(np.log(FIT_GOAL_PX / largest) / np.log(ratio))))
    fit = np.polynomial.Chebyshev.interpolate(lambda t: 1 / (middle + half * t), degree)
    return TiltedInverse(
        jnp.asarray([cy, sx * sy, cx]),
        jnp.asarray((divisor - [middle, 0, 0]) / half),
        jnp.asarray(fit.convert(kind=np.polynomial.Polynomial).coef),
        lens,
    )


def _fitted(lens: Lens, xd: Float[np.ndarray, "n 2"], focal: float) -> LensInverse | FittedInverse | None:
    exact, radius = np.asarray(_undistorted(lens, jnp.asarray(xd))), np.linalg.norm(xd, axis=1)
    fold = float(radius[~np.isfinite(exact).all(axis=1)].min(initial=np.inf))
    widest = 1.001 * float(radius.max())
    reaches = dict.fromkeys(min(widest, share * fold) for share in SHARES_OF_THE_FOLD)
    for degrees, reach in product((_SYMMETRIC, _WITH_REST), reaches):
        within = radius < reach
        if within.any() and (found := _up_to(reach, degrees, lens, xd[within], exact[within], focal)) is not None:
            return found
    return None


def _up_to(
    reach: float,
    degrees: Sequence[tuple[int, int | None]],
    lens: Lens,
    xd: Float[np.ndarray, "n 2"],
    x: Float[np.ndarray, "n 2"],
    focal: float,
) -> LensInverse | FittedInverse | None:
    """The inverse up to a distorted radius; None where it is not met.

    Args:
        reach: the radius.
        degrees: of S and P, to be tried in turn.
        lens: whose inverse.
        xd: distorted coordinates up to there.
        x: undistorted ones.
        focal: pixels.
    """
    for degree, rest in degrees:
        found = _fit(xd, x, reach, degree, rest)
        off = np.asarray(_distorted(lens, jnp.asarray(found.rays))) - xd
        error = focal * float(np.linalg.norm(off, axis=1).max())
        if error <= (FIT_GOAL_PX if degree < HIGHEST_DEGREE else FIT_LIMIT_PX):
            symmetric = LensInverse.symmetric(found.factor, reach)
            return symmetric if rest is None else FittedInverse(symmetric, jnp.asarray(found.rest))
    return None


@dataclass(frozen=True)
class _Fit:
    """Coefficients of S and P, and the rays that they give."""

    factor: Float[np.ndarray, "coefficients"]
    rest: Float[np.ndarray, "2 degrees degrees"]
    rays: Float[np.ndarray, "n 2"]


def _fit(
    xd: Float[np.ndarray, "n 2"], x: Float[np.ndarray, "n 2"], reach: float, degree: int, rest: int | None
) -> _Fit:
    """S and P together, in Chebyshev's polynomials; what both can do is shared out by least norm.

    Args:
        xd: distorted coordinates.
        x: undistorted ones.
        reach: the largest r_d that has an inverse.
        degree: of S.
        rest: of P; None for none.
    """
    basis = np.polynomial.chebyshev.chebvander(2 * (xd**2).sum(axis=1) / reach**2 - 1, degree)
    columns = xd[:, :, None] * basis[:, None]
    orders = np.arange(0 if rest is None else rest + 1)
    i, j = np.nonzero(np.add.outer(orders, orders) <= len(orders) - 1)
    if rest is not None:
        along, across = (np.polynomial.chebyshev.chebvander(xd[:, k] / reach, rest) for k in (0, 1))
        both = along[:, i] * across[:, j]
        none = np.zeros_like(both)
        columns = np.concatenate([columns, np.stack([both, none], axis=1), np.stack([none, both], axis=1)], axis=2)
    few = slice(None, None, _EVERY)
    found = np.linalg.lstsq(columns[few].reshape(-1, columns.shape[2]), x[few].reshape(-1))[0]
    chebyshev = np.zeros((2, len(orders), len(orders)))
    chebyshev[:, i, j] = found[degree + 1 :].reshape(2, -1)
    # To powers, along one coordinate and along the other.
    powers = np.zeros((len(orders), len(orders)))
    for k in orders:
        powers[k, : k + 1] = np.polynomial.chebyshev.cheb2poly(np.eye(len(orders))[k])
    factor = np.polynomial.chebyshev.cheb2poly(found[: degree + 1])
    return _Fit(factor, powers.T @ chebyshev @ powers, columns @ found)


@compiled(filtered=True)
def _undistorted(lens: Lens, xd: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    return jax.vmap(lens.undistort)(xd)


@compiled(filtered=True)
def _distorted(lens: Lens, x: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    return jax.vmap(lens.distort)(x)
