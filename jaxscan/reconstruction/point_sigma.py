"""How well a triangulated point is known: the rig's part and the pixel's.

A point of the object frame, X = x(u, v) / (ω · x) − n · per_step, is a function of the rig's parameters θ and of the
stripe's position s in its column (or row): its covariance is X_θ Σ X_θᵀ + X_s σ_s² X_sᵀ, to first order. Along the ray,
with d its direction, that is (d · X_θ) Σ (d · X_θ)ᵀ + (d · X_s)² σ_s².
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxscan.precision import as_float64, float64
from jaxscan.rig import Covariance, Rig
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.rig import parameter_names


@dataclass(frozen=True)
class PointCovariance:
    """The covariance of points of the object frame, mm².

    Attributes:
        rig: what comes from the rig's parameters: common to all points, and so no noise that an average removes.
        pixel: what comes from the stripe's position in this very photograph.
    """

    rig: Float[np.ndarray, "points 3 3"]
    pixel: Float[np.ndarray, "points 3 3"]

    @property
    def total(self) -> Float[np.ndarray, "points 3 3"]:
        """Both together."""
        return self.rig + self.pixel


def point_covariance(
    rig: Rig,
    laser: str,
    covariance: Covariance,
    stripe_sigma_px: float,
    pixels: Float[np.ndarray, "points 2"],
    steps: Float[np.ndarray, "points"],
    columns: bool,
) -> PointCovariance:
    """The covariance of each triangulated point.

    Args:
        rig: the rig.
        laser: which of its lasers; "" for the only one.
        covariance: of its parameters.
        stripe_sigma_px: σ of the stripe's position.
        pixels: (u, v) of the stripe points.
        steps: motor step count of each.
        columns: whether v was measured, or u.
    """
    with float64():
        of_rig, of_pixel = (
            np.asarray(J) for J in _jacobians(as_float64(rig), laser, *_as_arrays(pixels, steps, columns))
        )
    return PointCovariance(
        rig=of_rig @ covariance.of_leaves(rig) @ np.swapaxes(of_rig, 1, 2),
        pixel=stripe_sigma_px**2 * of_pixel[:, :, None] * of_pixel[:, None, :],
    )


def point_sigma(
    rig: Rig,
    laser: str,
    covariance: Covariance,
    stripe_sigma_px: float | Float[np.ndarray, "points"],
    pixels: Float[np.ndarray, "points 2"],
    steps: Float[np.ndarray, "points"],
    columns: bool,
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """σ of each point along its ray, of rig and pixel together and of the pixel alone (mm).

    The arguments are those of `point_covariance`; σ of the stripe may be one for each point.
    """
    return sigma_of(rig, covariance, stripe_sigma_px, *ray_jacobian(rig, laser, pixels, steps, columns))


def sigma_of(
    rig: Rig,
    covariance: Covariance,
    stripe_sigma_px: float | Float[np.ndarray, "points"],
    of_rig: Float[np.ndarray, "points leaves"],
    of_pixel: Float[np.ndarray, "points"],
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """What `point_sigma` gives, of the derivatives that `ray_jacobian` gives."""
    variance = np.einsum("pi,ij,pj->p", of_rig, covariance.of_leaves(rig), of_rig)
    pixel = np.abs(of_pixel) * stripe_sigma_px
    return np.sqrt(variance + pixel**2), pixel


def ray_jacobian(
    rig: Rig,
    laser: str,
    pixels: Float[np.ndarray, "points 2"],
    steps: Float[np.ndarray, "points"],
    columns: bool,
) -> tuple[Float[np.ndarray, "points leaves"], Float[np.ndarray, "points"]]:
    """How far each point moves along its ray with the rig's leaves, in their order, and with the stripe's position.

    The arguments are those of `point_covariance`; mm for each unit of the parameters, mm for each pixel.
    """
    return jacobian_along(rig, laser, pixel_rays(rig.camera, pixels), steps, columns)


def jacobian_along(
    rig: Rig,
    laser: str,
    rays: Float[np.ndarray, "points 3"],
    steps: Float[np.ndarray, "points"],
    columns: bool,
) -> tuple[Float[np.ndarray, "points leaves"], Float[np.ndarray, "points"]]:
    """What `ray_jacobian` gives, for points on rays (x, y, 1) that are known.

    With the pixel p = π(x; θ) held, ∂x/∂θ = −(∂π/∂x)⁻¹ ∂π/∂θ and ∂x/∂s = (∂π/∂x)⁻¹ e: no lens is inverted. With
    z = 1 / (ω · x) the point z x moves by dz x + z dx, dz = −z² (dω · x + ω · dx), and by −n · per_step with the stage.
    """
    sheet = rig.laser(laser)
    omega = np.stack([float(c) for c in sheet.plane])
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.where(rays @ omega > 0, 1 / (rays @ omega), np.nan)
        seen = project_points(rig.camera, rays)
        along = np.array([[0.0], [1.0]] if columns else [[1.0], [0.0]])
        right = np.concatenate([-seen.by_camera, np.broadcast_to(along, (len(rays), 2, 1))], axis=2)
        dx = np.full(right.shape, np.nan)
        whole = np.isfinite(seen.by_ray).all(axis=(1, 2)) & np.isfinite(z)
        dx[whole] = np.linalg.solve(seen.by_ray[whole], right[whole])
    length = np.linalg.norm(rays, axis=1)
    of_x = (z / length)[:, None] * rays[:, :2] - (z**2 * length)[:, None] * omega[:2]
    moved = np.einsum("pi,pij->pj", of_x, dx)
    names = parameter_names(rig)
    J = np.zeros((len(rays), len(names)))
    J[:, : moved.shape[1] - 1] = moved[:, :-1]
    stem = f"laser.{sheet.name}.plane" if sheet.name else "laser.plane"
    J[:, [names.index(f"{stem}.{i}") for i in range(3)]] = -(z**2 * length)[:, None] * rays
    if rig.stage is not None:
        J[:, [names.index(f"stage.per_step.{i}") for i in range(3)]] = -(steps / length)[:, None] * rays
    J[~whole] = np.nan
    return J, moved[:, -1]


def _as_arrays(
    pixels: Float[np.ndarray, "points 2"], steps: Float[np.ndarray, "points"], columns: bool
) -> tuple[Float[Array, "points 2"], Float[Array, "points"], Float[Array, "2"]]:
    along = jnp.asarray([0.0, 1.0] if columns else [1.0, 0.0])
    return jnp.asarray(pixels, jnp.float64), jnp.asarray(steps, jnp.float64), along


@eqx.filter_jit
def _jacobians(
    rig: Rig,
    laser: str,
    pixels: Float[Array, "points 2"],
    steps: Float[Array, "points"],
    along: Float[Array, "2"],
) -> tuple[Float[Array, "points 3 leaves"], Float[Array, "points 3"]]:
    """∂X/∂θ and ∂X/∂s of each point."""
    theta, unravel = ravel_pytree(rig)

    def each(pixel: Float[Array, "2"], count: Float[Array, ""]) -> tuple[Float[Array, "3 leaves"], Float[Array, "3"]]:
        def coordinates(theta: Float[Array, "leaves"], s: Float[Array, ""]) -> Float[Array, "3"]:
            return unravel(theta).triangulate(pixel + s * along, count, laser)

        return jax.jacrev(coordinates, argnums=(0, 1))(theta, jnp.zeros(()))

    return jax.vmap(each)(pixels, steps)
