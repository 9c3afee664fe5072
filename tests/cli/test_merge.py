"""`jaxscan merge` from the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxscan.cli.main import main
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.reconstruction import write_points
from jaxscan.simulation.rig_2003 import simulated_rig
from jaxscan.surface.register import register
from tests.surface import scenes
from tests.surface.hills import NOISE, height, scanned


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("merge")
    for k in range(3):
        write_points(folder / f"{k}.npz", scanned(90.0 * k, k))
    x, y = scenes.grid()
    other = np.where(x**2 + y**2 < 60, 4 + np.sin(2 * x) + np.sin(3 * y), 0.0)
    write_points(folder / "other.npz", scenes.seen(other, NOISE))
    image = scanned(0.0)
    write_points(folder / "none.npz", image.where(image.points[..., 2] > 999))
    write_points(folder / "flat.npz", scenes.seen(np.zeros((60, 120)), NOISE))
    write_points(folder / "one.npz", image[:1, :])
    write_rig(folder / "rig.json", RigFile(simulated_rig(0)))
    return folder


def run(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    assert main([str(word) for word in (*words, "--json")]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.long
def test_by_angle_then_by_the_turntable_that_it_gave(folder, capsys):
    scans = [folder / f"{k}.npz" for k in range(3)]
    out = ["-o", folder / "m.stl", "-o", folder / "m.ply", "--png", folder / "m.png"]
    found = run(
        capsys, "merge", *scans, "--turn", "83", *out, "--rig", folder / "rig.json", "--fit-turntable", "500",
        "--write-rig", folder / "turntable.json",
    )  # fmt: skip
    assert len(found["pairs"]) == 3
    assert found["residual_in_sigma"] == pytest.approx(0.95, abs=0.1)
    assert found["closure_mm"] < 0.01
    assert all(scan["sigma_mm"] < 0.01 for scan in found["scans"])
    assert np.degrees(np.linalg.norm(found["scans"][1]["rotation"])) == pytest.approx(90.0, abs=0.2)
    assert found["turntable"]["degrees_per_step"] == pytest.approx(90 / 500, abs=2e-4)
    vertex = read_ply_file(folder / "m.ply").elements["vertex"].columns
    assert {"sigma_pixel", "nx"} <= set(vertex)
    x, y, z = (np.asarray(vertex[axis], float) for axis in "xyz")
    inner = np.hypot(x, y + 12) < 8
    assert np.sqrt(np.mean((300 - z - height(x, -(y + 12)))[inner] ** 2)) < 0.01
    assert (folder / "m.png").read_bytes().startswith(b"\x89PNG")
    assert trimesh.load_mesh(folder / "m.stl").area == pytest.approx(found["area_mm2"], rel=1e-3)
    assert read_rig(folder / "turntable.json").rig.turntable is not None
    words = ["merge", *scans, "--rig", folder / "turntable.json", "--steps", "500", "-o", folder / "again.stl"]
    assert main([str(word) for word in words]) == 0
    said = capsys.readouterr().out
    assert "3 overlap" in said
    assert "open" in said


@pytest.mark.filterwarnings("always::jaxscan.surface.register.NotSettledWarning")
def test_rounds_that_run_out_are_said(folder, capsys, monkeypatch):
    assert register.__kwdefaults__ is not None
    monkeypatch.setitem(register.__kwdefaults__, "rounds", 2)
    words = ["merge", folder / "0.npz", folder / "1.npz", "--turn", "83", "-o", folder / "rough.stl"]
    assert main([str(word) for word in words]) == 0
    out, err = capsys.readouterr()
    assert "not settled: 2 rounds did not suffice" in out
    assert err.count("jaxscan: warning: after 2 rounds the poses still moved") == 1


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("0.npz -o x.stl", "0.npz: one scan has nothing to be joined with"),
        ("0.npz 0.npz -o x.stl", "0.npz: is given twice"),
        ("0.npz 1.npz -o x.step", "x.step: the ending is not known"),
        ("0.npz 1.npz -o nowhere/x.stl", "there is no folder"),
        ("0.npz scan -o x.stl", "scan: give a range image (.npz)"),
        ("0.npz gone.npz -o x.stl", "gone.npz: there is no such file"),
        ("0.npz none.npz -o x.stl", "none.npz: has no points"),
        ("0.npz flat.npz -o x.stl", "flat.npz: nothing stands on the floor"),
        ("0.npz one.npz -o x.stl", "one.npz: a surface takes at least two frames"),
        ("0.npz other.npz --turn 0 -o x.stl", "other.npz: does not overlap with 0.npz"),
        ("0.npz 1.npz --turn 0,90,180 -o x.stl", "--turn: 3 numbers for 2 scans"),
        ("0.npz 1.npz --turn quarter -o x.stl", "is no number"),
        ("0.npz 1.npz --steps 500 -o x.stl", "--steps: are those of a rig's turntable"),
        ("0.npz 1.npz --rig rig.json --steps 500 -o x.stl", "rig.json: has no turntable"),
        ("0.npz 1.npz --write-rig r.json -o x.stl", "--write-rig: writes --rig with the turntable"),
        ("0.npz 1.npz --cube 0 -o x.stl", "--cube 0: give a size"),
        ("0.npz 1.npz --simplify 2 -o x.stl", "--simplify 2: give 4"),
    ],
)
def test_bad_input(folder, capsys, monkeypatch, words, problem):
    monkeypatch.chdir(folder)
    assert main(["merge", *words.split()]) == 2
    assert problem in capsys.readouterr().err
    assert not Path("x.stl").exists()
