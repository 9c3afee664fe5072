"""Profiles of a profiler through the pipeline: points, surface, dimensions, pictures, by the commands."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxscan.cli.main import main
from jaxscan.files.exchange import read_cloud
from jaxscan.reconstruction import read_range_image
from jaxscan.view.view_data import view_data

RADIUS, FLOOR = 12.0, 200.0
STEP = 0.002


def run(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main([str(word) for word in words]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def depths(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """How far a profiler above finds a half ball on a floor."""
    inside = RADIUS**2 - x**2 - y**2
    return FLOOR - np.sqrt(np.maximum(inside, 0))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A range map of 16 bits; 120 profiles, 0.25 mm apart, the motor makes 5 steps from one to the next."""
    x, y = np.meshgrid(-15 + 0.1 * np.arange(301), 15 - 0.25 * np.arange(120))
    counts = np.round((depths(x, y) - 150) / STEP).astype(np.uint16)
    counts[50:60, 100:104] = 0
    np.save(tmp_path / "map.npy", counts)
    (tmp_path / "profiles.toml").write_text(
        '[profiles]\nfiles = "map.npy"\nunits = "mm"\nsteps_per_frame = 5\nname = "ball"\n'
        f"[profiles.a]\nscale = 0.1\noffset = -15.0\n[profiles.c]\nscale = {STEP}\noffset = 150.0\n"
        '[[motion]]\naxis = "stage"\nkind = "linear"\nper_step = [0.0, 0.05, 0.0]\n'
    )
    return tmp_path


def test_from_a_range_map_to_a_surface(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.chdir(folder)
    said = run(capsys, "profiles", ".", "-o", "ball.npz", "-o", "ball.ply")
    assert "36080 points from 120 profiles of 301 (40 invalid): ball.npz, ball.ply" in said
    assert "30 x 29.75 x 12 mm" in said
    image = read_range_image("ball.npz")
    points = image.points[image.valid]
    np.testing.assert_allclose(points[:, 2], depths(points[:, 0], 15 + points[:, 1]), atol=STEP)
    np.testing.assert_allclose(read_cloud("ball.ply").points, points)
    result = json.loads(run(capsys, "mesh", "ball.npz", "-o", "ball.stl", "--json"))
    assert result["floor"]["sigma_mm"] < STEP
    mesh = trimesh.load_mesh("ball.stl")
    dome = mesh.vertices[mesh.vertices[:, 2] < FLOOR - 3]
    # The ball was under the profiler, y = 0, when it had moved by 15 mm.
    radius = np.linalg.norm(dome - [0, -15, FLOOR], axis=1)
    assert np.abs(radius - RADIUS).max() < STEP
    # Fronts face the profiler.
    assert (mesh.face_normals[:, 2] < 0).mean() > 0.99
    shown = view_data(Path("ball.npz"))
    assert "height" in shown.looks
    assert "strength" not in shown.looks
    assert json.loads(run(capsys, "inspect", "ball.npz", "--json"))["strength"] is None
    summary = json.loads(run(capsys, "inspect", "profiles.toml", "--json"))
    assert (summary["kind"], summary["profiles"], summary["points_of_a_profile"]) == ("profiles", 120, 301)
    assert "36080 of 36120 points" in run(capsys, "inspect", ".")


def test_a_ball_on_a_turntable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The profiler sees the meridian of a ball whose middle is on the axis: every profile is the same."""
    x = -9 + 0.15 * np.arange(121)
    z = 100 - np.sqrt(RADIUS**2 - x**2)
    np.save(tmp_path / "m.npy", np.tile(z, (180, 1)))
    (tmp_path / "profiles.toml").write_text(
        '[profiles]\nfiles = "m.npy"\nunits = "mm"\n[profiles.axes]\nturntable = { start = 0, per_frame = 2 }\n'
        "[profiles.a]\nscale = 0.15\noffset = -9.0\n"
        f'[[motion]]\naxis = "turntable"\nkind = "rotary"\nper_step = [{np.pi / 180}, 0.0, 0.0]\n'
        "centre = [0.0, 0.0, 100.0]\n"
    )
    run(capsys, "profiles", tmp_path, "-o", tmp_path / "a.npz")
    image = read_range_image(tmp_path / "a.npz")
    np.testing.assert_allclose(np.linalg.norm(image.points - [0, 0, 100], axis=-1), RADIUS, atol=1e-4)
    result = json.loads(run(capsys, "mesh", tmp_path / "a.npz", "--floor", "keep", "-o", tmp_path / "a.stl", "--json"))
    # A ring of the ball's surface between two planes, closed all around.
    assert result["area_mm2"] == pytest.approx(2 * np.pi * RADIUS * 18, rel=0.005)
    assert result["degrees_apart"] == pytest.approx(2)


def test_bad_input_is_refused_before_anything_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch
) -> None:
    monkeypatch.chdir(folder)
    text = Path("profiles.toml").read_text()
    Path("profiles.toml").write_text(text.replace('"mm"', '"furlong"'))
    assert main(["profiles", ".", "-o", "a.npz"]) == 2
    assert 'units = "furlong": must be one of um, mm, cm, m, inch' in capsys.readouterr().err
    assert not Path("a.npz").exists()
    assert main(["profiles", ".", "-o", "a.stl"]) == 2
    assert ".stl holds a surface" in capsys.readouterr().err
    assert main(["reconstruct", "profiles.toml", "--rig", "rig.json", "-o", "a.npz"]) == 2
