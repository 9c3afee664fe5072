"""Colours and albedo from photographs to every file and to the viewer, by the commands."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxscan.cli.main import main
from jaxscan.files.exchange import read_cloud
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import read_scan, write_scan
from jaxscan.reconstruction import read_range_image
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.scene import Body
from jaxscan.simulation.solids import Box
from jaxscan.view.view_data import PHOTOGRAPH, view_data
from jaxscan.view.viewer import painted

GREEN = np.array([0.25, 0.8, 0.3])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A green box on a grey platform: photographs with the laser off too, and a scan.toml without these."""
    folder = tmp_path_factory.mktemp("colours")
    rig = rig_2003.simulated_rig(31)
    box = Body(Box(np.array([0.0, 14.0, 8.0]), np.eye(3), np.array([18.0, 10.0, 8.0])), GREEN)
    light = replace(rig_2003.SCAN_LIGHTING, ambient=90.0, directional=40.0, laser_power=450.0)
    scene = rig_2003.scan_scene(rig, (box,))
    simulate_scan(folder / "scan", rig, scene, 31, frames=16, steps_apart=1500, lighting=light, laser_off=True)
    scan = read_scan(folder / "scan")
    write_scan(replace(scan, path=folder / "alone.toml", backgrounds=()))
    write_rig(folder / "rig.json", RigFile(rig))
    return folder


def run(capsys: pytest.CaptureFixture[str], *argv: object) -> str:
    assert main([str(word) for word in argv]) == 0
    return capsys.readouterr().out


def is_green(colours: np.ndarray) -> np.ndarray:
    """Where they are the box's, and not the platform's or the laser's."""
    c = colours.astype(float)
    return (c[:, 1] > 1.5 * c[:, 0]) & (c[:, 1] > 1.5 * c[:, 2])


