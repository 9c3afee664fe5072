"""A lens that no formula has: radial and tangential terms of OpenCV's meaning, and a smooth field of shifts on top.

With b(x) what the terms make of a ray and s a cubic B-spline (`rig.spline`) of two components on a grid over the image,

    x_d = b(x) + s(b(x)).

s is a function of where the terms alone would image the ray, so the grid is the image's, and the inverse is that of s,
y + s(y) = x_d, and then that of the terms. (mrcal's LENSMODEL_SPLINED_STEREOGRAPHIC has splines of the ray instead, and
no terms beneath.) What s and the terms both can do, and what a turn of the camera can, is left to these by what is
known of s beforehand (`calibration.lens_field`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.precision import Leaf
from jaxscan.rig import opencv_lens, spline
from jaxscan.rig.lens import solve2
from jaxscan.rig.readable import Readable
from jaxscan.rig.tilted_sensor import off_sensor

# Of the grid, along x and along y: of the shorter side of an image too about as long as of the longer.
CELLS: Final = (10, 8)
KNOTS: Final = (CELLS[0] + spline.MORE_THAN_CELLS) * (CELLS[1] + spline.MORE_THAN_CELLS)
# What the names of its coefficients begin with.
FIELD_NUMBERS: Final = ("camera.shift_x.", "camera.shift_y.")
# As a share of the image, on each side of it.
_MARGIN: Final = 0.02
_MAX_STEPS = 30
# The rounding error of the shift is this multiple of the rounding error of the position.
_CLOSE = 64


class Splined(Readable):
    """OpenCV's terms and a field of shifts. Every number is a leaf of its own, so that each can be held or freed.

    Attributes:
        radial: k1, k2, k3.
        tangential: p1, p2.
        extent: least x_d and y_d of the grid, then the largest; given.
        shift_x: coefficients of s along x, row by row of the grid.
        shift_y: along y.
    """

    kind: ClassVar[str] = "splined"
    numbers: ClassVar[Mapping[str, int]] = {
        "radial": 3,
        "tangential": 2,
        "extent": 4,
        "shift_x": KNOTS,
        "shift_y": KNOTS,
    }
    given: ClassVar[tuple[str, ...]] = ("extent",)
    pinhole: ClassVar[bool] = True

    radial: tuple[Leaf, ...]
    tangential: tuple[Leaf, ...]
    extent: tuple[Leaf, ...]
    shift_x: tuple[Leaf, ...]
    shift_y: tuple[Leaf, ...]

    @classmethod
    def nominal(cls) -> "Splined":
        """Without terms and without shifts, on a grid over everything 45° off the axis."""
        return cls.on_top(opencv_lens.Undistorted((), ()), (-1.0, -1.0, 1.0, 1.0))

    @staticmethod
    def on_top(terms: opencv_lens.OpenCVLens, extent: Sequence[float]) -> "Splined":
        """Without shifts, from a lens of no more terms, those that it lacks zero, and a grid."""
        zero = jnp.zeros(())

        def filled(name: str) -> tuple[Leaf, ...]:
            own = getattr(terms, name)
            return (*own, *(zero for _ in range(Splined.numbers[name] - len(own))))

        return Splined(
            filled("radial"),
            filled("tangential"),
            tuple(jnp.asarray(value, dtype=float) for value in extent),
            *(tuple(zero for _ in range(KNOTS)) for _ in range(2)),
        )

    @property
    def terms(self) -> opencv_lens.Brown:
        """The lens without shifts."""
        return opencv_lens.Brown(self.radial, self.tangential)

    def fault(self) -> tuple[str, str] | None:
        """What is wrong with its numbers, and how to fix it: the name of one, and words; None where nothing is."""
        low_x, low_y, high_x, high_y = (float(leaf) for leaf in self.extent)
        if low_x < high_x and low_y < high_y:
            return None
        return "extent", "must be the least x and y of the grid and then larger ones: calibrate again"

    def distort(self, x: Float[Array, "2"]) -> Float[Array, "2"]:
        """Undistorted to distorted normalised coordinates."""
        return self._shifted(opencv_lens.distort(self.radial, self.tangential, x))

    def undistort(self, xd: Float[Array, "2"]) -> Float[Array, "2"]:
        """Distorted to undistorted normalised coordinates; NaN where the terms or the shifts fold back."""
        return opencv_lens.undistort(self.radial, self.tangential, self.unshifted(xd))

    def invertible_radius(self, dtype: Any) -> Float[Array, ""]:
        """The largest undistorted radius up to which the radial terms can be inverted."""
        return opencv_lens.invertible_radius(self.radial, dtype)[0]

    def unshifted(self, xd: Float[Array, "2"]) -> Float[Array, "2"]:
        """Where the terms alone would image what is imaged at x_d: y + s(y) = x_d, by Newton's method; or NaN."""

        def newton(state: Any) -> Any:
            y, _, n = state
            step = solve2(jax.jacfwd(self._shifted)(y), self._shifted(y) - xd)
            return y - step, jnp.abs(step).max(), n + 1

        tolerance = jnp.finfo(xd.dtype).eps * (1 + jnp.abs(xd).max())
        start = xd - (self._shifted(xd) - xd)
        y, _, _ = jax.lax.while_loop(
            lambda state: (state[1] > tolerance) & (state[2] < _MAX_STEPS),
            newton,
            (start, jnp.full_like(tolerance, jnp.inf), 0),
        )
        J = jax.jacfwd(self._shifted)(y)
        # As many places are imaged at x_d where the shifts fold; the one whose neighbourhood is not turned over counts.
        upright = (J[0, 0] + J[1, 1] > 0) & (J[0, 0] * J[1, 1] > J[0, 1] * J[1, 0])
        found = jnp.abs(self._shifted(y) - xd).max() <= _CLOSE * tolerance
        return jnp.where(upright & found, y, jnp.nan)

    def _shifted(self, y: Float[Array, "2"]) -> Float[Array, "2"]:
        return y + spline.shift((self.shift_x, self.shift_y), self.extent, CELLS, y)


