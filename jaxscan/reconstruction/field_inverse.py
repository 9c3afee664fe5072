"""The inverse of a splined lens without iterations: a few fixed-point corrections for its shifts, then OpenCV's terms.

y + s(y) = x_d is met by y ← x_d − s(y), each of which divides the error by about the slope of the shifts, a hundredth
for shifts of half a pixel. How many are needed is found once for a camera. All weights of all coefficients are
computed, most of them zero: what XLA would look up instead it does one point at a time, and takes longer.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.reconstruction.opencv_inverse import FIT_LIMIT_PX, LensInverse, opencv_inverse
from jaxscan.rig.spline import MORE_THAN_CELLS
from jaxscan.rig.splined import CELLS, Splined

# How many corrections are tried, after the first shift.
_CORRECTIONS = (1, 2, 4, 8)


class FieldInverse(eqx.Module):
    """The inverse of a lens with a field of shifts.

    Attributes:
        low: x_d and y_d at which the grid begins.
        scale: cells for each unit of them.
        shifts: coefficients of s along x and along y.
        lens: the inverse of the terms.
        corrections: how many the shifts need.
    """

    low: Float[Array, "2"]
    scale: Float[Array, "2"]
    shifts: Float[Array, "2 rows columns"]
    lens: LensInverse
    corrections: int = eqx.field(static=True)

    def __call__(self, xd: Float[Array, ""], yd: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Undistorted coordinates; NaN beyond the reach of the terms."""
        x, y = xd, yd
        for _ in range(self.corrections + 1):
            along, across = (_weights((z - self.low[k]) * self.scale[k], CELLS[k]) for k, z in enumerate((x, y)))
            a, b = (
                sum(
                    w * sum(v * c for v, c in zip(along, row, strict=True)) for w, row in zip(across, rows, strict=True)
                )
                for rows in self.shifts
            )
            x, y = xd - a, yd - b
        return self.lens(x, y)


def _weights(t: Float[Array, ""], cells: int) -> list[Float[Array, ""]]:
    """`rig.spline.weights`, one by one: sums of them are fused with what surrounds them."""
    t = jnp.where(t > 0, jnp.where(t < cells, t, float(cells)), 0.0)
    weights = []
    for i in range(cells + MORE_THAN_CELLS):
        d = jnp.abs(t - (i - 1))
        outer, inner = jnp.where(d < 2, 2 - d, 0.0), jnp.where(d < 1, 1 - d, 0.0)
        weights.append(outer * outer * outer * (1 / 6) - inner * inner * inner * (4 / 6))
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
    shifts = np.array([lens.shift_x, lens.shift_y], float).reshape(2, *(n + MORE_THAN_CELLS for n in CELLS[::-1]))
    scale = np.array(CELLS) / (extent[2:] - extent[:2])
    for corrections in _CORRECTIONS:
        found = FieldInverse(jnp.asarray(extent[:2]), jnp.asarray(scale), jnp.asarray(shifts), terms, corrections)
        rays = np.stack(_over_image(found, *jnp.asarray(xd.T)), axis=1)
        error = focal * np.linalg.norm((rays - exact)[there], axis=1)
        # What the terms' inverse does not reach is not there.
        if (error[np.isfinite(error)] <= FIT_LIMIT_PX).all():
            return found
    return None


@jax.jit
def _exact(lens: Splined, xd: Float[Array, "n 2"]) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"]]:
    """Rays as the terms alone would image them, and the rays."""
    return jax.vmap(lens.unshifted)(xd), jax.vmap(lens.undistort)(xd)


@jax.jit
def _over_image(inverse: FieldInverse, xd: Float[Array, "n"], yd: Float[Array, "n"]) -> tuple[Float[Array, "n"], ...]:
    return jax.vmap(inverse)(xd, yd)
