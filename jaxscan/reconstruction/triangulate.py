"""The triangulation kernel: (u, v, step) → point, as one fused pass over millions of stripe points.

With x the undistorted ray of pixel (u, v), ω the light plane and t = −per_step the point of the object frame is

    X_j = (a_j · x) / (ω · x) + t_j n,   a_j the unit vector of coordinate j.

Written so, with the coefficients as arguments, XLA makes one loop of it that reads u, v and n once and writes the
(points, 3) output once. The inverse of the lens is a polynomial there (`lens_inverse`) and costs no iteration.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.reconstruction.lens_inverse import LensInverse, lens_inverse
from jaxscan.rig import Rig


class Kernel(eqx.Module):
    """A rig made ready for triangulation: arrays alone, so that another rig of the same lens does not compile anew.

    Attributes:
        principal: u₀, v₀, pixels.
        inverse_focal: 1 / f_u, 1 / f_v.
        lens: the inverse of the lens; pixels beyond its reach give NaN.
        axes: the unit vectors a_j in rows.
        omega: the light plane, 1/mm, for each coordinate: to divide all three by one number is a pass of its own.
        back: −per_step of the stage, mm.
    """

    principal: Float[Array, "2"]
    inverse_focal: Float[Array, "2"]
    lens: LensInverse
    axes: Float[Array, "3 3"]
    omega: Float[Array, "3 3"]
    back: Float[Array, "3"]

    @staticmethod
    def create(rig: Rig, laser: str = "", dtype: str = "float32") -> "Kernel":
        """The kernel of one laser of a rig.

        Raises:
            InputError: the rig has no such laser, or the inverse of its lens is no smooth function over the image.
        """
        camera, plane = rig.camera, rig.laser(laser)
        back = np.zeros(3) if rig.stage is None else -np.stack(rig.stage.per_step)
        arrays = (
            np.stack(camera.principal),
            1 / np.stack(camera.focal),
            lens_inverse(camera),
            np.eye(3),
            np.tile(np.stack(plane.plane), (3, 1)),
            back,
        )
        return Kernel(*jax.tree.map(lambda array: jnp.asarray(array, dtype), arrays))

    def point(self, u: Float[Array, ""], v: Float[Array, ""], steps: Float[Array, ""]) -> Float[Array, "3"]:
        """One stripe pixel at a motor step count to its point (mm, object frame); NaN where it sees no sheet."""
        xd = (u - self.principal[0]) * self.inverse_focal[0]
        yd = (v - self.principal[1]) * self.inverse_focal[1]
        x, y = self.lens(xd, yd)
        # In brackets, each term is one instruction with the next.
        inverse_depth = self.omega[:, 0] * x + (self.omega[:, 1] * y + self.omega[:, 2])
        point = (self.axes[:, 0] * x + (self.axes[:, 1] * y + self.axes[:, 2])) / inverse_depth + self.back * steps
        # One comparison, NaN beyond the lens: a loop over the conjunction of two is not vectorised, and takes seven
        # times as long.
        return jnp.where(inverse_depth > 0, point, jnp.nan)


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
