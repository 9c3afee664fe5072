"""The inverse of a splined lens without iterations: a spline of its own, a correction or more, then OpenCV's terms.

y + s(y) = x_d is met by y = x_d − g(x_d), and g is nearly a spline on the same grid: the one that comes nearest, by
least squares, is a few hundredths of a pixel off for shifts of half a pixel. y ← x_d − s(y) divides the error by about
the slope of the shifts, a hundredth of them. How many of these are needed is found once for a camera. All weights of
all coefficients are computed, most of them zero: what XLA would look up instead it does one point at a time, and takes
longer.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.kept_programs import compiled
from jaxscan.reconstruction.opencv_inverse import FIT_LIMIT_PX, LensInverse, opencv_inverse
from jaxscan.rig.spline import MORE_THAN_CELLS, basis
from jaxscan.rig.splined import CELLS, Splined

# How many corrections are tried.
_CORRECTIONS = (0, 1, 2, 4, 8)


class FieldInverse(eqx.Module):
    """The inverse of a lens with a field of shifts.

    Attributes:
        low: x_d and y_d at which the grid begins.
        scale: cells for each unit of them.
        first: coefficients of g along x and along y.
        shifts: of s.
        lens: the inverse of the terms.
        corrections: how many the shifts need.
    """

    low: Float[Array, "2"]
    scale: Float[Array, "2"]
    first: Float[Array, "2 rows columns"]
    shifts: Float[Array, "2 rows columns"]
    lens: LensInverse
    corrections: int = eqx.field(static=True)

    def __call__(self, xd: Float[Array, ""], yd: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Undistorted coordinates; NaN beyond the reach of the terms."""
        x, y = xd, yd
        for spline in (self.first, *(self.shifts,) * self.corrections):
            along, across = (_weights((z - self.low[k]) * self.scale[k], CELLS[k]) for k, z in enumerate((x, y)))
            a, b = (
                sum(
                    w * sum(v * c for v, c in zip(along, row, strict=True)) for w, row in zip(across, rows, strict=True)
                )
                for rows in spline
            )
            x, y = xd - a, yd - b
        return self.lens(x, y)


def _weights(t: Float[Array, ""], cells: int) -> list[Float[Array, ""]]:
    """`rig.spline.weights`, one by one: sums of them are fused with what surrounds them.

    The four that are not zero are polynomials of the place in its cell. Which ones these are is chosen: that takes half
    as long as computing all.
    """
    t = jnp.where(t > 0, jnp.where(t < cells, t, float(cells)), 0.0)
    cell = jnp.floor(t)
    cell = jnp.where(cell < cells, cell, float(cells - 1))
    f = t - cell
    g = 1 - f
    four = g * g * g / 6, (4 - f * f * (6 - 3 * f)) / 6, (4 - g * g * (6 - 3 * g)) / 6, f * f * f / 6
    weights = []
    for i in range(cells + MORE_THAN_CELLS):
        weight = jnp.zeros_like(t)
        for k, value in enumerate(four):
            if 0 <= i - k < cells:
                weight = jnp.where(cell == float(i - k), value, weight)
        weights.append(weight)
    return weights


def field_inverse(lens: Splined, xd: Float[np.ndarray, "n 2"], focal: float) -> FieldInverse | None:
    """The inverse of a lens, in float64; None where it is not met to a thousandth of a pixel.

    Inside a `float64` block.

    Args:
        lens: with float64 leaves.
        xd: distorted rays all over the image.
        focal: pixels.
    """
    unshifted, exact = (np.asarray(x) for x in _exact(lens, jnp.asarray(xd)))
    there = np.isfinite(exact).all(axis=1)
    terms = opencv_inverse(lens.terms, unshifted[there], focal) if there.any() else None
    # Where the field folds corrections would end somewhere.
    if terms is None or not np.isfinite(unshifted).all():
        return None
    extent = np.array([float(leaf) for leaf in lens.extent])
    grid = 2, *(n + MORE_THAN_CELLS for n in CELLS[::-1])
    shifts = np.array([lens.shift_x, lens.shift_y], float)
    first = np.linalg.lstsq(basis(extent, CELLS, xd), xd - unshifted)[0].T
    scale = np.array(CELLS) / (extent[2:] - extent[:2])
    for corrections in _CORRECTIONS:
        low, cells, *splines = map(jnp.asarray, (extent[:2], scale, first.reshape(grid), shifts.reshape(grid)))
        found = FieldInverse(low, cells, splines[0], splines[1], terms, corrections)
        rays = np.stack(_over_image(found, *jnp.asarray(xd.T)), axis=1)
        error = focal * np.linalg.norm((rays - exact)[there], axis=1)
        # What the terms' inverse does not reach is not there.
        if (error[np.isfinite(error)] <= FIT_LIMIT_PX).all():
            return found
    return None


@compiled()
def _exact(lens: Splined, xd: Float[Array, "n 2"]) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"]]:
    """Rays as the terms alone would image them, and the rays."""
    return jax.vmap(lens.unshifted)(xd), jax.vmap(lens.undistort)(xd)


@compiled()
def _over_image(inverse: FieldInverse, xd: Float[Array, "n"], yd: Float[Array, "n"]) -> tuple[Float[Array, "n"], ...]:
    return jax.vmap(inverse)(xd, yd)
