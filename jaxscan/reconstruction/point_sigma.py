"""The standard deviation of a triangulated point along its ray, split into the rig's part and the pixel's.

The range ρ = |X| of a point along its ray is a function of the rig's parameters θ and of the stripe's position v in
its column: σ² = ρ_θ Σ ρ_θᵀ + ρ_v² σ_v², to first order.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxscan.files.rig_file import Covariance
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig
from jaxscan.rig.rig import parameter_names


def point_sigma(
    rig: Rig,
    laser: str,
    covariance: Covariance,
    stripe_sigma_px: float,
    pixels: Float[np.ndarray, "points 2"],
    columns: bool,
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """σ of each point along its ray, of rig and pixel together and of the pixel alone (mm).

    Args:
        rig: the rig.
        laser: which of its lasers.
        covariance: of its parameters.
        stripe_sigma_px: σ of the stripe's position.
        pixels: (u, v) of the stripe points.
        columns: whether v was measured, or u.
    """
    names = parameter_names(rig)
    full = np.zeros((len(names), len(names)))
    at = [names.index(name) for name in covariance.names]
    full[np.ix_(at, at)] = covariance.matrix
    along = np.array([0.0, 1.0]) if columns else np.array([1.0, 0.0])
    with float64():
        of_rig, of_pixel = _sigmas(
            as_float64(rig), laser, jnp.asarray(full), jnp.asarray(along), jnp.asarray(pixels, jnp.float64)
        )
        pixel = np.asarray(of_pixel) * stripe_sigma_px
        return np.hypot(np.asarray(of_rig), pixel), pixel


@eqx.filter_jit
def _sigmas(
    rig: Rig,
    laser: str,
    covariance: Float[Array, "n n"],
    along: Float[Array, "2"],
    pixels: Float[Array, "points 2"],
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    parameters, unravel = ravel_pytree(rig)

    def distance(parameters: Float[Array, "n"], pixel: Float[Array, "2"]) -> Float[Array, ""]:
        rig = unravel(parameters)
        return jnp.linalg.norm(rig.laser(laser).triangulate(rig.camera.ray(pixel)))

    def each(pixel: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        by_rig, by_pixel = jax.grad(distance, argnums=(0, 1))(parameters, pixel)
        return jnp.sqrt(by_rig @ covariance @ by_rig), jnp.abs(by_pixel @ along)

    return jax.vmap(each)(pixels)
