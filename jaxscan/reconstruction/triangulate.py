"""The triangulation kernel: stripe pixels of some frames → points of the object frame, as one fused pass over millions.

With x the ray of pixel (u, v), i(x) the inverse depth at which it meets the light and x ↦ A x + b the
motion from the camera's frame to the object's while the frame was taken, the point is

    X_j = (a_j · x) / i(x) + b_j,   a_j the rows of A.

Written so, with the coefficients as arguments and a copy of the light for each coordinate, XLA makes one loop of it
that reads u and v once and writes the points once, whatever the light and the motion are. A number that all three
coordinates share would be a pass of its own. The inverse of the lens is a polynomial there (`lens_inverse`) and costs
no iteration.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from jaxscan.images.stripes.stripe import u_and_v
from jaxscan.kept_programs import compiled
from jaxscan.precision import Leaves, float64
from jaxscan.reconstruction.field_inverse import FieldInverse
from jaxscan.reconstruction.lens_inverse import FittedInverse, TiltedInverse, lens_inverse
from jaxscan.reconstruction.opencv_inverse import LensInverse
from jaxscan.rig import Light, Motion, Positions, Rig
from jaxscan.rig.chart import FLAT, Chart
from jaxscan.rig.light import in_the_middle, nameless


class Kernel(eqx.Module):
    """Camera and light made ready: arrays alone, so that another rig of the same kinds does not compile again.

    Attributes:
        principal: u₀, v₀, pixels.
        inverse_focal: 1 / f_u, 1 / f_v.
        lens: the inverse of lens and sensor; pixels beyond its reach give NaN.
        light: with each of its numbers three times, once for each coordinate; of a light that moves, so for each frame.
        chart: of the lens.
    """

    principal: Float[Array, "2"]
    inverse_focal: Float[Array, "2"]
    lens: LensInverse | FittedInverse | FieldInverse | TiltedInverse
    light: Light
    chart: Chart = eqx.field(static=True, default=FLAT)

    @staticmethod
    def create(rig: Rig, light: str = "", dtype: str = "float32") -> "Kernel":
        """The kernel of one light of a rig; of one that moves, where it stands in the middle of its travel.

        Raises:
            InputError: the rig has no such light, or the inverse of its lens is no smooth function over the image.
        """
        camera = rig.camera
        arrays = (
            np.stack(camera.principal),
            1 / np.stack(camera.focal),
            lens_inverse(camera),
            jax.tree.map(lambda leaf: np.tile(np.asarray(leaf), 3), nameless(in_the_middle(rig.light(light)))),
        )
        # NumPy converts them: JAX would load a program for each shape.
        return Kernel(*jax.tree.map(lambda array: jnp.asarray(np.asarray(array, dtype)), arrays), chart=camera.chart)

    def with_lights(self, lights: Light) -> "Kernel":
        """The same camera, and a light that stands elsewhere in each frame.

        Args:
            lights: a stack of them, one for each frame: each of its numbers is an array.
        """
        return eqx.tree_at(lambda kernel: kernel.light, self, of_frames(lights, 3, self.principal.dtype))

    def point(
        self, light: Light, u: Float[Array, ""], v: Float[Array, ""], A: Float[Array, "3 3"], b: Float[Array, "3"]
    ) -> Float[Array, "3"]:
        """One stripe pixel, where the light stood so, to its point (mm, object frame); NaN where it sees no sheet."""
        xd = (u - self.principal[0]) * self.inverse_focal[0]
        yd = (v - self.principal[1]) * self.inverse_focal[1]
        ray = jnp.stack(self.chart.components(*self.lens(xd, yd)))

        def coordinate(light: Light, a: Float[Array, "3"], b: Float[Array, ""]) -> Float[Array, ""]:
            inverse_depth = light.inverse_depth(ray)
            # In brackets, each term is one instruction with the next.
            found = (a[0] * ray[0] + (a[1] * ray[1] + a[2] * ray[2])) / inverse_depth + b
            # One comparison, NaN beyond the lens: a loop over the conjunction of two is not vectorised, and takes seven
            # times as long.
            return jnp.where(inverse_depth > 0, found, jnp.nan)

        return jax.vmap(coordinate)(light, A, b)


def of_frames(lights: Light, copies: int, dtype: DTypeLike = "float32") -> Light:
    """A stack of lights, one for each frame, with each number in some copies: (frames, copies)."""

    def repeated(leaf: Leaves) -> Float[Array, "frames copies"]:
        return jnp.asarray(np.repeat(np.asarray(leaf, dtype)[:, None], copies, axis=1))

    return jax.tree.map(repeated, nameless(lights))


class FramePoses(eqx.Module):
    """From the camera's frame to the object's while each frame was taken: x ↦ A x + b.

    Attributes:
        A: rotation matrices.
        b: mm.
    """

    A: Float[Array, "frames 3 3"]
    b: Float[Array, "frames 3"]

    @staticmethod
    def create(motion: Motion, q: Positions, frames: int, dtype: str = "float32") -> "FramePoses":
        """The poses of a motion at positions of its axes, one for each frame."""
        with float64():
            moved = motion.pose({axis: np.asarray(steps, np.float64) for axis, steps in q.items()}).inverse()
            A, b = np.asarray(moved.matrix()), np.asarray(moved.translation)
        A, b = np.broadcast_to(A, (frames, 3, 3)), np.broadcast_to(b, (frames, 3))
        return FramePoses(jnp.asarray(A.astype(dtype)), jnp.asarray(b.astype(dtype)))


@compiled()
def triangulate(
    kernel: Kernel, frames: FramePoses, u: Float[Array, "frames lines"], v: Float[Array, "frames lines"]
) -> Float[Array, "frames lines 3"]:
    """Stripe pixels to points of the object frame (mm), in the kernel's precision."""
    of_frame = jax.vmap(kernel.point, in_axes=(None, 0, 0, None, None))
    moves = jax.tree.map(lambda leaf: 0 if leaf.ndim == 2 else None, kernel.light)
    return jax.vmap(of_frame, in_axes=(moves, 0, 0, 0, 0))(kernel.light, u, v, frames.A, frames.b)


def triangulate_stripes(
    kernel: Kernel, frames: FramePoses, position: Float[np.ndarray, "frames lines"], columns: bool
) -> Float[np.ndarray, "frames lines 3"]:
    """Positions of stripes, px, v of each column or u of each row, to points of the object frame, mm."""
    u, v = u_and_v(position, columns)
    return np.asarray(triangulate(kernel, frames, jnp.asarray(u), jnp.asarray(v)))


@partial(jax.jit, donate_argnames="out", keep_unused=True)
def triangulate_into(
    out: Float[Array, "frames lines 3"],
    kernel: Kernel,
    frames: FramePoses,
    u: Float[Array, "frames lines"],
    v: Float[Array, "frames lines"],
) -> Float[Array, "frames lines 3"]:
    """As `triangulate`, into the memory of `out`, an array that is used up.

    For millions of points at a time: new memory is fetched page by page, which takes longer than the
    points.
    """
    return triangulate(kernel, frames, u, v)
