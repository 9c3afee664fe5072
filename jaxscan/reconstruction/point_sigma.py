"""How well a triangulated point is known: the rig's part and the pixel's.

A point of the object frame, X = M(q)⁻¹ (x(u, v) z), is a function of the rig's parameters θ and of the
stripe's position s in its column (or row): its covariance is X_θ Σ X_θᵀ + X_s σ_s² X_sᵀ, to first order. Along the ray,
with d its direction, that is (d · X_θ) Σ (d · X_θ)ᵀ + (d · X_s)² σ_s².
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Real

from jaxscan.buckets import bucket
from jaxscan.kept_programs import compiled
from jaxscan.precision import as_float64, batches_of, float64
from jaxscan.rig import Covariance, Motion, MovingLight, Positions, Rig
from jaxscan.rig.light import inverse_depths
from jaxscan.rig.motion import origin_shift
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.rig import leaves_of, parameter_names

# Motor steps of each axis, by its name, of as many points as there are.
PositionsOfPoints = Mapping[str, Real[np.ndarray, "points"]]


@dataclass(frozen=True)
class PointCovariance:
    """The covariance of points of the object frame, mm².

    Attributes:
        rig: what comes from the rig's parameters: common to all points, so an average does not remove it.
        pixel: what comes from the stripe's position in this photograph.
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
    q: PositionsOfPoints,
    columns: bool,
) -> PointCovariance:
    """The covariance of each triangulated point.

    Args:
        rig: the rig.
        laser: which of its lasers; "" for the only one.
        covariance: of its parameters.
        stripe_sigma_px: σ of the stripe's position.
        pixels: (u, v) of the stripe points.
        q: positions of the axes at each, motor steps.
        columns: whether v was measured, or u.
    """
    with float64():
        of_rig, of_pixel = (np.asarray(J) for J in _jacobians(as_float64(rig), laser, *_as_arrays(pixels, q, columns)))
    return PointCovariance(
        rig=of_rig @ covariance.of_leaves(rig) @ np.swapaxes(of_rig, 1, 2),
        pixel=stripe_sigma_px**2 * of_pixel[:, :, None] * of_pixel[:, None, :],
    )


def point_jacobians(
    rig: Rig,
    laser: str,
    pixels: Float[np.ndarray, "points 2"],
    q: PositionsOfPoints,
    columns: bool,
) -> tuple[Float[np.ndarray, "points 3 leaves"], Float[np.ndarray, "points 3"]]:
    """How each point of the object frame moves with the rig's leaves, in their order, and with the stripe's position.

    The arguments are those of `point_covariance`; mm for each unit of the parameters, mm for each pixel. Points come
    in batches of one size, so that any number of them shares one compiled function.
    """
    with float64():
        exact, padded = as_float64(rig), {axis: _batches(np.asarray(steps, np.float64)) for axis, steps in q.items()}
        parts = [
            _jacobians(exact, laser, *_as_arrays(batch, {axis: steps[i] for axis, steps in padded.items()}, columns))
            for i, batch in enumerate(batches_of(pixels))
        ]
    of_rig, of_pixel = (np.concatenate([np.asarray(part[k]) for part in parts])[: len(pixels)] for k in (0, 1))
    return of_rig, of_pixel


def _batches(steps: Float[np.ndarray, "points"]) -> Float[np.ndarray, "batches size"]:
    return batches_of(steps[:, None])[..., 0]