def test_colours_and_albedo_in_every_file(folder, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    outputs = [word for name in ("a.ply", "a.npz", "a.pcd") for word in ("-o", name)]
    said = run(capsys, "reconstruct", folder / "scan", "--rig", folder / "rig.json", "--albedo", *outputs)
    image = read_range_image("a.npz")
    n = int(image.valid.sum())
    assert f"colour: {n} points have one" in said
    assert f"albedo: of {np.isfinite(image.albedo).sum()} points" in said
    data = run(
        capsys, "reconstruct", folder / "scan", "--rig", folder / "rig.json", "--albedo", "--json", "-o", "b.npz"
    )
    gaps = json.loads(data)["without_albedo"]
    assert sum(gaps.values()) == n - np.isfinite(image.albedo[image.valid]).sum() > 0
    words = {
        "no_strength": "have no strength",
        "burnt_out": "are burnt out in the stripe",
        "alone": "have no neighbours on the surface",
        "oblique": "are lit or seen more obliquely than 60°",
    }
    for reason, count in gaps.items():
        assert (f"{count} {words[reason]}" in said) == (count > 0)
    for name in ("a.ply", "a.pcd"):
        cloud = read_cloud(name)
        np.testing.assert_array_equal(cloud.colours, image.colours[image.valid])
        np.testing.assert_array_equal(cloud.albedo, image.albedo[image.valid])
    green = is_green(image.colours[image.valid])
    assert 0.1 < green.mean() < 0.9
    known = image.albedo[image.valid]
    # Of the red laser: a half.
    assert np.nanmedian(known[green]) / np.nanmedian(known[~green]) == pytest.approx(0.5, rel=0.12)
    assert json.loads(run(capsys, "inspect", "a.ply", "--json"))["colours"] is True

    out = [word for name in ("b.glb", "b.ply", "b.obj") for word in ("-o", name)]
    said = run(capsys, "mesh", "a.npz", *out)
    vertices = len(read_cloud("b.ply").points)
    assert f"colours    of {vertices} of its points" in said
    green = is_green(read_cloud("b.ply").colours)
    assert green.mean() > 0.9
    # The texture has them on the same places.
    glb = trimesh.load_mesh("b.glb", process=False)
    assert glb.visual.kind == "texture"
    assert "between points" in said
    shown = trimesh.visual.uv_to_interpolated_color(glb.visual.uv, glb.visual.material.baseColorTexture)
    assert is_green(shown[:, :3]).mean() == pytest.approx(green.mean(), abs=0.03)
    first = next(line for line in Path("b.obj").read_text().splitlines() if line.startswith("v "))
    assert len(first.split()) == 7
    # Vertices that are none of the scan's points have the colours of those near them.
    said = run(capsys, "mesh", "a.npz", "--grid", "0.7", "-o", "c.ply")
    assert "of its points, in .ply\n" in said
    assert "of its points, in" not in run(capsys, "mesh", "a.npz", "--grid", "0.7", "-o", "c.glb")
    assert is_green(read_cloud("c.ply").colours).mean() > 0.9


def test_without_laser_off_photographs_they_are_asked_for(folder, tmp_path, capsys) -> None:
    common = ["reconstruct", folder / "alone.toml", "--rig", folder / "rig.json", "-o", tmp_path / "a.ply"]
    assert "colour" not in run(capsys, *common)
    assert read_cloud(tmp_path / "a.ply").colours is None
    said = run(capsys, *common, "--colour", "frames")
    found = read_cloud(tmp_path / "a.ply").colours
    known = found.any(axis=1)
    assert known.mean() > 0.8
    assert f"colour: {known.sum()} points have one" in said
    assert 0.1 < is_green(found[known]).mean() < 0.9
    # Nothing is as red as the stripe.
    assert (found[known, 0] < 1.3 * found[known, 1]).all()


def test_none_is_none(folder, tmp_path, capsys) -> None:
    run(
        capsys,
        "reconstruct",
        folder / "scan",
        "--rig",
        folder / "rig.json",
        "--colour",
        "none",
        "-o",
        tmp_path / "a.ply",
    )
    assert read_cloud(tmp_path / "a.ply").colours is None


def test_burnt_out_colours_are_said(folder, tmp_path, capsys) -> None:
    """The room's light is doubled in the laser-off photographs, as by an exposure that is too long."""
    from jaxscan.images import read_image, write_image

    scan = read_scan(folder / "scan")
    (tmp_path / "dark").mkdir()
    dark = []
    for path in scan.backgrounds:
        dark.append(tmp_path / "dark" / path.name)
        write_image(dark[-1], np.clip(3 * read_image(path).astype(int), 0, 255).astype(np.uint8))
    write_scan(replace(scan, path=tmp_path / "scan.toml", backgrounds=tuple(dark)))
    said = run(capsys, "reconstruct", tmp_path, "--rig", folder / "rig.json", "-o", tmp_path / "a.ply")
    assert "are burnt out: expose the photographs that they come from shorter" in said.replace("\n", " ")


def test_the_place_of_a_laser_is_for_albedo_alone(folder, tmp_path, capsys) -> None:
    words = [
        "reconstruct",
        folder / "scan",
        "--rig",
        folder / "rig.json",
        "--laser-at=0,-200,0",
        "-o",
        tmp_path / "a.ply",
    ]
    assert main([str(word) for word in words]) == 2
    assert "--laser-at: only --albedo uses the place of the laser" in capsys.readouterr().err
    assert not (tmp_path / "a.ply").exists()


def test_the_viewer_shows_them(folder, tmp_path, capsys) -> None:
    run(capsys, "reconstruct", folder / "scan", "--rig", folder / "rig.json", "-o", tmp_path / "a.npz")
    shown = view_data(tmp_path / "a.npz")
    assert PHOTOGRAPH in shown.looks
    image = read_range_image(tmp_path / "a.npz")
    np.testing.assert_array_equal(painted(shown, PHOTOGRAPH), image.colours[image.valid])
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    run(capsys, "view", tmp_path / "a.npz", "--colour", "photograph", "--png", tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000
