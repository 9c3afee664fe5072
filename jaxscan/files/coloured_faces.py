"""Regions of a part that a reference mesh marks by colour: the faces of one colour, and what lies near them."""

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Bool, Float, UInt8

from jaxscan.errors import InputError
from jaxscan.files.cloud import COLOURS, cloud_of
from jaxscan.files.mesh import colours_of, mesh_of, mesh_pieces
from jaxscan.files.ply import Lists, Ply
from jaxscan.files.ply_read import read_ply_file
from jaxscan.geometry import Pose
from jaxscan.geometry.closest import ClosestOnTriangles
from jaxscan.images.sampled import sampled
from jaxscan.phrases import first_few

# Programs round a colour when they save it; two colours that differ by no more than this in each channel are one.
_SAME_COLOUR: Final = 8
# How many of the mesh's colours an error names.
_NAMED: Final = 6
# Two computations of one distance agree to this, mm.
_ROUNDED_MM: Final = 1e-9


@dataclass(frozen=True, eq=False)
class ColouredMesh:
    """A mesh whose faces have colours.

    Attributes:
        path: the file.
        triangles: the corners of its faces, mm.
        colours: red, green, blue of each face, 0 to 255; -1 for a face without one.
    """

    path: Path
    triangles: Float[np.ndarray, "faces 3 3"]
    colours: Float[np.ndarray, "faces 3"]

    @cached_property
    def closest(self) -> ClosestOnTriangles:
        """Its faces, ready to be asked for the nearest one."""
        return ClosestOnTriangles(self.triangles)

    @cached_property
    def _of_colours(self) -> dict[tuple[int, int, int], tuple[Float[np.ndarray, "some 3 3"], ClosestOnTriangles]]:
        return {}

    def of(self, colour: tuple[int, int, int]) -> tuple[Float[np.ndarray, "some 3 3"], ClosestOnTriangles]:
        """The faces of a colour, and the same ready to be asked for the nearest one; made once for each colour.

        Raises:
            InputError: no face has it; it names the colours that there are.
        """
        if colour not in self._of_colours:
            triangles = self.triangles[self.faces_of(colour)]
            self._of_colours[colour] = triangles, ClosestOnTriangles(triangles)
        return self._of_colours[colour]

    def scaled(self, by: float) -> "ColouredMesh":
        """The mesh with all coordinates times a factor."""
        return replace(self, triangles=by * self.triangles)

    def moved(self, motion: Pose) -> "ColouredMesh":
        """The mesh in another frame."""
        return replace(self, triangles=motion.apply(self.triangles.reshape(-1, 3)).reshape(-1, 3, 3))

    def faces_of(self, colour: tuple[int, int, int]) -> Bool[np.ndarray, "faces"]:
        """Which faces have a colour.

        Raises:
            InputError: none has; it names the colours that there are.
        """
        chosen = (np.abs(self.colours - np.asarray(colour)) <= _SAME_COLOUR).all(axis=1)
        if not chosen.any():
            raise InputError(f"no face of {self.path} has this colour: its faces have {self._most()}")
        return np.asarray(chosen)

    def _most(self) -> str:
        there, count = np.unique(self.colours[self.colours[:, 0] >= 0], axis=0, return_counts=True)
        most = np.argsort(-count, kind="stable")
        return first_few([written_colour(there[i]) for i in most], _NAMED)


