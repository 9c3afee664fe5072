"""Surfaces through points without an order: Delaunay in a projection, and screened Poisson for closed models.

A scanner's points are a height field as its laser sees them, for what the light does not reach has no points: along a
ray of light there is one point, whatever the object. So the plane to project on stands at right angles to the light
plane, and its normal, the middle of the fan of light, lies in that plane. In it the points are joined by Delaunay's
triangles, and those with a side that is long beside the others are left out: they cross a hole or a depth edge.
"""

from typing import Final

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import Delaunay, KDTree, QhullError

from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.geometry.robust_plane import dominant_plane
from jaxscan.rig import Rig
from jaxscan.rig.light import sheet_axes

# A triangle's side longer than this number of median sides does not belong to the surface.
_LONG: Final = 4.0
_NEIGHBOURS: Final = 16


def light_direction(rig: Rig, laser: str = "") -> Float[np.ndarray, "3"]:
    """The direction of a laser's light in its plane, nearest to the camera's axis, away from the scanner; unit.

    Raises:
        InputError: the rig has no such laser.
    """
    direction = sheet_axes(rig.light(laser))[1]
    return direction if direction[2] > 0 else -direction


def delaunay_surface(
    points: Float[np.ndarray, "points 3"],
    direction: Float[np.ndarray, "3"] | None = None,
    longest_mm: float | None = None,
) -> Int[np.ndarray, "triangles 3"]:
    """Delaunay's triangles of points seen along a direction, anticlockwise as seen against it.

    Args:
        points: mm.
        direction: the way the light goes, by `light_direction`; by default against the normal of the dominant plane.
        longest_mm: the longest side of a triangle; by default four times the median.

    Raises:
        InputError: there are fewer than four points, or they lie on one line as seen along the direction.
    """
    points = np.asarray(points, np.float64)
    if len(points) < 4:
        raise InputError(f"{len(points)} points make no surface: four or more do")
    z = -dominant_plane(points).matrix()[:, 2] if direction is None else np.asarray(direction, np.float64)
    z = -z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    try:
        triangles = Delaunay((points - points.mean(axis=0)) @ np.stack([x, np.cross(z, x)], axis=1)).simplices
    except QhullError as error:
        raise InputError("the points lie on one line as seen along the light: choose another direction") from error
    a, b, c = (points[triangles[:, i]] for i in range(3))
    sides = np.stack([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)])
    longest = _LONG * float(np.median(sides)) if longest_mm is None else longest_mm
    triangles = np.where((np.cross(b - a, c - a) @ z < 0)[:, None], triangles[:, ::-1], triangles)
    triangles = triangles[(sides <= longest).all(axis=0)]
    if not len(triangles):
        raise InputError(f"no triangle has sides of at most {longest:g} mm: give a longer one")
    return triangles


def scattered_normals(
    points: Float[np.ndarray, "points 3"], toward: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "points 3"]:
    """The normal of the plane through each point's 16 nearest neighbours, on the side that faces a place; unit."""
    points = np.asarray(points, np.float64)
    if len(points) < 3:
        raise InputError(f"{len(points)} points have no normals: three or more do")
    near = points[KDTree(points).query(points, min(_NEIGHBOURS, len(points)))[1]]
    near = near - near.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(near.swapaxes(1, 2) @ near)[1][:, :, 0]
    away = ((toward - points) * normal).sum(axis=1) < 0
    return np.where(away[:, None], -normal, normal)


def poisson_surface(
    points: Float[np.ndarray, "points 3"], normals: Float[np.ndarray, "points 3"], depth: int = 8, room: float = 1.1
) -> trimesh.Trimesh:
    """A closed surface through oriented points (Kazhdan and Hoppe, Screened Poisson surface reconstruction, 2013).

    Args:
        points: mm.
        normals: outwards; points whose normal is not finite are left out.
        depth: of the octree: details of 1/2^depth of the object's size.
        room: the cube in which the surface is looked for, and cut off, in sizes of the object.

    Raises:
        InputError: PyMeshLab is not installed, or no surface comes of the points.
    """
    pymeshlab = extra("poisson")
    known = np.isfinite(normals).all(axis=1)
    if known.sum() < 4:
        raise InputError(f"{int(known.sum())} points with a normal make no closed surface: scan more")
    meshes = pymeshlab.MeshSet(verbose=False)
    oriented = pymeshlab.Mesh(points[known].astype(np.float64), v_normals_matrix=normals[known].astype(np.float64))
    meshes.add_mesh(oriented)
    # More threads wait for each other: on two cores they took five times as long.
    try:
        meshes.generate_surface_reconstruction_screened_poisson(depth=depth, scale=room, preclean=True, threads=1)
    except pymeshlab.PyMeshLabException as error:
        raise InputError(f"screened Poisson fails on these points ({error}): use the grid") from error
    found = meshes.current_mesh()
    if not found.face_number():
        raise InputError("screened Poisson finds no surface in these points: use the grid")
    return trimesh.Trimesh(found.vertex_matrix(), found.face_matrix(), process=False)
