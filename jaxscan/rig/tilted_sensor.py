"""A sensor that is tilted against its lens (Scheimpflug): from a sensor at right angles to the axis to it, and back.

With R = R_y(τ_y) R_x(τ_x), a point (x_d, y_d) that the lens images is moved along its ray to the tilted plane (M.
Louhichi et al. 2007; `tauX`, `tauY` of OpenCV's `calib3d`, whose matrix this is, multiplied out):

    x_t = cos τ_x x_d / w                                 w = cos τ_x cos τ_y + sin τ_y x_d − sin τ_x cos τ_y y_d
    y_t = (cos τ_y y_d − sin τ_x sin τ_y x_d) / w

The axis stays where it is, at (0, 0), and so does the scale there. The way back is

    x_d = cos τ_y x_t / w'                                w' = 1 − cos τ_x sin τ_y x_t + sin τ_x y_t
    y_d = (cos τ_x y_t + sin τ_x sin τ_y x_t) / w'
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.precision import Leaf


def onto_sensor(tilt: Sequence[Leaf], xd: Float[Array, "2"]) -> Float[Array, "2"]:
    """Normalised coordinates behind the lens to those on the sensor; NaN for what does not meet it.

    Args:
        tilt: τ_x, τ_y in radians; empty for a sensor that is not tilted.
        xd: as the lens distorts.
    """
    if not tilt:
        return xd
    (cx, sx), (cy, sy) = ((jnp.cos(angle), jnp.sin(angle)) for angle in tilt)
    along = jnp.stack([cx * xd[0], cy * xd[1] - sx * sy * xd[0]])
    return _divided(along, cx * cy + sy * xd[0] - sx * cy * xd[1])


def off_sensor(tilt: Sequence[Leaf], xt: Float[Array, "2"]) -> Float[Array, "2"]:
    """The inverse of `onto_sensor`; NaN where no ray comes from."""
    if not tilt:
        return xt
    (cx, sx), (cy, sy) = ((jnp.cos(angle), jnp.sin(angle)) for angle in tilt)
    along = jnp.stack([cy * xt[0], cx * xt[1] + sx * sy * xt[0]])
    return _divided(along, 1 - cx * sy * xt[0] + sx * xt[1])


def change_off_sensor(tilt: Sequence[Leaf], xt: Float[Array, "2"], xt_dot: Float[Array, "2"]) -> Float[Array, "2"]:
    """How `off_sensor` moves when coordinates on the sensor move by xt_dot."""
    return jax.jvp(lambda xt: off_sensor(tilt, xt), (xt,), (xt_dot,))[1] if tilt else xt_dot


def _divided(along: Float[Array, "2"], w: Float[Array, ""]) -> Float[Array, "2"]:
    meets = w > 0
    return jnp.where(meets, along / jnp.where(meets, w, 1.0), jnp.nan)
