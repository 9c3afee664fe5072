"""Textures against the truth of simulated scans, read back by another program."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from benchmarks.texture import errors, looked_up
from jaxscan.cli.main import main
from jaxscan.files.mesh import colours_of, read_mesh
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import read_scan, write_scan
from jaxscan.reconstruction import read_range_image, write_points
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.scene import Body
from jaxscan.simulation.solids import Box, Sphere
from tests.surface import scenes

from benchmarks.colour import ROOM, coloured_things  # isort: skip

SEED = 203


def run(*words: object) -> None:
    assert main([str(word) for word in words]) == 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Balls and a printed box along the stage, 2 mm from frame to frame; each step without the laser too."""
    folder = tmp_path_factory.mktemp("texture")
    rig = rig_2003.simulated_rig(SEED)
    scene = rig_2003.scan_scene(rig, coloured_things(SEED))
    simulate_scan(folder / "scan", rig, scene, SEED, frames=37, steps_apart=2000, lighting=ROOM, laser_off=True)
    write_scan(replace(read_scan(folder / "scan"), path=folder / "alone.toml", backgrounds=()))
    write_rig(folder / "rig.json", RigFile(rig))
    run("reconstruct", folder / "scan", "--rig", folder / "rig.json", "-o", folder / "a.npz")
    return folder


def against_truth(folder: Path, glb: Path) -> dict[str, float]:
    rig = rig_2003.simulated_rig(SEED)
    points = read_range_image(folder / "a.npz").points
    return errors(rig, rig_2003.scan_scene(rig, coloured_things(SEED)), {"stage": 36000}, glb, points)


def photographs(folder: Path, scan: str = "scan") -> list[object]:
    return ["--photographs", folder / scan, "--rig", folder / "rig.json"]


def test_photographs_fill_the_texture(folder, tmp_path, capsys) -> None:
    run("mesh", folder / "a.npz", "--floor", "keep", *photographs(folder), "-o", tmp_path / "a.glb")
    said = capsys.readouterr().out
    assert "from photographs" in said
    found = against_truth(folder, tmp_path / "a.glb")
    assert found["compared"] > 40
    assert found["rms"] < 3
    assert found["at_seams"] < 3
    assert found["grey"] < 0.1
    run("mesh", folder / "a.npz", "--floor", "keep", "-o", tmp_path / "b.glb")
    assert "100.0 % between points" in capsys.readouterr().out
    by_points = against_truth(folder, tmp_path / "b.glb")
    assert by_points["rms"] < 3
    # Between frames only photographs know where a print ends.
    assert found["beside_edges"] < 0.7 * by_points["beside_edges"]


def test_photographs_with_the_stripe_in_them(folder, tmp_path) -> None:
    run("mesh", folder / "a.npz", "--floor", "keep", *photographs(folder, "alone.toml"), "-o", tmp_path / "a.glb")
    found = against_truth(folder, tmp_path / "a.glb")
    assert found["rms"] < 3
    assert found["at_seams"] < 3


def test_fewer_triangles_keep_the_texture(folder, tmp_path) -> None:
    """The colours of vertices lose what a texture keeps where a mesh is reduced."""
    pytest.importorskip("fast_simplification", reason="the extra simplify is not installed")
    run(
        "mesh", folder / "a.npz", "--floor", "keep", "--simplify", "1500", *photographs(folder), "-o",
        tmp_path / "a.glb",
    )  # fmt: skip
    assert against_truth(folder, tmp_path / "a.glb")["rms"] < 3


