"""The camera: a pinhole with lens distortion, from points to pixels and from pixels to rays."""

from collections.abc import Sequence
from typing import Final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxscan.errors import InputError
from jaxscan.precision import Leaf
from jaxscan.rig.lens import Coefficients, distort, undistort, undistorted_change

# The lens ladder: how many radial and tangential coefficients each rung has.
LENSES: Final = {
    "none": (0, 0),
    "radial1": (1, 0),
    "radial2": (2, 0),
    "radial3": (3, 0),
    "brown": (3, 2),
    "rational": (6, 2),
}


class Camera(eqx.Module):
    """A pinhole camera with a lens. Every coefficient is a leaf of its own, so that each can be held or freed.

    Attributes:
        focal: f_u, f_v in pixels.
        principal: u₀, v₀ in pixels; (0, 0) is the centre of the top left pixel.
        radial: k1, k2, k3, k4, k5, k6 as far as the lens goes, with OpenCV's meaning.
        tangential: p1, p2, or nothing.
        image_size: columns and rows.
    """

    focal: tuple[Leaf, Leaf]
    principal: tuple[Leaf, Leaf]
    radial: Coefficients
    tangential: Coefficients
    image_size: tuple[int, int] = eqx.field(static=True)

    @staticmethod
    def create(
        image_size: tuple[int, int],
        focal: ArrayLike | Sequence[float],
        principal: ArrayLike | Sequence[float],
        lens: str = "none",
        radial: ArrayLike | Sequence[float] = (),
        tangential: ArrayLike | Sequence[float] = (),
    ) -> "Camera":
        """A camera from plain numbers, in JAX's present default precision.

        Coefficients that the lens has and that are not given are zero.

        Raises:
            InputError: an unknown lens, or more coefficients than it has.
        """
        n_radial, n_tangential = lens_size(lens)
        f, c, k, p = (jnp.ravel(jnp.asarray(x, dtype=float)) for x in (focal, principal, radial, tangential))
        if f.size != 2 or c.size != 2:
            raise InputError(f"focal and principal take two numbers each; they have {f.size} and {c.size}")
        if k.size > n_radial or p.size > n_tangential:
            raise InputError(
                f'the lens "{lens}" has {n_radial} radial and {n_tangential} tangential coefficients; '
                f"{k.size} and {p.size} were given: choose a richer lens of {', '.join(LENSES)}"
            )
        return Camera(
            focal=(f[0], f[1]),
            principal=(c[0], c[1]),
            radial=tuple(jnp.pad(k, (0, n_radial - k.size))),
            tangential=tuple(jnp.pad(p, (0, n_tangential - p.size))),
            image_size=image_size,
        )

    @property
    def lens(self) -> str:
        """The rung of the lens ladder, by its number of coefficients."""
        return next(name for name, size in LENSES.items() if size == (len(self.radial), len(self.tangential)))

    def zero_terms(self) -> tuple[str, ...]:
        """The names of those lens terms that are zero: in a file mostly terms that were held there, so also here."""
        terms = zip(camera_parameters(self.lens)[4:], (*self.radial, *self.tangential), strict=True)
        return tuple(name for name, term in terms if float(term) == 0)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """A point of the camera frame (mm) to its pixel (u, v); NaN for a point that is not in front of the camera."""
        in_front = point[2] > 0
        depth = jnp.where(in_front, point[2], 1.0)
        x = distort(self.radial, self.tangential, point[:2] / depth)
        pixel = jnp.stack(self.focal) * x + jnp.stack(self.principal)
        return jnp.where(in_front, pixel, jnp.nan)

    def ray(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        """A pixel (u, v) to its ray (x, y, 1); NaN outside the lens's invertible range.

        The inverse is converged, and its derivative with respect to pixel and lens is exact.
        """
        xd = (pixel - jnp.stack(self.principal)) / jnp.stack(self.focal)
        x = undistort(self.radial, self.tangential, xd)
        return jnp.concatenate([x, jnp.ones_like(x[:1])])

    def ray_and_change(
        self, pixel: Float[Array, "2"], along: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """The ray of a pixel, and how it changes for each pixel in the direction `along`."""
        x = self.ray(pixel)
        dx = undistorted_change(self.radial, self.tangential, x[:2], along / jnp.stack(self.focal))
        return x, jnp.concatenate([dx, jnp.zeros_like(dx[:1])])


def camera_parameters(lens: str) -> tuple[str, ...]:
    """The names of a camera's parameters, in the order of its leaves: `camera.focal.0` … `camera.tangential.1`.

    Args:
        lens: a rung of the lens ladder.

    Raises:
        InputError: there is no such lens.
    """
    n_radial, n_tangential = lens_size(lens)
    counts = {"focal": 2, "principal": 2, "radial": n_radial, "tangential": n_tangential}
    return tuple(f"camera.{part}.{i}" for part, count in counts.items() for i in range(count))


def lens_size(lens: str) -> tuple[int, int]:
    """The number of radial and tangential coefficients of a rung of the lens ladder."""
    if lens not in LENSES:
        raise InputError(f'there is no lens "{lens}": use one of {", ".join(LENSES)}')
    return LENSES[lens]