def fields_of_numbers(x: Float[np.ndarray, "n"], y: Float[np.ndarray, "n"]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What each number of the camera beside the field moves, by its name, to first order and but for its size."""
    r2, none, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
    return {
        "camera.focal.0": (x, none),
        "camera.focal.1": (none, y),
        "camera.principal.0": (one, none),
        "camera.principal.1": (none, one),
        **{f"camera.radial.{i}": (x * r2 ** (i + 1), y * r2 ** (i + 1)) for i in range(3)},
        "camera.tangential.0": (2 * x * y, r2 + 2 * y * y),
        "camera.tangential.1": (r2 + 2 * x * x, 2 * x * y),
    }


def grid_over(
    image_size: tuple[int, int],
    focal: Sequence[Leaf | float],
    principal: Sequence[Leaf | float],
    tilt: Sequence[Leaf | float] = (),
) -> Float[np.ndarray, "4"]:
    """The extent of a grid over an image and a little more: the solve moves focal lengths.

    Args:
        image_size: columns and rows.
        focal: f_u, f_v, pixels.
        principal: u₀, v₀, pixels.
        tilt: of the sensor, radians.
    """
    size, f, c = (np.array([float(value) for value in each]) for each in (image_size, focal, principal))
    low, high = -0.5 - _MARGIN * size, size - 0.5 + _MARGIN * size
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    # A tilted sensor's border is of straight lines too.
    seen = np.stack(
        [
            np.asarray(off_sensor(tuple(jnp.asarray(angle) for angle in tilt), jnp.asarray((corner - c) / f)))
            for corner in corners
        ]
    )
    return np.concatenate([seen.min(axis=0), seen.max(axis=0)])