def point_sigma(
    rig: Rig,
    laser: str,
    covariance: Covariance,
    stripe_sigma_px: float | Float[np.ndarray, "points"],
    pixels: Float[np.ndarray, "points 2"],
    q: PositionsOfPoints,
    columns: bool,
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """σ of each point along its ray, of rig and pixel together and of the pixel alone (mm).

    The arguments are those of `point_covariance`; σ of the stripe may be one for each point.
    """
    return sigma_of(rig, covariance, stripe_sigma_px, *ray_jacobian(rig, laser, pixels, q, columns))


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


def rig_part(sigma: Float[np.ndarray, "*points"], pixel: Float[np.ndarray, "*points"]) -> Float[np.ndarray, "*points"]:
    """What is left of σ without the pixel's part."""
    return np.sqrt(np.maximum(sigma**2 - pixel**2, 0.0))


def ray_jacobian(
    rig: Rig,
    laser: str,
    pixels: Float[np.ndarray, "points 2"],
    q: PositionsOfPoints,
    columns: bool,
) -> tuple[Float[np.ndarray, "points leaves"], Float[np.ndarray, "points"]]:
    """How far each point moves along its ray with the rig's leaves, in their order, and with the stripe's position.

    The arguments are those of `point_covariance`; mm for each unit of the parameters, mm for each pixel.
    """
    return jacobian_along(rig, laser, pixel_rays(rig.camera, pixels), q, columns)


def jacobian_along(
    rig: Rig,
    laser: str,
    rays: Float[np.ndarray, "points 3"],
    q: PositionsOfPoints,
    columns: bool,
) -> tuple[Float[np.ndarray, "points leaves"], Float[np.ndarray, "points"]]:
    """What `ray_jacobian` gives, for points on rays that are known, of the length that the camera gives them.

    With the pixel p = π(x; θ) held, x the ray's coordinates in the lens's chart, ∂x/∂θ = −(∂π/∂x)⁻¹ ∂π/∂θ and
    ∂x/∂s = (∂π/∂x)⁻¹ e: no lens is inverted. With them the ray moves by dr = (∂r/∂x) dx. With the inverse depth
    w(r; θ), z = 1 / w, the point z r moves by dz r + z dr, dz = −z² dw; the motion moves it by −d · o, o how far it
    moves what it brings to the camera's centre (`rig.motion.origin_shift`).
    """
    which = rig.lights.index(rig.light(laser))
    light = rig.lights[which]
    at = q.get(light.axis) if isinstance(light, MovingLight) else None
    w, w_by_ray, w_by_numbers = inverse_depths(light, rays, at)
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.where(w > 0, 1 / w, np.nan)
        seen = project_points(rig.camera, rays)
        along = np.array([[0.0], [1.0]] if columns else [[1.0], [0.0]])
        right = np.concatenate([-seen.by_camera, np.broadcast_to(along, (len(rays), 2, 1))], axis=2)
        dx = np.full(right.shape, np.nan)
        whole = np.isfinite(seen.by_ray).all(axis=(1, 2)) & np.isfinite(z)
        dx[whole] = np.linalg.solve(seen.by_ray[whole], right[whole])
    length = np.linalg.norm(rays, axis=1)
    of_ray = (z / length)[:, None] * rays - (z**2 * length)[:, None] * w_by_ray
    moved = np.einsum("pi,pik,pkj->pj", of_ray, seen.turns, dx)
    J = np.zeros((len(rays), len(parameter_names(rig))))
    J[:, : moved.shape[1] - 1] = moved[:, :-1]
    J[:, leaves_of(rig, f"lights.{which}.")] = -(z**2 * length)[:, None] * w_by_numbers
    if at := leaves_of(rig, "motion."):
        shifts = motion_shifts(rig, q, len(rays))
        J[:, at] = -np.einsum("pi,pij->pj", rays / length[:, None], shifts)
    J[~whole] = np.nan
    return J, moved[:, -1]


def motion_shifts(rig: Rig, q: PositionsOfPoints, count: int) -> Float[np.ndarray, "points 3 numbers"]:
    """Derivative of the motion's shift of the camera's centre (mm) by the motion's parameters, at `count` positions."""
    with float64():
        # Padded to the next size of a coarse series, so that a few frames more do not compile again.
        padded = {axis: np.resize(np.asarray(steps, np.float64), bucket(count)) for axis, steps in q.items()}
        shifts = np.asarray(_motion_shifts(as_float64(rig.motion), jax.tree.map(jnp.asarray, padded)))
    return np.broadcast_to(shifts, (max(len(shifts), count), *shifts.shape[1:]))[:count]


@compiled(filtered=True)
def _motion_shifts(motion: Motion, q: Positions) -> Float[Array, "points 3 numbers"]:
    numbers, unravel = ravel_pytree(motion)
    shifts = jax.jacfwd(lambda other: origin_shift(motion, q, unravel(other)))(numbers)
    return shifts if shifts.ndim == 3 else shifts[None]


def _as_arrays(
    pixels: Float[np.ndarray, "points 2"], q: PositionsOfPoints, columns: bool
) -> tuple[Float[Array, "points 2"], dict[str, Float[Array, "points"]], Float[Array, "2"]]:
    along = jnp.asarray([0.0, 1.0] if columns else [1.0, 0.0])
    return jnp.asarray(pixels, jnp.float64), {axis: jnp.asarray(steps, jnp.float64) for axis, steps in q.items()}, along


@compiled(filtered=True)
def _jacobians(
    rig: Rig,
    laser: str,
    pixels: Float[Array, "points 2"],
    q: Positions,
    along: Float[Array, "2"],
) -> tuple[Float[Array, "points 3 leaves"], Float[Array, "points 3"]]:
    """∂X/∂θ and ∂X/∂s of each point."""
    theta, unravel = ravel_pytree(rig)

    def each(pixel: Float[Array, "2"], q: Positions) -> tuple[Float[Array, "3 leaves"], Float[Array, "3"]]:
        def coordinates(theta: Float[Array, "leaves"], s: Float[Array, ""]) -> Float[Array, "3"]:
            return unravel(theta).triangulate(pixel + s * along, q, laser)

        return jax.jacrev(coordinates, argnums=(0, 1))(theta, jnp.zeros(()))

    return jax.vmap(each)(pixels, q)
