"""Colours of a mesh's faces, from the files that programs for meshes save, and the regions that they mark."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from jaxscan.errors import InputError
from jaxscan.files.coloured_faces import ColouredFaces, read_coloured_mesh
from jaxscan.files.srgb import light_of
from jaxscan.geometry import Pose

RED, BLUE = (220, 30, 30), (20, 40, 200)
# As an error names them, with what a byte of light leaves of a dark channel.
NAMED = "#dc1[ce]1[ce], #1[46]2[68]c8"
# The top of a cube of 10 mm is blue.
TOP = 5.0


def cube():
    mesh = trimesh.creation.box((10, 10, 10))
    return mesh, mesh.face_normals[:, 2] > 0.5


def painted(mesh, top):
    colours = np.where(top[:, None], BLUE, RED).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=np.column_stack([colours, np.full(len(top), 255)]))
    return mesh


def stored(path, colour):
    """A colour as the file stores it: glTF stores amounts of light."""
    return tuple(np.rint(255 * light_of(np.array(colour, np.uint8))).astype(int)) if path.suffix == ".glb" else colour


def of_faces(path):
    mesh, top = cube()
    painted(mesh, top).export(path)


def of_corners(path):
    mesh, top = cube()
    apart = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    colours = np.repeat(np.where(top[:, None], stored(path, BLUE), stored(path, RED)), 3, axis=0).astype(np.uint8)
    apart.visual = trimesh.visual.ColorVisuals(apart, vertex_colors=colours)
    apart.export(path)


def of_a_texture(path):
    """The left half of the picture is red, the right one blue."""
    mesh, top = cube()
    corners = mesh.triangles.reshape(-1, 3)
    picture = np.zeros((8, 16, 3), np.uint8)
    picture[:, :8], picture[:, 8:] = RED, BLUE
    uv = np.tile([[0.1, 0.1], [0.3, 0.1], [0.1, 0.9]], (12, 1)) + np.where(np.repeat(top, 3), 0.55, 0.0)[:, None] * [
        1,
        0,
    ]
    material = PBRMaterial(baseColorTexture=Image.fromarray(picture))
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Trimesh(corners, np.arange(36).reshape(-1, 3), visual=visual, process=False).export(path)


def of_two_materials(path):
    mesh, top = cube()
    scene = trimesh.Scene()
    for name, faces, colour in (("top", top, BLUE), ("rest", ~top, RED)):
        some = mesh.submesh([np.flatnonzero(faces)], append=True)
        some.visual = trimesh.visual.TextureVisuals(
            uv=np.zeros((len(some.vertices), 2)),
            material=SimpleMaterial(diffuse=(*stored(path, colour), 255), name=name),
        )
        scene.add_geometry(some, node_name=name)
    scene.export(path)


def of_polygons(path):
    """As MeshLab writes them: squares with a colour each."""
    mesh, _ = cube()
    squares = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 6\nproperty list uchar int vertex_indices\n"
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha")) + "end_header\n"
    lines = [" ".join(f"{c:g}" for c in vertex) for vertex in mesh.vertices]
    for square in squares:
        colour = BLUE if (mesh.vertices[square, 2] > 0).all() else RED
        lines.append(" ".join(map(str, (4, *square, *colour, 255))))
    path.write_text(head + "\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (of_faces, "faces.ply"),
        (of_corners, "corners.ply"),
        (of_corners, "corners.obj"),
        (of_corners, "corners.glb"),
        (of_a_texture, "texture.glb"),
        (of_a_texture, "texture.obj"),
        (of_two_materials, "materials.obj"),
        (of_two_materials, "materials.glb"),
        (of_polygons, "polygons.ply"),
    ],
)
def test_faces_have_their_colours(tmp_path, write, name):
    write(tmp_path / name)
    mesh = read_coloured_mesh(tmp_path / name)
    blue = mesh.faces_of(BLUE)
    assert blue.sum() == 2
    assert mesh.faces_of(RED).sum() == 10
    np.testing.assert_allclose(mesh.triangles[blue][..., 2], TOP)
    with pytest.raises(InputError, match=rf"no face of .* has this colour: its faces have {NAMED}$"):
        mesh.faces_of((0, 255, 0))


def test_a_face_whose_corners_differ_has_no_colour(tmp_path):
    mesh, _ = cube()
    colours = np.where(mesh.vertices[:, 2:] > 0, BLUE, RED).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colours)
    mesh.export(tmp_path / "shared.ply")
    found = read_coloured_mesh(tmp_path / "shared.ply")
    assert (found.faces_of(BLUE).sum(), found.faces_of(RED).sum(), (found.colours < 0).all(axis=1).sum()) == (2, 2, 8)


@pytest.mark.parametrize("name", ["plain.ply", "plain.stl", "plain.obj"])
def test_a_mesh_without_colours_is_refused(tmp_path, name):
    cube()[0].export(tmp_path / name)
    with pytest.raises(InputError, match=f"{name}: its faces have no colours: colour them"):
        read_coloured_mesh(tmp_path / name)
    with pytest.raises(InputError, match=r"none\.ply: there is no such file"):
        read_coloured_mesh(tmp_path / "none.ply")


@pytest.fixture
def region(tmp_path):
    of_faces(tmp_path / "faces.ply")
    return ColouredFaces(read_coloured_mesh(tmp_path / "faces.ply"), BLUE, 1.0)


def test_points_near_the_faces_and_nearer_than_to_others(region):
    points = [
        [0, 0, 5.9],  # above the top
        [0, 0, 6.1],  # too far above
        [0, 0, 4.5],  # below it, inside
        [4.8, 0, 4.5],  # nearer to the side
        [4.5, 0, 4.8],  # nearer to the top
        [5.5, 0, 5.2],  # beyond the edge: as near to both
        [0, 0, -5.0],
    ]
    points = np.array(points, float)
    assert region.holds(points).tolist() == [True, False, True, False, True, True, False]
    # 0.5 mm more on all sides: what is nearer to the side by 0.3 mm is in it.
    assert region.wider(0.5).holds(points).tolist() == [True, True, True, True, True, True, False]
    assert region.scaled(2.0).holds(2 * points).tolist() == region.holds(points).tolist()


def test_the_box_around_it(region):
    low, high = region.bounds()
    assert (low, high) == ((-6.0, -6.0, 4.0), (6.0, 6.0, 6.0))


def test_it_moves_with_its_mesh(region):
    motion = Pose(np.array([0.3, -0.2, 0.1]), np.array([5.0, 1.0, -3.0]))
    there = ColouredFaces(region.mesh.moved(motion), region.colour, region.within)
    points = np.random.default_rng(0).uniform(-7, 7, (500, 3))
    assert 10 < region.holds(points).sum() < 200
    np.testing.assert_array_equal(there.holds(motion.apply(points)), region.holds(points))
