"""The inverse of a splined lens without iterations: a table of shifts over the image, then OpenCV's terms.

The field's own inverse y + s(y) = x_d is smooth as s is, so over a small part of a cell y − x_d is a polynomial of the
second degree along x and y, to a share of a thousandth of a pixel. All parts are looked up in one table.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.reconstruction.opencv_inverse import FIT_LIMIT_PX, LensInverse, opencv_inverse
from jaxscan.rig.splined import CELLS, Splined

# Into how many parts a cell of the grid is cut along each axis; the first serves most lenses, as one compiled kernel.
_PARTS = (4, 8, 16)
# Where each part's polynomial is that of the lens, −1 to 1, and what makes coefficients of the values there.
_NODES = np.cos(np.pi * (np.arange(3) + 0.5) / 3)
_MARGIN = 1e-3
_COEFFICIENTS = np.linalg.inv(np.vander(_NODES, increasing=True))


class FieldInverse(eqx.Module):
    """The inverse of a lens with a field of shifts.

    Attributes:
        low: x_d and y_d at which the table begins.
        scale: parts for each unit of them.
        table: of each part, of y − x_d along x and along y, the coefficients of the polynomial in (f, g): f^i g^j.
        lens: the inverse of the terms.
    """

    low: Float[Array, "2"]
    scale: Float[Array, "2"]
    table: Float[Array, "rows columns 18"]
    lens: LensInverse

    def __call__(self, xd: Float[Array, ""], yd: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Undistorted coordinates; NaN beyond the reach of the terms, and where the field has no inverse."""
        rows, columns, _ = self.table.shape
        t, u = (xd - self.low[0]) * self.scale[0], (yd - self.low[1]) * self.scale[1]
        i, j = jnp.clip(t.astype(jnp.int32), 0, columns - 1), jnp.clip(u.astype(jnp.int32), 0, rows - 1)
        # Beyond the table, which is larger than the image, with the value at its border.
        f, g = jnp.clip(2 * (t - i) - 1, -1, 1), jnp.clip(2 * (u - j) - 1, -1, 1)
        c = self.table[j, i]
        a, b = (_polynomial(c[k : k + 9], f, g) for k in (0, 9))
        return self.lens(xd + a, yd + b)


def _polynomial(c: Float[Array, "9"], f: Float[Array, ""], g: Float[Array, ""]) -> Float[Array, ""]:
    low, middle, high = (c[k] + f * (c[k + 1] + f * c[k + 2]) for k in (0, 3, 6))
    return low + g * (middle + g * high)


def field_inverse(lens: Splined, xd: Float[np.ndarray, "n 2"], focal: float) -> FieldInverse | None:
    """The inverse of a lens, in float64; None where it is not met to a thousandth of a pixel.

    Inside a `float64` block.

    Args:
        lens: with float64 leaves.
        xd: distorted rays all over the image.
        focal: pixels.
    """
    exact = np.asarray(_unshifted(lens, jnp.asarray(xd)))
    there = np.isfinite(exact).all(axis=1)
    terms = opencv_inverse(lens.terms, exact[there], focal) if there.any() else None
    if terms is None:
        return None
    low, high = xd.min(axis=0), xd.max(axis=0)
    low, high = low - _MARGIN * (high - low), high + _MARGIN * (high - low)
    for parts in _PARTS:
        count = np.array(CELLS) * parts
        scale = count / (high - low)
        x, y = (low[k] + (np.arange(count[k])[:, None] + 0.5 + 0.5 * _NODES).ravel() / scale[k] for k in (0, 1))
        at = np.stack(np.meshgrid(x, y), axis=-1)
        off = (np.asarray(_unshifted(lens, jnp.asarray(at.reshape(-1, 2)))).reshape(at.shape) - at).reshape(
            count[1], 3, count[0], 3, 2
        )
        table = np.einsum("jb,ia,rbcak->rckji", _COEFFICIENTS, _COEFFICIENTS, off).reshape(count[1], count[0], 18)
        found = FieldInverse(*map(jnp.asarray, (low, scale, table)), terms)
        shifts = np.stack(_over_image(found, *jnp.asarray(xd.T)), axis=1)
        error = focal * np.linalg.norm((shifts - np.asarray(_exact(lens, jnp.asarray(xd))))[there], axis=1)
        # What the terms' inverse does not reach is not there.
        if (error[np.isfinite(error)] <= FIT_LIMIT_PX).all():
            return found
    return None


@jax.jit
def _unshifted(lens: Splined, xd: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    return jax.vmap(lens.unshifted)(xd)


@jax.jit
def _exact(lens: Splined, xd: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    return jax.vmap(lens.undistort)(xd)


@jax.jit
def _over_image(inverse: FieldInverse, xd: Float[Array, "n"], yd: Float[Array, "n"]) -> tuple[Float[Array, "n"], ...]:
    return jax.vmap(inverse)(xd, yd)
