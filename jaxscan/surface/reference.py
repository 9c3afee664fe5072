"""What a cloud is compared with: a mesh or another cloud, and how far points are in front of it or behind.

The sign of a distance from a mesh is that of (p − q) · n, with q the nearest point and n the normal there: that of the
triangle, or where q is on an edge or a corner the sum of the normals that meet there, at a corner weighted by the
angles (Bærentzen and Aanæs, Signed distance computation using the angle weighted pseudonormal, 2005). A cloud is taken
for the plane through the 16 points that are nearest to q.
"""

from typing import Final, Protocol

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxscan.geometry.closest import ClosestOnTriangles
from jaxscan.surface.scattered import scattered_normals

# Weights of a triangle's corners below this are none.
_ON_EDGE: Final = 1e-6

Foot = tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]


class Reference(Protocol):
    """A surface to compare with."""

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Its lowest and highest coordinates, mm."""
        ...

    def nearest(self, points: Float[np.ndarray, "points 3"]) -> Foot:
        """The nearest points of the surface (mm), and the unit normals there."""
        ...


def diagonal(reference: Reference) -> float:
    """The diagonal of a surface's box, mm."""
    return float(np.linalg.norm(np.ptp(reference.bounds, axis=0)))


class MeshReference:
    """A triangle mesh; one that is closed and inside out is turned."""

    def __init__(self, mesh: trimesh.Trimesh):
        self.inside_out = bool(mesh.is_watertight and mesh.volume < 0)
        if self.inside_out:
            mesh = mesh.copy()
            mesh.invert()
        self._closest = ClosestOnTriangles(np.asarray(mesh.triangles))
        self._triangles = np.asarray(mesh.triangles)
        self.bounds = np.asarray(mesh.bounds)
        self._corner = np.asarray(mesh.vertex_normals)[mesh.faces]
        self._face = np.asarray(mesh.face_normals)
        sums = np.zeros((len(mesh.edges_unique), 3))
        # Edge k of a triangle goes from its corner k to the next.
        edge = mesh.edges_unique_inverse.reshape(-1, 3)
        for k in range(3):
            np.add.at(sums, edge[:, k], self._face)
        self._edge = sums[edge]

    def nearest(self, points: Float[np.ndarray, "points 3"]) -> Foot:
        """The nearest points on the triangles, and the normals there."""
        foot, triangle = self._closest(points)
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = trimesh.triangles.points_to_barycentric(self._triangles[triangle], foot)
        # A triangle without area has no weights, and no normal but that of its corners.
        weight = np.where(np.isfinite(weight).all(axis=1, keepdims=True), weight, (1.0, 0.0, 0.0))
        none = weight < _ON_EDGE
        rows = np.arange(len(points))
        normal = self._face[triangle]
        # Without weight of corner k the foot is on the edge after it; with weight of k alone it is the corner.
        on_edge, on_corner = none.sum(axis=1) == 1, none.sum(axis=1) >= 2
        normal = np.where(on_edge[:, None], self._edge[triangle, (none.argmax(axis=1) + 1) % 3], normal)
        normal = np.where(on_corner[:, None], self._corner[triangle, weight.argmax(axis=1)][rows], normal)
        return foot, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


class CloudReference:
    """Points of a surface, seen from the origin of their frame."""

    def __init__(self, points: Float[np.ndarray, "points 3"]):
        self._points = np.asarray(points, np.float64)
        self._tree = KDTree(self._points)
        self._normals = scattered_normals(self._points, np.zeros(3))
        self.bounds = np.stack([self._points.min(axis=0), self._points.max(axis=0)])
        # Feet further beside the nearest point than points usually are apart are beyond the surface's rim.
        self._reach = 2.0 * float(np.median(self._tree.query(self._points, 5)[0][:, -1]))

    def nearest(self, points: Float[np.ndarray, "points 3"]) -> Foot:
        """The nearest points on the planes through the points around; beyond the rim the nearest point itself."""
        _, index = self._tree.query(points)
        q, n = self._points[index], self._normals[index]
        foot = points - ((points - q) * n).sum(axis=1, keepdims=True) * n
        beside = np.linalg.norm(foot - q, axis=1) > self._reach
        return np.where(beside[:, None], q, foot), n


def signed_distance(reference: Reference, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    """How far points are from the nearest point of a surface, mm; positive in front of it."""
    points = np.asarray(points, np.float64)
    foot, normal = reference.nearest(points)
    away = points - foot
    return np.copysign(np.linalg.norm(away, axis=1), (away * normal).sum(axis=1))
