"""A scene: bodies, of which some stand on the stage and move with it.

All coordinates are those of the camera frame; a body on the stage is described as it stands with all axes at 0.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.geometry import Pose
from jaxscan.simulation.solids import Shape, Vector
from jaxscan.simulation.vector import Rays, Vec, dot, scale, select

# Patches of one body are counted below this, so that body and patch make one key.
_PATCHES = 1 << 24


class Body(eqx.Module):
    """A shape and how it reflects light: evenly into all directions (Lambert), and the lamp's like a mirror if glossy.

    Attributes:
        shape: what it is.
        albedo: red, green, blue, each 0 to 1.
        on_stage: whether it moves with the stage.
        glossy: whether the lamp has a highlight in it.
    """

    shape: Shape
    albedo: Vector
    on_stage: bool = eqx.field(static=True, default=True)
    glossy: bool = eqx.field(static=True, default=False)

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Body":
        """The body after x ↦ R x + translation (mm)."""
        return replace(self, shape=self.shape.moved(R, translation))


class Scene(eqx.Module):
    """Bodies in front of a backdrop that no light reaches.

    Attributes:
        bodies: at least one.
        backdrop: red, green, blue of rays that meet no body, in grey levels.
    """

    bodies: tuple[Body, ...]
    backdrop: Vector = (6.0, 6.0, 6.0)

    def carried(self, pose: Pose[np.ndarray]) -> "Scene":
        """The scene after what moves has been carried to a pose (T_camera_object)."""
        R, t = pose.matrix(), pose.translation
        bodies = tuple(body.moved(R, t) if body.on_stage else body for body in self.bodies)
        return Scene(bodies, self.backdrop)

    @property
    def on_host(self) -> bool:
        """Whether any shape has to be met on the host."""
        return any(body.shape.on_host for body in self.bodies)

    def cast(self, dtype: type) -> "Scene":
        """The same scene with every number in one precision."""
        return jax.tree.map(lambda x: np.asarray(x, dtype), self)

    def trace(self, rays: Rays) -> tuple[Float[Array, "*any"], Int[Array, "*any"]]:
        """Where rays meet the nearest body.

        Returns:
            The ray parameter, infinite where nothing is met, and the key of body and patch, −1 for nothing.
        """
        t, key = jnp.full_like(rays.direction.x, jnp.inf), jnp.full_like(rays.direction.x, -1, dtype=jnp.int32)
        for i, body in enumerate(self.bodies):
            t_body, patch = body.shape.meet(rays)
            nearer = t_body < t
            t = jnp.where(nearer, t_body, t)
            key = jnp.where(nearer, _PATCHES * i + patch, key)
        return t, key

    def smooth(self, key: Int[Array, "*any"]) -> Int[Array, "*any"]:
        """Key to another that differs only across edges."""
        smooth = key
        for i, body in enumerate(self.bodies):
            smooth = jnp.where(_of_body(key, i), _PATCHES * i + body.shape.smooth(key % _PATCHES), smooth)
        return smooth

    def normal(self, x: Vec, key: Int[Array, "*any"]) -> Vec:
        """The unit normal of a point that was met, on the camera's side; zero where none was."""
        zero = jnp.zeros_like(x.x)
        normal = Vec(zero, zero, zero)
        for i, body in enumerate(self.bodies):
            normal = select(_of_body(key, i), body.shape.normal_at(x, key % _PATCHES), normal)
        return scale(normal, jnp.where(dot(normal, x) > 0, -1.0, 1.0))

    def albedo(self, key: Int[Array, "*any"]) -> Float[Array, "rgb *any"]:
        """Red, green and blue albedo of what was met; zero where nothing was."""
        key = key[None]
        albedo = jnp.zeros((3,) + (1,) * (key.ndim - 1))
        for i, body in enumerate(self.bodies):
            own = jnp.asarray(body.albedo).reshape((3,) + (1,) * (key.ndim - 1))
            albedo = jnp.where(_of_body(key, i), body.shape.tone(key % _PATCHES) * own, albedo)
        return albedo

    def glossy(self, key: Int[Array, "*any"]) -> Bool[Array, "*any"]:
        """Whether what was met is glossy."""
        glossy = jnp.zeros_like(key, dtype=bool)
        for i, body in enumerate(self.bodies):
            glossy = glossy | (body.glossy & _of_body(key, i))
        return glossy

    def blocks(self, rays: Rays, margin: Float[Array, "*any"]) -> Bool[Array, "*any"]:
        """Whether any body is met between t = margin and t = 1 − margin."""
        blocked = jnp.zeros_like(rays.direction.x, dtype=bool)
        for body in self.bodies:
            blocked = blocked | body.shape.blocks(rays, margin)
        return blocked


def _of_body(key: Int[Array, "*any"], i: int) -> Bool[Array, "*any"]:
    return (key >= _PATCHES * i) & (key < _PATCHES * (i + 1))
