"""The lens: from the ray of a point to where it is imaged, and back, in normalised coordinates.

A ray is two numbers, in the chart that the kind has (`rig.chart`): (X / Z, Y / Z) where it names none.

Which kinds there are is listed in `rig.kinds`. A kind says of itself where a ray goes and which ray comes from there.
Derivatives of the way back are made here, by the implicit function theorem: from x_d = f(x, k) follows
dx = f_x⁻¹ (dx_d − f_k dk), whatever the iterations did that found x.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@runtime_checkable
class Lens(Protocol):
    """What a lens does to rays. A pytree of tuples of leaves, one tuple for each of its `numbers`.

    A ray (x, y) is imaged at (x_d, y_d); the pixel is f_u x_d + u₀, f_v y_d + v₀. Its numbers stand in `rig.json`
    beside the camera's own, so none of them is called `focal`, `principal`, `image_size`, `tilt` or `lens`.

    Attributes:
        kind: what the rig file and `--lens` call it.
        numbers: its numbers in their order, and how many each has.
        pinhole: whether its nominal form leaves rays as they are.

    A kind that sees at 90° to its axis and beyond has besides `chart = AROUND`, with (x, y) in the sense of that.
    """

    kind: ClassVar[str]
    numbers: ClassVar[Mapping[str, int]]
    pinhole: ClassVar[bool]

    @classmethod
    def nominal(cls) -> "Lens":
        """The lens from which a solve starts: with the terms of this kind at zero."""
        ...

    def distort(self, x: Float[Array, "2"]) -> Float[Array, "2"]:
        """Where the ray (x, y) is imaged; with derivatives, on the axis too."""
        ...

    def undistort(self, xd: Float[Array, "2"]) -> Float[Array, "2"]:
        """The inverse, converged; NaN where it has none. Its derivatives are not asked for if the lens has numbers."""
        ...

    def invertible_radius(self, dtype: Any) -> Float[Array, ""]:
        """The largest |x| up to which rays in all directions are imaged in one to one fashion."""
        ...


def undistort(lens: Lens, xd: Float[Array, "2"]) -> Float[Array, "2"]:
    """The ray (x, y) of distorted coordinates, with exact derivatives; NaN outside the lens's invertible range."""
    # Of one without numbers, a pinhole, the way back is as plain as the way there.
    return _undistort(lens, xd) if jax.tree.leaves(lens) else lens.undistort(xd)


@jax.custom_jvp
def _undistort(lens: Lens, xd: Float[Array, "2"]) -> Float[Array, "2"]:
    return lens.undistort(xd)


@_undistort.defjvp
def _undistort_jvp(primals: Any, tangents: Any) -> Any:
    lens, xd = primals
    lens_dot, xd_dot = tangents
    x = _undistort(lens, xd)
    _, moved = jax.jvp(lambda lens: lens.distort(x), (lens,), (lens_dot,))
    return x, undistorted_change(lens, x, xd_dot - moved)


def undistorted_change(lens: Lens, x: Float[Array, "2"], xd_dot: Float[Array, "2"]) -> Float[Array, "2"]:
    """How undistorted coordinates x move when the distorted ones move by xd_dot: f_x⁻¹ xd_dot."""
    return solve2(jax.jacfwd(lens.distort)(x), xd_dot)


def solve2(J: Float[Array, "2 2"], b: Float[Array, "2"]) -> Float[Array, "2"]:
    """J⁻¹ b."""
    det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    return jnp.stack([J[1, 1] * b[0] - J[0, 1] * b[1], J[0, 0] * b[1] - J[1, 0] * b[0]]) / det
