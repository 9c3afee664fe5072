"""`jaxscan merge` from the command line."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from jaxscan.cli.main import main
from jaxscan.files.cloud import Cloud, read_ply, write_ply
from jaxscan.files.mesh import colours_of, read_mesh
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.geometry import Pose
from jaxscan.reconstruction import read_range_image, write_points
from jaxscan.simulation.rig_2003 import simulated_rig
from jaxscan.surface.floor import find_floor, stands_on
from jaxscan.surface.register import register
from tests.surface import scenes
from tests.surface.hills import NOISE, height, pose, scanned


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
    # The rig's part of each scan's σ of 0.05 mm, which no number of scans makes smaller.
    assert found["sigma_vertex_mm"] == pytest.approx(np.hypot(found["sigma_pixel_vertex_mm"], 0.0458), abs=1e-4)
    assert np.median(np.asarray(vertex["sigma"])) == pytest.approx(found["sigma_vertex_mm"], rel=1e-4)
    x, y, z = (np.asarray(vertex[axis], float) for axis in "xyz")
    inner = np.hypot(x, y + 12) < 8
    assert np.sqrt(np.mean((300 - z - height(x, -(y + 12)))[inner] ** 2)) < 0.01
    assert (folder / "m.png").read_bytes().startswith(b"\x89PNG")
    assert trimesh.load_mesh(folder / "m.stl").area == pytest.approx(found["area_mm2"], rel=1e-3)
    assert "turntable" in read_rig(folder / "turntable.json").rig.axes()
    words = ["merge", *scans, "--rig", folder / "turntable.json", "--steps", "500", "-o", folder / "again.stl"]
    assert main([str(word) for word in words]) == 0
    said = capsys.readouterr().out
    assert "3 overlap" in said
    assert "open" in said


@pytest.fixture(scope="module")
def clouds(folder) -> Path:
    """The same scans as clouds without their floor, in metres too, and where they stood roughly."""
    poses = {}
    for k in range(3):
        image = scanned(90.0 * k, k)
        cloud = image.where(stands_on(image, find_floor(image))).cloud()
        write_ply(folder / f"{k}.ply", cloud)
        write_ply(folder / f"metres-{k}.ply", Cloud(cloud.points / 1000))
        axis = np.array([0.1, 0.2, 1.0]) / np.sqrt(1.05)
        T = Pose.about(np.radians(6.0) * axis, np.array([0.0, -12.0, 300.0])) @ pose(90.0 * k)
        R, t = T.matrix(), T.translation
        quaternion = Rotation.from_rotvec(T.rotation).as_quat()
        poses[f"{k}.ply"] = {"position": t.tolist(), "quaternion": np.roll(quaternion, 1).tolist()}
        poses[f"metres-{k}.ply"] = np.vstack([np.column_stack([R, t / 1000]), [0, 0, 0, 1]]).tolist()
    (folder / "poses.json").write_text(json.dumps(poses))
    lines = ["camera 0 0 0 0 0 0 1"]
    for name in ("0.ply", "1.ply"):
        qw, *vector = poses[name]["quaternion"]
        lines.append(f"bmesh {name} {' '.join(map(str, [*poses[name]['position'], *vector, -qw]))}")
    (folder / "hills.conf").write_text("\n".join(lines))
    return folder


@pytest.mark.parametrize(
    ("scans", "how"),
    [
        ("0.ply 1.ply 2.ply", "--poses poses.json"),
        ("0.ply 1.ply", "--poses hills.conf"),
        ("metres-0.ply metres-1.ply", "--poses poses.json --units m"),
        ("0.ply 1.ply", "--turn 84"),
    ],
    ids=["json", "conf", "metres", "angle"],
)
def test_clouds_without_features(clouds, capsys, monkeypatch, scans, how):
    monkeypatch.chdir(clouds)
    found = run(capsys, "merge", *scans.split(), *how.split(), "-o", "clouds.stl")
    assert found["converged"]
    for k, scan in enumerate(found["scans"]):
        T = pose(0.0).inverse() @ pose(90.0 * k)
        np.testing.assert_allclose(Rotation.from_rotvec(scan["rotation"]).as_matrix(), T.matrix(), atol=0.004)
        np.testing.assert_allclose(scan["translation_mm"], T.translation, atol=1.0)
    assert found["closure_mm"] < 0.02


@pytest.mark.filterwarnings("always::jaxscan.files.units.UnitsWarning")
def test_small_numbers_are_pointed_out(clouds, capsys, monkeypatch):
    monkeypatch.chdir(clouds)
    assert main(["inspect", "metres-0.ply"]) == 0
    assert "mm across: if its numbers are metres, other commands take --units m" in capsys.readouterr().out
    assert main(["mesh", "metres-0.ply", "-o", "metres.stl"]) == 0
    assert "warning: metres-0.ply: is 0.0" in (said := capsys.readouterr().err)
    assert "say --units m" in said
    area = run(capsys, "mesh", "metres-0.ply", "--units", "m", "-o", "metres.stl")["area_mm2"]
    assert area == pytest.approx(run(capsys, "mesh", "0.ply", "-o", "mm.stl")["area_mm2"], rel=1e-3)
    compared = run(capsys, "compare", "metres-0.ply", "0.ply", "--units", "m")
    assert compared["figures"]["largest_mm"] < 1e-3
    compared = run(capsys, "compare", "0.ply", "metres-0.ply", "--reference-units", "m")
    assert compared["figures"]["largest_mm"] < 1e-3


def test_a_range_image_has_its_own_unit(folder, capsys):
    words = ["compare", str(folder / "0.npz"), str(folder / "1.npz")]
    for option in ("--units", "--reference-units"):
        assert main([*words, option, "m"]) == 2
        assert f"{option} m: " in (said := capsys.readouterr().err)
        assert "in millimetres: leave it out" in said


def test_colours_go_with_the_points(folder, capsys):
    """Red where x > 0 in the first scan's frame, blue elsewhere; the third scan has none."""
    scans = []
    for k in range(3):
        image = read_range_image(folder / f"{k}.npz")
        T = pose(90.0 * k)
        x = T.apply(image.points.astype(np.float64))[..., :1]
        colours = np.where(x > 0, [200, 10, 10], [10, 10, 200]).astype(np.uint8)
        colours[~image.valid] = 0
        scans.append(folder / f"coloured-{k}.npz")
        write_points(scans[-1], replace(image, colours=colours if k < 2 else None))
    words = ["merge", *scans, "--turn", "90", *(word for name in ("c.ply", "c.glb") for word in ("-o", folder / name))]
    assert main([str(word) for word in words]) == 0
    assert "points, in .ply and .glb" in capsys.readouterr().out
    cloud = read_ply(folder / "c.ply")
    x, paint = cloud.points[:, 0], cloud.colours
    clear = (np.abs(x) > 1) & paint.any(axis=1)
    assert clear.mean() > 0.7
    np.testing.assert_array_equal(paint[clear], np.where(x[clear, None] > 0, [200, 10, 10], [10, 10, 200]))
    seen, _ = colours_of(read_mesh(folder / "c.glb"))
    assert seen is not None
    assert np.mean((seen == [200, 10, 10]).all(axis=1) | (seen == [10, 10, 200]).all(axis=1)) > 0.7