@pytest.mark.long
def test_a_turn_from_all_around(tmp_path, capsys) -> None:
    """A box of a side of its own colour each: the fused surface has each colour on its side."""
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(31), 31)
    bodies = (
        Body(Box(np.array([0.0, 14.0, 9.0]), np.eye(3), np.array([14.0, 9.0, 9.0])), np.array([0.3, 0.8, 0.35])),
        Body(Sphere(np.array([0.0, 14.0, 22.0]), 7.0), np.array([0.4, 0.4, 0.9])),
    )
    scene = rig_2003.scan_scene(rig, bodies)
    axes = rig_2003.turning_axes(64)
    simulate_scan(tmp_path / "scan", rig, scene, 31, axes=axes, lighting=ROOM, laser_off=True)
    write_rig(tmp_path / "rig.json", RigFile(rig))
    run("reconstruct", tmp_path / "scan", "--rig", tmp_path / "rig.json", "-o", tmp_path / "a.npz")
    run("mesh", tmp_path / "a.npz", *photographs(tmp_path), "-o", tmp_path / "a.glb")
    assert "fused" in capsys.readouterr().out
    found = looked_up(tmp_path / "a.glb", 20_000)
    R, origin = rig_2003.platform(rig)
    z = ((found.points - origin) @ R)[:, 2]
    share = found.colours / found.colours.sum(axis=1, keepdims=True)
    # The light falls from above: walls have none.
    box, ball = np.abs(z - 18) < 0.5, z > 23
    assert min(box.sum(), ball.sum()) > 500
    assert (share[box, 1] > 0.45).mean() > 0.97
    assert (share[ball, 2] > 0.45).mean() > 0.97


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain ball on the axis, turned once around; the stripe is in each photograph."""
    folder = tmp_path_factory.mktemp("turned")
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(31), 31)
    ball = Body(Sphere(np.array([0.0, rig_2003.OBJECT_Y, 16.0]), 16.0), np.array([0.4, 0.5, 0.45]))
    axes = rig_2003.turning_axes(100)
    simulate_scan(folder / "scan", rig, rig_2003.scan_scene(rig, (ball,)), 31, axes=axes, lighting=ROOM)
    write_rig(folder / "rig.json", RigFile(rig))
    run("reconstruct", folder / "scan", "--rig", folder / "rig.json", "--colour", "frames", "-o", folder / "a.npz")
    return folder


def test_near_the_axis_of_a_turn_photographs_from_all_around_have_the_colour(turned) -> None:
    image = read_range_image(turned / "a.npz")
    coloured = image.colours.any(axis=-1)
    assert coloured[image.valid].mean() > 0.98
    share = image.colours[coloured] / image.colours[coloured].sum(axis=1, keepdims=True)
    # No light of the laser is in it.
    assert share[:, 0].max() < 0.37


def test_neighbouring_texels_of_a_turn_are_alike(turned, tmp_path) -> None:
    """Each passage has its own shade; texels that took now the one and now the other looked like a maze."""
    run("mesh", turned / "a.npz", *photographs(turned), "-o", tmp_path / "a.glb")
    found = looked_up(tmp_path / "a.glb", 20_000)
    R, origin = rig_2003.platform(rig_2003.with_turntable(rig_2003.simulated_rig(31), 31))
    some = ((found.points - origin) @ R)[:, 2] > 8
    green, points = found.colours[some, 1].astype(float), found.points[some]
    _, near = KDTree(points).query(points, k=8)
    rough = np.abs(green - np.median(green[near], axis=1))
    assert some.sum() > 1000
    assert np.median(rough) < 0.3
    assert np.quantile(rough, 0.95) < 1.5


def test_a_scan_without_colours_has_none(folder, tmp_path) -> None:
    write_points(tmp_path / "a.npz", scenes.seen(np.zeros((40, 40)), 0.01))
    run("mesh", tmp_path / "a.npz", "--floor", "keep", "-o", tmp_path / "a.glb")
    assert trimesh.load_mesh(tmp_path / "a.glb", process=False).visual.kind != "texture"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "a.ply", "--photographs", "scan", "--rig", "rig.json"], "only .glb has a texture"),
        (["-o", "a.glb", "--photographs", "scan"], "--photographs: needs --rig too"),
        (["-o", "a.glb", "--texture-px", "7"], "--texture-px 7: give 64 to 16384, or 0"),
        (["-o", "a.glb", "--texture-px", "0", "--photographs", "scan", "--rig", "rig.json"], "only .glb has a texture"),
        (["-o", "a.glb", "--rig", "rig.json"], "only --photographs needs its camera"),
    ],
)
def test_what_does_not_go_together(folder, capsys, monkeypatch, words, said) -> None:
    monkeypatch.chdir(folder)
    assert main(["mesh", "a.npz", *words]) == 2
    assert said in capsys.readouterr().err
    assert not (folder / "a.glb").exists()


def test_the_photographs_of_another_scan_are_refused(folder, tmp_path, capsys) -> None:
    write_points(tmp_path / "short.npz", read_range_image(folder / "a.npz")[1:, :])
    words = ["mesh", tmp_path / "short.npz", *photographs(folder), "-o", tmp_path / "a.glb"]
    assert main([str(word) for word in words]) == 2
    assert "has 37 steps, and the range image 36: give the scan" in capsys.readouterr().err


def assert_colours_of_vertices(path: Path) -> None:
    colours, texture = colours_of(read_mesh(path))
    assert texture is None
    assert colours is not None
    # Green things on a grey floor.
    assert 0.05 < (colours[:, 1] > 1.3 * colours[:, 0].astype(float)).mean() < 1


def test_a_surface_that_is_too_rough_has_colours_of_vertices(folder, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("jaxscan.surface.texture.make_atlas", lambda *_: None)
    run("mesh", folder / "a.npz", "-o", tmp_path / "a.glb")
    assert "texture    none: the surface is too rough" in capsys.readouterr().out
    assert_colours_of_vertices(tmp_path / "a.glb")


def test_vertex_colours_where_they_are_asked_for(folder, tmp_path) -> None:
    run("mesh", folder / "a.npz", "--texture-px", "0", "-o", tmp_path / "a.glb")
    assert_colours_of_vertices(tmp_path / "a.glb")
