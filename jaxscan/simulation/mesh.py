"""Triangle meshes as bodies: rays are cast against them by Embree (the extra `mesh-scenes`).

Embree runs on the host, called back from the compiled kernels. Triangles are joined into smooth parts at edges that
bend by less than 30 degrees, so that only creases and outlines are sampled finely.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Bool, Float, Int

from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.geometry.closest import ClosestOnTriangles
from jaxscan.simulation.solids import Matrix, Shape, Vector
from jaxscan.simulation.vector import Rays, Vec, dot, scale, subtract, vec

_CREASE = np.radians(30)
# No more triangles than keys have room for.
_MOST_TRIANGLES = 1 << 24


class Triangles:
    """The triangles of a mesh and how Embree finds them; hashed by identity, so that a mesh compiles once."""

    def __init__(self, mesh: trimesh.Trimesh):
        """Take a mesh in millimetres.

        Raises:
            InputError: Embree is not installed, or the mesh has no triangles or too many.
        """
        extra("mesh-scenes")
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        if not 0 < len(mesh.faces) < _MOST_TRIANGLES:
            raise InputError(f"the mesh has {len(mesh.faces)} triangles: give 1 to {_MOST_TRIANGLES - 1}")
        self.corners = np.asarray(mesh.triangles, np.float64)
        self.parts = _smooth_parts(mesh)
        self._embree = EmbreeScene()
        TriangleMesh(self._embree, self.corners.astype(np.float32))

    def first(self, origins: Any, directions: Any) -> Int[np.ndarray, "rays"]:
        """The triangle that each ray meets first, or −1."""
        return self._embree.run(*_clean(origins, directions), output=True)["primID"].astype(np.int32)

    def blocks(self, origins: Any, directions: Any) -> Bool[np.ndarray, "rays"]:
        """Whether a triangle is met between t = 0 and t = 1."""
        rays = _clean(origins, directions)
        return self._embree.run(*rays, np.ones(len(rays[0]), np.float32), query="OCCLUDED") >= 0


class Mesh(Shape):
    """A triangle mesh, flat between its edges; it should be closed, with normals outwards.

    Attributes:
        normals: unit normals of the triangles, in the mesh's own frame.
        corners: one corner of each triangle, mm.
        R: rotation of the mesh's own frame to the camera frame.
        translation: mm.
        triangles: the rest.
    """

    on_host: ClassVar[bool] = True

    normals: Matrix
    corners: Matrix
    R: Matrix
    translation: Vector
    triangles: Triangles = eqx.field(static=True)

    @staticmethod
    def create(mesh: trimesh.Trimesh) -> "Mesh":
        """A body's shape from a mesh in millimetres, in the mesh's own frame.

        Raises:
            InputError: Embree is not installed, or the mesh has no triangles or too many.
        """
        triangles = Triangles(mesh)
        a, b, c = np.moveaxis(triangles.corners, 1, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return Mesh(normals / np.where(length > 0, length, 1), a, np.eye(3), np.zeros(3), triangles)

    def meet(self, rays: Rays) -> tuple[Float[Array, "*any"], Int[Array, "*any"]]:
        """Embree says which triangle; where the ray crosses its plane is found in the kernel's own precision."""
        local = self._local(rays)
        shape = jax.ShapeDtypeStruct(_shape(local), jnp.int32)
        found = _call(self.triangles.first, shape, local)
        patch = jnp.maximum(found, 0)
        normal, corner = self._of_triangle(self.normals, patch), self._of_triangle(self.corners, patch)
        t = dot(subtract(corner, local.origin), normal) / dot(local.direction, normal)
        return jnp.where((found >= 0) & (t > 0), t, jnp.inf), patch

    def blocks(self, rays: Rays, margin: Float[Array, "*any"]) -> Bool[Array, "*any"]:
        """Embree's any-hit query over the part of the ray between the margins."""
        inner = Rays(rays.at(margin), scale(rays.direction, 1 - 2 * margin))
        local = self._local(inner)
        return _call(self.triangles.blocks, jax.ShapeDtypeStruct(_shape(local), bool), local)

    def normal_at(self, x: Vec, patch: Int[Array, "*any"]) -> Vec:
        """The triangle's."""
        normal = self._of_triangle(self.normals, patch)
        return Vec(*(dot(vec(self.R[i]), normal) for i in range(3)))

    def smooth(self, patch: Int[Array, "*any"]) -> Int[Array, "*any"]:
        """The smooth part that the triangle belongs to."""
        parts = jnp.asarray(self.triangles.parts)
        return parts[jnp.clip(patch, 0, len(parts) - 1)]

    def moved(self, R: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Mesh":
        """Its frame moves."""
        return Mesh(self.normals, self.corners, R @ self.R, R @ self.translation + translation, self.triangles)

    def closest(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """The nearest point of the mesh to each point (mm)."""
        nearest, _ = ClosestOnTriangles(self.triangles.corners)((points - self.translation) @ self.R)
        return nearest @ self.R.T + self.translation

    def _local(self, rays: Rays) -> Rays:
        """Rays in the mesh's own frame."""
        columns = [vec(self.R[:, i]) for i in range(3)]
        origin = subtract(rays.origin, vec(self.translation))
        return Rays(Vec(*(dot(c, origin) for c in columns)), Vec(*(dot(c, rays.direction) for c in columns)))

    def _of_triangle(self, table: Matrix, patch: Int[Array, "*any"]) -> Vec:
        table, patch = jnp.asarray(table), jnp.clip(patch, 0, table.shape[0] - 1)
        return Vec(*(table[:, i][patch] for i in range(3)))


def _smooth_parts(mesh: trimesh.Trimesh) -> Int[np.ndarray, "triangles"]:
    """A number for each triangle that is the same where no crease lies between them."""
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < _CREASE]
    parts = trimesh.graph.connected_component_labels(smooth, node_count=len(mesh.faces))
    return np.asarray(parts, np.int32)


def _shape(rays: Rays) -> tuple[int, ...]:
    return jnp.broadcast_shapes(rays.origin.x.shape, rays.direction.x.shape)


def _call(function: Callable[[Any, Any], Any], result: jax.ShapeDtypeStruct, rays: Rays) -> Any:
    """Call back to the host with rays as two arrays (rays, 3)."""

    def host(*components: Any) -> Any:
        x = [np.broadcast_to(np.asarray(c, np.float32), result.shape).reshape(-1) for c in components]
        found = function(np.stack(x[:3], axis=-1), np.stack(x[3:], axis=-1))
        return found.reshape(result.shape).astype(result.dtype)

    return jax.pure_callback(host, result, *rays.origin, *rays.direction)


def _clean(origins: Any, directions: Any) -> tuple[Any, Any]:
    """A ray that is not a number, outside of the lens's range, becomes one that meets nothing."""
    good = np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1)
    return np.where(good[:, None], origins, 0), np.where(good[:, None], directions, 0)