@pytest.mark.filterwarnings("always::jaxscan.surface.register.NotSettledWarning")
def test_rounds_that_run_out_are_said(folder, capsys, monkeypatch):
    assert register.__kwdefaults__ is not None
    monkeypatch.setitem(register.__kwdefaults__, "rounds", 2)
    words = ["merge", folder / "0.npz", folder / "1.npz", "--turn", "83", "-o", folder / "rough.stl"]
    assert main([str(word) for word in words]) == 0
    out, err = capsys.readouterr()
    assert "not settled: 2 rounds did not suffice" in out
    assert err.count("jaxscan: warning: after 2 rounds the poses still moved, in the end") == 1


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("0.npz -o x.stl", "0.npz: one scan has nothing to be joined with"),
        ("0.npz 0.npz -o x.stl", "0.npz: is given twice"),
        ("0.npz 1.npz -o x.step", "x.step: the ending is not known"),
        ("0.npz 1.npz --turn 90 -o nowhere/x.stl", "there is no folder"),
        ("0.npz scan -o x.stl", "scan: give a range image (.npz)"),
        ("0.npz gone.npz --turn 90 -o x.stl", "gone.npz: there is no such file"),
        ("0.npz none.npz --turn 90 -o x.stl", "none.npz: has no points"),
        ("0.npz flat.npz --turn 90 -o x.stl", "flat.npz: nothing stands on the floor"),
        ("0.npz one.npz --turn 90 -o x.stl", "one.npz: a surface takes at least two frames"),
        ("0.npz other.npz --turn 0 -o x.stl", "other.npz: does not overlap with 0.npz"),
        ("0.npz 1.npz --turn 0,90,180 -o x.stl", "--turn: 3 numbers for 2 scans"),
        ("0.npz 1.npz --turn quarter -o x.stl", "is no number"),
        ("0.npz 1.npz --steps 500 -o x.stl", "--steps: are those of a rig's turntable"),
        ("0.npz 1.npz --poses gone.json -o x.stl", "gone.json: there is no such file"),
        ("0.npz 1.npz --rig rig.json --steps 500 -o x.stl", "rig.json: has no turntable"),
        ("0.npz 1.npz --write-rig r.json -o x.stl", "--write-rig: writes --rig with the turntable"),
        ("0.npz 1.npz --units m -o x.stl", "--units m: no scan is a cloud (.ply), and range images"),
        ("0.npz 1.npz --cube 0 -o x.stl", "--cube 0: give a size"),
        ("0.npz 1.npz --simplify 2 -o x.stl", "--simplify 2: give 4"),
    ],
)
def test_bad_input(folder, capsys, monkeypatch, words, problem):
    monkeypatch.chdir(folder)
    assert main(["merge", *words.split()]) == 2
    assert problem in capsys.readouterr().err
    assert not Path("x.stl").exists()


