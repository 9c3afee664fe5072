"""Triangle meshes from files, by trimesh."""

from pathlib import Path

import trimesh

from jaxscan.errors import InputError


def read_mesh(path: Path) -> trimesh.Trimesh:
    """A triangle mesh, from any file that trimesh reads.

    Raises:
        InputError: the file is missing, cannot be read, or holds no triangles.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: check the name")
    try:
        mesh = trimesh.load_mesh(path)
    except Exception as error:  # each of its readers raises what it likes
        raise InputError(f"{path}: cannot be read as a mesh ({error}): give an STL, PLY, OBJ or the like") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise InputError(f"{path}: holds no triangles: give an STL, PLY, OBJ or the like")
    return mesh
