"""Where the board can be held: poses in a person's coordinates, and the limits within which its points are found.

A place q is six numbers: the pixel (u, v) at which the middle of the board is seen, the logarithm of its depth, two
components of its tilt, and its turn. With s the line of sight to the middle

    R = R(e_z → s) · exp [(q₃, q₄, 0)]× · exp [(0, 0, q₅)]×

so that a board without tilt faces the camera wherever it is held, and the tilt is the angle at which it is seen.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix
from jaxscan.geometry.rotation import skew
from jaxscan.images import Board
from jaxscan.rig import Camera


class Reach(eqx.Module):
    """The limits of where the board can be held.

    Attributes:
        camera: the camera.
        outline: corners of the printed pattern, its outer squares included, in turn, board frame, mm.
        log_depths: of the nearest and the farthest depth of the board's middle.
        tilt: the largest angle between the board's normal and the line of sight, radians.
        margin_px: how far within the image the outline stays.
    """

    camera: Camera
    outline: Float[Array, "4 3"]
    log_depths: Float[Array, "2"]
    tilt: Float[Array, ""]
    margin_px: Float[Array, ""]

    def bounds(self) -> list[tuple[float, float]]:
        """The least and greatest of each of the six numbers. Half a turn shows the same corners again."""
        tilt = float(self.tilt)
        image = [(-0.5, n - 0.5) for n in self.camera.image_size]
        return [
            *image,
            (float(self.log_depths[0]), float(self.log_depths[1])),
            *2 * [(-tilt, tilt)],
            (-np.pi / 2, np.pi / 2),
        ]

    def pose(self, place: Float[Array, "6"]) -> Float[Array, "6"]:
        """T_cam_board of a place, rotation vector and translation; NaN where the lens has no ray for its pixel."""
        ray = self.camera.ray(place[:2])
        sight = ray / jnp.linalg.norm(ray)
        zero = jnp.zeros_like(place[0])
        # Rodrigues' formula for the smallest turn of e_z to s: axis e_z × s, cosine s_z.
        K = skew(jnp.stack([-sight[1], sight[0], zero]))
        facing = jnp.eye(3, dtype=ray.dtype) + K + K @ K / (1 + sight[2])
        tilted = vector_to_matrix(jnp.stack([place[3], place[4], zero]))
        R = facing @ tilted @ vector_to_matrix(jnp.stack([zero, zero, place[5]]))
        return jnp.concatenate([matrix_to_vector(R), jnp.exp(place[2]) * ray - R @ self.outline.mean(axis=0)])

    def excess(self, place: Float[Array, "6"]) -> Float[Array, ""]:
        """How far the limits are overstepped that are no bounds of single numbers: 0 within, else of no unit.

        They are the image, the lens's fold and the tilt. NaN where the lens has no ray for the middle's pixel, and for
        some boards that are partly behind the camera.
        """
        X = jax.vmap(Pose.from_vector(self.pose(place)).apply)(self.outline)
        pixels = jax.vmap(self.camera.project)(X)
        size = jnp.asarray(self.camera.image_size, pixels.dtype)
        low, high = self.margin_px - 0.5, size[None] - 0.5 - self.margin_px
        # Beyond the fold of a lens, and behind the camera, a point has a pixel too.
        widest = self.camera.lens.invertible_radius(pixels.dtype)
        x, _ = jax.vmap(self.camera.chart.coordinates)(X)
        tilt = jnp.hypot(place[3], place[4])
        over = [(low - pixels) / size[None], (pixels - high) / size[None], jnp.hypot(x[:, 0], x[:, 1]) / widest - 1]
        over += [-self.camera.chart.range_of(X) / jnp.exp(place[2]), tilt / self.tilt - 1]
        return sum((jnp.maximum(part, 0.0).sum() for part in over), jnp.zeros(()))


def outline_of(board: Board) -> Float[np.ndarray, "4 3"]:
    """The corners of what is printed: the points and one pitch around them, in turn, mm."""
    points = board.points()
    low, high = points.min(axis=0) - board.pitch_mm, points.max(axis=0) + board.pitch_mm
    return np.array([[low[0], low[1], 0], [high[0], low[1], 0], [high[0], high[1], 0], [low[0], high[1], 0]])