@dataclass(frozen=True, eq=False)
class ColouredFaces:
    """Where points are looked for: near the faces of one colour, and nearer to them than to all others.

    Attributes:
        mesh: in the object frame.
        colour: red, green, blue, 0 to 255.
        within: how far from the faces the region goes, mm.
        beside: by how much another face may be nearer, mm.
    """

    mesh: ColouredMesh
    colour: tuple[int, int, int]
    within: float
    beside: float = 0.0

    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The corners of the box around it."""
        corners = self.mesh.of(self.colour)[0].reshape(-1, 3)
        return tuple((corners.min(axis=0) - self.within).tolist()), tuple((corners.max(axis=0) + self.within).tolist())

    def wider(self, by: float) -> "ColouredFaces":
        """The region, grown by this distance (mm) on all sides."""
        return replace(self, within=self.within + by, beside=self.beside + by)

    def scaled(self, by: float) -> "ColouredFaces":
        """The region with all its lengths times a factor."""
        return replace(self, mesh=self.mesh.scaled(by), within=by * self.within, beside=by * self.beside)

    def holds(self, points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Which points lie in it."""
        holds = np.zeros(len(points), bool)
        low, high = self.bounds()
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        away = _distance(self.mesh.of(self.colour)[1], points[near])
        near, away = near[away <= self.within], away[away <= self.within]
        holds[near] = away <= _distance(self.mesh.closest, points[near]) + self.beside + _ROUNDED_MM
        return holds


def read_coloured_mesh(path: str | os.PathLike[str]) -> ColouredMesh:
    """A mesh with the colours of its faces, mm.

    Colours are those of faces, of a texture at their middles, or of corners: a face has the colour in which its three
    corners agree.

    Raises:
        InputError: the file is refused, or has no colours.
    """
    path = Path(path)
    if path.suffix.lower() == ".ply" and path.is_file():
        content = read_ply_file(path)
        mesh = mesh_of(path, content, merge=False)
        triangles, colours = mesh.triangles, _of_ply(path, content, mesh)
    else:
        # Each material by itself: put together, they would share a picture, and mix at its seams.
        pieces = mesh_pieces(path)
        triangles = np.concatenate([mesh.triangles for mesh in pieces])
        colours = np.concatenate([_of_visual(mesh) for mesh in pieces])
    if colours is None or (colours < 0).all():
        raise InputError(
            f"{path}: its faces have no colours: colour them in a program for meshes, and save a PLY, OBJ or GLB"
        )
    return ColouredMesh(path, np.asarray(triangles, np.float64), colours)


def written_colour(colour: Any) -> str:
    """A colour as `part.toml` has it: #rrggbb."""
    return "#" + "".join(f"{int(channel):02x}" for channel in colour)


def _distance(closest: ClosestOnTriangles, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    return np.linalg.norm(closest(points)[0] - points, axis=1)


def _of_ply(path: Path, content: Ply, mesh: trimesh.Trimesh) -> Float[np.ndarray, "faces 3"] | None:
    columns = content.elements["face"].columns
    channels = [columns.get(name) for name in COLOURS]
    if all(isinstance(channel, np.ndarray) and channel.dtype == np.uint8 for channel in channels):
        polygons = next(column for column in columns.values() if isinstance(column, Lists))
        each = np.stack([np.asarray(channel, np.float64) for channel in channels], axis=-1)
        return np.repeat(each, np.maximum(polygons.counts.astype(int) - 2, 0), axis=0)
    return _of_corners(mesh, cloud_of(path, content).colours)


def _of_visual(mesh: trimesh.Trimesh) -> Float[np.ndarray, "faces 3"]:
    visual: Any = mesh.visual
    if visual.kind == "face":
        return np.asarray(visual.face_colors)[:, :3].astype(np.float64)
    corners, texture = colours_of(mesh)
    if texture is not None:
        return sampled(texture.picture, texture.pixels[mesh.faces].mean(axis=1))
    if corners is None and visual.kind == "texture":
        return np.tile(np.asarray(visual.material.main_color[:3], np.float64), (len(mesh.faces), 1))
    colours = _of_corners(mesh, corners)
    return np.full((len(mesh.faces), 3), -1.0) if colours is None else colours


def _of_corners(
    mesh: trimesh.Trimesh, corners: UInt8[np.ndarray, "vertices 3"] | None
) -> Float[np.ndarray, "faces 3"] | None:
    if corners is None:
        return None
    each = corners[mesh.faces].astype(np.float64)
    one = (np.ptp(each, axis=1) <= _SAME_COLOUR).all(axis=1)
    return np.where(one[:, None], each[:, 0], -1.0)
