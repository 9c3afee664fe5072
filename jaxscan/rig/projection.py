"""How a camera's pixels move with the point that is seen and with the camera: what every covariance is made of.

A pixel is a function of the two coordinates of its ray (`rig.chart`) and of the camera's numbers θ. A lens of OpenCV's
ladder is looked at as a rational one, whose further terms are zero, and points come in batches of one size: one
compiled function for all of them. A lens of another kind is its own richest.
"""

from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Float64

from jaxscan.kept_programs import compiled
from jaxscan.precision import AT_ONCE, as_float64, batches_of, float64
from jaxscan.rig.camera import Camera, camera_parameters
from jaxscan.rig.chart import Chart
from jaxscan.rig.opencv_lens import LADDER, OpenCVLens, Rational

# A whole image's rays come in larger ones.
_MANY: Final = 8192
# A ray is followed outwards from the axis in this number of steps: beyond a fold of the lens, no pixel belongs to it.
_ON_THE_WAY: Final = 4


@dataclass(frozen=True)
class Projection:
    """Pixels of points, and their derivatives.

    Attributes:
        pixels: (u, v); NaN for a point that the lens does not see.
        by_point: by the point's coordinates in the camera frame, px for each mm.
        by_ray: by the coordinates of its ray in the lens's chart, px.
        turns: the ray itself by these coordinates.
        by_camera: by the camera's leaves in their order; by those of the richest lens where that was asked for.
    """

    pixels: Float64[np.ndarray, "points 2"]
    by_point: Float64[np.ndarray, "points 2 3"]
    by_ray: Float64[np.ndarray, "points 2 2"]
    turns: Float64[np.ndarray, "points 3 2"]
    by_camera: Float64[np.ndarray, "points 2 leaves"]


def lens_leaves(lens: str, *, tilted: bool = False) -> Bool[np.ndarray, "leaves"]:
    """Which leaves of a camera with the richest lens of its kind one with this lens has; its sensor tilted or not."""
    richest = Rational.kind if lens in LADDER else lens
    return np.isin(camera_parameters(richest, tilted=tilted), camera_parameters(lens, tilted=tilted))


def with_richest_lens(camera: Camera) -> Camera:
    """The same camera with all terms of the richest lens of its kind, those that it lacks zero."""
    lens = camera.lens.rational() if isinstance(camera.lens, OpenCVLens) else camera.lens
    return Camera(camera.focal, camera.principal, lens, camera.image_size, camera.tilt)


def project_points(camera: Camera, points: Float[np.ndarray, "points 3"], *, richest: bool = False) -> Projection:
    """The pixels of points of the camera frame (mm), with their derivatives.

    Args:
        camera: any.
        points: camera frame, mm.
        richest: whether derivatives are by all terms of the richest lens.
    """
    x, x_by_point, turns = _coordinates(camera.chart, points)
    pixels, by_ray, by_camera = _by_ray(camera, x)
    own = lens_leaves(camera.lens.kind, tilted=bool(camera.tilt))
    return Projection(pixels, by_ray @ x_by_point, by_ray, turns, by_camera if richest else by_camera[..., own])


def pixel_rays(camera: Camera, pixels: Float[np.ndarray, "*grid 2"]) -> Float64[np.ndarray, "*grid 3"]:
    """The rays of pixels, as `Camera.ray`; NaN outside the lens's invertible range, and for a pixel that is NaN."""
    flat = pixels.reshape(-1, 2)
    size = AT_ONCE if len(flat) < _MANY else _MANY
    with float64():
        exact = as_float64(camera)
        batches = [np.asarray(_rays(exact, batch)) for batch in batches_of(flat, size)]
    return np.concatenate(batches)[: len(flat)].reshape(*pixels.shape[:-1], 3)


def off_axis(rays: Float[np.ndarray, "*rays 3"]) -> Float[np.ndarray, "*rays"]:
    """The angle between the camera's axis and each ray, radians; NaN of no ray."""
    return np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])


def within_fold(camera: Camera, points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether the lens is one to one all the way from its axis to a point's ray: beyond, its pixel is another's."""
    along = np.linspace(0, 1, _ON_THE_WAY + 1)[1:]
    x = _coordinates(camera.chart, points)[0]
    by_ray = _by_ray(camera, (along[:, None, None] * x).reshape(-1, 2))[1]
    # Symmetric but for focal lengths and a tilt: positive definite where its trace and its determinant are positive.
    with np.errstate(invalid="ignore"):
        grows = (np.trace(by_ray, axis1=1, axis2=2) > 0) & (np.linalg.det(by_ray) > 0)
    return grows.reshape(_ON_THE_WAY, -1).all(axis=0)


def _coordinates(
    chart: Chart, points: Float[np.ndarray, "points 3"]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points 2 3"], Float[np.ndarray, "points 3 2"]]:
    """Those of points' rays, NaN where they have none; how they move with the point, and the ray with them."""
    with float64():
        parts = [[np.asarray(part) for part in _charted(chart, batch)] for batch in batches_of(points)]
    x, by_point, turns = (np.concatenate(part)[: len(points)] for part in zip(*parts, strict=True))
    return x, by_point, turns


def _by_ray(
    camera: Camera, x: Float[np.ndarray, "points 2"]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points 2 2"], Float[np.ndarray, "points 2 leaves"]]:
    with float64():
        richest = as_float64(with_richest_lens(camera))
        parts = [[np.asarray(part) for part in _pixels(richest, batch)] for batch in batches_of(x)]
    pixels, by_ray, by_camera = (np.concatenate(part)[: len(x)] for part in zip(*parts, strict=True))
    return pixels, by_ray, by_camera


@compiled(static_argnames="chart")
def _charted(
    chart: Chart, points: Float[Array, "batch 3"]
) -> tuple[Float[Array, "batch 2"], Float[Array, "batch 2 3"], Float[Array, "batch 3 2"]]:
    def coordinates(point: Float[Array, "3"]) -> tuple[Float[Array, "2"], tuple[Float[Array, "2"], Bool[Array, ""]]]:
        x, there = chart.coordinates(point)
        return x, (x, there)

    def each(point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Float[Array, "2 3"], Float[Array, "3 2"]]:
        by_point, (x, there) = jax.jacfwd(coordinates, has_aux=True)(point)
        turns = jax.jacfwd(lambda x: jnp.stack(chart.components(x[0], x[1])))(x)
        return jnp.where(there, x, jnp.nan), by_point, turns

    return jax.vmap(each)(points)


@compiled(filtered=True)
def _rays(camera: Camera, pixels: Float[Array, "batch 2"]) -> Float[Array, "batch 3"]:
    return jax.vmap(camera.ray)(pixels)


@compiled(filtered=True)
def _pixels(
    camera: Camera, x: Float[Array, "batch 2"]
) -> tuple[Float[Array, "batch 2"], Float[Array, "batch 2 2"], Float[Array, "batch 2 leaves"]]:
    theta, unravel = ravel_pytree(camera)

    def pixel(x: Float[Array, "2"], theta: Float[Array, "leaves"]) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        seen = unravel(theta).image(x)
        return seen, seen

    def each(x: Float[Array, "2"]) -> tuple[Float[Array, "2"], Float[Array, "2 2"], Float[Array, "2 leaves"]]:
        (by_ray, by_camera), seen = jax.jacfwd(pixel, argnums=(0, 1), has_aux=True)(x, theta)
        return seen, by_ray, by_camera

    return jax.vmap(each)(x)
