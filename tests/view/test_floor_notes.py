"""Heights of a mesh are over the floor that it stood on, which is not in it any more; without one they are z."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxscan.cli.main import main
from jaxscan.files.floor_note import FloorNote, floor_of_lines
from jaxscan.files.mesh import read_mesh, write_trimesh
from jaxscan.reconstruction import write_points
from jaxscan.view.view_data import view_data
from tests.surface.scenes import block


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("floor")
    write_points(folder / "block.npz", block())
    outputs = [word for ending in ("stl", "ply", "obj") for word in ("-o", str(folder / f"block.{ending}"))]
    assert main(["mesh", str(folder / "block.npz"), *outputs]) == 0
    return folder


@pytest.mark.parametrize("ending", ["stl", "ply", "obj"])
def test_a_mesh_has_the_heights_of_its_scan(folder: Path, ending: str):
    scan, mesh = view_data(folder / "block.npz"), view_data(folder / f"block.{ending}")
    assert mesh.colour(None) == "height"
    np.testing.assert_allclose(mesh.up, scan.up, atol=1e-6)
    # The block is 5 mm high and flat: the plane that most of its points lie on is its top.
    assert np.median(mesh.values["height"]) == pytest.approx(5.0, abs=0.05)


def ball_in_front_of_the_camera() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(3, 10.0)
    return ball.apply_translation((3.0, -5.0, 300.0))


def test_without_a_floor_it_is_z_and_up_is_where_the_camera_was(tmp_path: Path):
    write_trimesh(tmp_path / "ball.stl", ball_in_front_of_the_camera())
    shown = view_data(tmp_path / "ball.stl")
    assert shown.colour(None) == "z"
    np.testing.assert_allclose(shown.values["z"], shown.points[:, 2])
    np.testing.assert_array_equal(shown.up, [0, 0, -1])
    write_trimesh(tmp_path / "own.stl", trimesh.creation.icosphere(3, 10.0))
    np.testing.assert_array_equal(view_data(tmp_path / "own.stl").up, [0, 0, 1])


def test_a_note_leaves_the_mesh_as_it_is(tmp_path: Path):
    ball, floor = ball_in_front_of_the_camera(), FloorNote(np.array([0.6, 0.0, -0.8]), 123.4567)
    for ending in ("stl", "obj", "glb"):
        write_trimesh(tmp_path / f"with.{ending}", ball, floor=floor)
        write_trimesh(tmp_path / f"without.{ending}", ball)
        noted, plain = (read_mesh(tmp_path / f"{name}.{ending}") for name in ("with", "without"))
        np.testing.assert_array_equal(noted.vertices, plain.vertices)
        np.testing.assert_array_equal(noted.faces, plain.faces)
    far = FloorNote(np.array([-0.6, 0.0, -0.8]), -123456.789)
    for each in (floor, far):
        write_trimesh(tmp_path / "noted.stl", ball, floor=each)
        shown = view_data(tmp_path / "noted.stl")
        np.testing.assert_allclose(shown.values["height"], each.height(shown.points.astype(float)), atol=1e-3)


@pytest.mark.parametrize("line", ["floor 1 2", "floor 1 1 1 0", "floor nan 0 0 1", "the floor is level", ""])
def test_what_is_no_floor_is_passed_over(line: str):
    assert floor_of_lines([line]) is None
