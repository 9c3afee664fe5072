"""Triangle meshes: read from any file that trimesh reads, PLY by our own reader; written as STL, OBJ, GLB and PLY."""

import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Float32, Int, UInt8
from trimesh.visual import ColorVisuals

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud, check_points, cloud_of, shown_colours, vertices_of
from jaxscan.files.floor_note import FloorNote, stl_with_floor
from jaxscan.files.glb import write_coloured_glb
from jaxscan.files.ply import Column, Element, Lists, Ply
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.ply_write import write_ply_file
from jaxscan.files.srgb import srgb_of
from jaxscan.foreign import foreign
from jaxscan.images.sampled import sampled
from jaxscan.images.shaded import TextureMap
from jaxscan.missing import no_such_file

_UNREADABLE: Final = ("cannot be read as a mesh", "give an STL, PLY, OBJ or the like")
_INDICES: Final = ("vertex_indices", "vertex_index")


def read_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """A triangle mesh; larger faces are cut into triangles.

    Raises:
        InputError: the file is missing, cannot be read, holds no triangles, or a vertex that is no point.
    """
    path = Path(path)
    if not path.is_file():
        raise no_such_file(Path(path))
    if path.suffix.lower() == ".ply":
        return mesh_of(path, read_ply_file(path))
    with foreign(path, *_UNREADABLE):
        mesh = _scene(path).to_mesh()
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise _no_triangles(path)
        return _checked(path, mesh)


def mesh_pieces(path: str | os.PathLike[str]) -> list[trimesh.Trimesh]:
    """The triangle meshes of a file, not a PLY, in one frame: each material by itself, vertices as they are.

    Raises:
        InputError: as `read_mesh`.
    """
    path = Path(path)
    if not path.is_file():
        raise no_such_file(Path(path))
    with foreign(path, *_UNREADABLE):
        pieces = _scene(path).dump()
        pieces = [each for each in pieces if isinstance(each, trimesh.Trimesh) and len(each.faces)]
        if not pieces:
            raise _no_triangles(path)
        return [_checked(path, each, merge=False) for each in pieces]


def colours_of(mesh: trimesh.Trimesh) -> tuple[UInt8[np.ndarray, "vertices 3"] | None, TextureMap | None]:
    """The colours of a mesh's vertices and its texture, where the file that `read_mesh` read has them."""
    visual: Any = mesh.visual
    if visual.kind in ("vertex", "face"):
        return np.asarray(visual.vertex_colors)[:, :3].astype(np.uint8), None
    if visual.kind != "texture" or np.shape(visual.uv) != (len(mesh.vertices), 2):
        return None, None
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is None:
        return None, None
    picture = np.asarray(image.convert("RGB"))
    rows, columns = picture.shape[:2]
    # trimesh has v upwards.
    u, v = np.asarray(visual.uv, np.float64).T
    pixels = np.stack([u * columns - 0.5, (1.0 - v) * rows - 0.5], axis=1)
    return np.rint(sampled(picture, pixels)).astype(np.uint8), TextureMap(pixels, picture)


def has_faces(content: Ply) -> bool:
    """Whether a PLY file holds a surface, and not points alone."""
    return "face" in content.elements and content.elements["face"].count > 0


def mesh_of(path: str | os.PathLike[str], content: Ply, *, merge: bool = True) -> trimesh.Trimesh:
    """The triangles of what was read from a PLY file; vertices in one place become one, unless they are kept.

    Raises:
        InputError: there are none, or a face names a vertex that there is not.
    """
    if not has_faces(content):
        raise _no_triangles(path)
    cloud = cloud_of(path, content)
    columns = content.elements["face"].columns
    faces = next((columns[name] for name in _INDICES if name in columns), None)
    if not isinstance(faces, Lists):
        raise InputError(f"{path}: its faces have no list {_INDICES[0]}: check which file it is")
    triangles = _fans(faces)
    if not len(triangles):
        raise _no_triangles(path)
    _check_faces(path, triangles, len(cloud.points))
    return _checked(path, trimesh.Trimesh(cloud.points, triangles, process=False), merge)