def test_scans_stay_as_they_are_given(clouds, capsys, monkeypatch):
    monkeypatch.chdir(clouds)
    exact = pose(0.0).inverse() @ pose(90.0)
    words = ["merge", "0.ply", "1.ply", "--as-given", "-o", "given.stl"]
    found = run(capsys, *words, "--poses", "poses.json")
    np.testing.assert_allclose(found["scans"][1]["translation_mm"], exact.translation, atol=1e-9)
    assert found["scans"][1]["sigma_mm"] is None
    assert found["scans"][1]["from_chain_mm"] == found["rounds"] == 0
    assert found["residual_in_sigma"] == pytest.approx(1.0, abs=0.2)
    assert found["closure_mm"] < 0.02
    assert found["do_not_fit"] == []
    # Rough poses stay too, and that they are rough is said; without poses both stand where they are.
    rough = json.loads(Path("poses.json").read_text())
    rough["1.ply"]["position"][2] += 0.5
    Path("rough.json").write_text(json.dumps(rough))
    assert main([*words, "--poses", "rough.json"]) == 0
    said = capsys.readouterr().out
    assert "0.ply and 1.ply do not fit as given" in said
    assert "points, pose as given" in said
    np.testing.assert_array_equal(run(capsys, *words)["scans"][1]["translation_mm"], np.zeros(3))
    for more, reason in (
        (["--turn", "90"], "not about which axis: give --steps"),
        (["--poses", "poses.json", "--fit-turntable", "500"], "would find what was given"),
    ):
        assert main([*words, *more]) == 2
        assert reason in capsys.readouterr().err