def write_mesh_ply(
    path: str | os.PathLike[str],
    vertices: Cloud,
    triangles: Int[np.ndarray, "triangles 3"],
    quads: Int[np.ndarray, "quads 4"] | None = None,
    normals: Float32[np.ndarray, "vertices 3"] | None = None,
    floor: FloorNote | None = None,
) -> None:
    """Write a mesh with what is known of its vertices, and of the floor, as PLY, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    faces = Lists.equal(triangles.astype(np.int32, copy=False))
    if quads is not None:
        more = Lists.equal(quads.astype(np.int32, copy=False))
        faces = Lists(np.concatenate([more.counts, faces.counts]), np.concatenate([more.values, faces.values]))
    columns: dict[str, Column] = {_INDICES[0]: faces}
    vertex = vertices_of(vertices)
    if normals is not None:
        vertex.columns.update(zip(("nx", "ny", "nz"), normals.T, strict=True))
    elements = {"vertex": vertex, "face": Element(len(faces), columns)}
    notes = () if floor is None else (f"comment {floor.words()}",)
    write_ply_file(path, Ply(elements, comments=("comment units mm", *notes)))


def write_trimesh(
    path: str | os.PathLike[str],
    mesh: trimesh.Trimesh,
    colours: UInt8[np.ndarray, "vertices 3"] | None = None,
    floor: FloorNote | None = None,
) -> None:
    """Write a mesh as .stl, .obj or .glb, by the path's ending, whole or not at all; numbers are millimetres.

    Args:
        path: the file.
        mesh: without colours.
        colours: of its vertices, which .obj and .glb have; 0, 0, 0 for one without, which is written grey.
        floor: that it stood on, which .stl and .obj note.

    Raises:
        InputError: the file cannot be written.
    """
    if colours is not None:
        colours = shown_colours(colours)
        if Path(path).suffix.lower() == ".glb":
            write_coloured_glb(path, mesh.vertices, mesh.faces, mesh.vertex_normals, colours)
            return
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False)
    content: Any = mesh.export(file_type=Path(path).suffix.lower()[1:])
    content = content.encode() if isinstance(content, str) else content
    ending = Path(path).suffix.lower()
    if floor is not None and ending == ".stl":
        content = stl_with_floor(content, floor)
    elif floor is not None and ending == ".obj":
        content = f"# jaxscan, mm, {floor.words()}\n".encode() + content
    with replacing(path) as file:
        file.write(content)


def _scene(path: Path) -> trimesh.Scene:
    """What a file holds, with colours in sRGB: glTF stores amounts of light, for vertices and for materials."""
    scene = trimesh.load_scene(path, process=False)
    if path.suffix.lower() in (".glb", ".gltf"):
        for mesh in scene.geometry.values():
            if isinstance(mesh, trimesh.Trimesh):
                _as_shown(mesh)
    return scene


def _as_shown(mesh: Any) -> None:
    if mesh.visual.kind == "vertex":
        mesh.visual.vertex_colors[:, :3] = srgb_of(mesh.visual.vertex_colors[:, :3] / 255)
    elif mesh.visual.kind == "texture":
        material, light = mesh.visual.material, mesh.visual.vertex_attributes.get("color")
        given = getattr(material, "baseColorFactor", None)
        factor = np.ones(4) if given is None else np.asarray(given) / 255
        if light is not None and getattr(material, "baseColorTexture", None) is None:
            # Whole numbers stand for 0 to 1.
            full = 1.0 if light.dtype.kind == "f" else np.iinfo(light.dtype).max
            mesh.visual = ColorVisuals(mesh, vertex_colors=srgb_of(light[:, :3] / full * factor[:3]))
        elif given is not None:
            material.baseColorFactor = np.append(srgb_of(factor[:3]), np.uint8(255))


def _fans(faces: Lists) -> Int[np.ndarray, "triangles 3"]:
    """Every polygon of n corners as the n − 2 triangles that its first corner spans."""
    counts, values = faces.counts.astype(np.int64), faces.values.astype(np.int64)
    first = np.cumsum(counts) - counts
    each = np.maximum(counts - 2, 0)
    start = np.repeat(first, each)
    step = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    return values[np.stack([start, start + step + 1, start + step + 2], axis=1)]


def _checked(path: str | os.PathLike[str], mesh: trimesh.Trimesh, merge: bool = True) -> trimesh.Trimesh:
    _check_faces(path, mesh.faces, len(mesh.vertices))
    check_points(path, np.asarray(mesh.vertices), "vertices", "repair it")
    if merge:
        mesh.merge_vertices()
    return mesh


def _check_faces(path: str | os.PathLike[str], faces: Int[np.ndarray, "triangles 3"], n_vertices: int) -> None:
    """Refuse faces of vertices that there are not.

    Raises:
        InputError: there is one.
    """
    wrong = (faces < 0) | (faces >= n_vertices)
    if wrong.any():
        raise InputError(
            f"{path}: a face names vertex {faces[wrong][0]}, there are {n_vertices}: copy or write it again"
        )


def _no_triangles(path: str | os.PathLike[str]) -> InputError:
    return InputError(f"{path}: holds no triangles: give an STL, PLY, OBJ or the like")
