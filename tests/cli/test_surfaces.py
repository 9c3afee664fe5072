"""`jaxscan mesh`, `compare` and `inspect` on range images, clouds and meshes, from the command line."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from jaxscan.cli.main import main
from jaxscan.files.ply import Lists
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage, read_range_image, write_points
from jaxscan.rig import Linear
from jaxscan.simulation.rig_2003 import simulated_rig
from tests.surface import scenes


def drawn(noise: float = 0.02) -> RangeImage:
    """A block of 12 × 12 × 5 mm on a floor, with some glints."""
    y, x = np.meshgrid(0.4 * np.arange(60) - 12, 0.2 * np.arange(120) - 12, indexing="ij")
    on = (np.abs(x) < 6) & (np.abs(y) < 6)
    rng = np.random.default_rng(0)
    points = np.stack([x, -y, 300 - 5.0 * on + noise * rng.normal(size=x.shape)], axis=-1).astype(np.float32)
    points[3:5, 3, 2] -= 30
    full = np.full(x.shape, 1.0, np.float32)
    return RangeImage(
        points,
        100 * full,
        250 * full,
        0.05 * full,
        0.02 * full,
        on | True,
        {"stage": 400 * np.arange(60)},
        as_numpy(Linear.create([0.0, 0.001, 0.0])),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("surfaces")
    image = drawn()
    write_points(folder / "block.npz", image)
    write_points(folder / "block.ply", image)
    write_points(folder / "bare.npz", image.where(image.points[..., 2] > 299))
    write_points(folder / "one.npz", image[:1, :])
    write_points(folder / "none.npz", image.where(image.points[..., 2] > 999))
    return folder


def run(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    assert main([str(word) for word in (*words, "--json")]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_mesh_in_every_format(folder, capsys):
    endings = (".stl", ".obj", ".glb", ".ply", ".npz")
    outputs = [word for ending in endings for word in ("-o", folder / f"out{ending}")]
    result = run(capsys, "mesh", folder / "block.npz", *outputs, "--quads", "--png", folder / "out.png")
    assert result["removed"] == {"mixed": 0, "grazing": 0, "isolated": 2}
    assert result["floor"]["sigma_mm"] == pytest.approx(0.02, rel=0.1)
    assert result["triangles"] == 2 * 28 * 58
    assert result["area_mm2"] == pytest.approx(28 * 0.4 * 58 * 0.2, rel=0.03)
    for ending in endings[:4]:
        mesh = trimesh.load(folder / f"out{ending}", force="mesh")
        assert mesh.area == pytest.approx(result["area_mm2"], rel=1e-4)
        assert (mesh.face_normals[:, 2] < 0).all()
    content = read_ply_file(folder / "out.ply")
    assert {"sigma", "sigma_pixel", "nx"} <= set(content.elements["vertex"].columns)
    faces = content.elements["face"].columns["vertex_indices"]
    assert isinstance(faces, Lists)
    assert faces.length == 4
    assert read_range_image(folder / "out.npz").valid.sum() == 29 * 59
    assert (folder / "out.png").read_bytes().startswith(b"\x89PNG")
    assert main(["mesh", str(folder / "block.npz"), "-o", str(folder / "out.stl")]) == 0
    assert "3248 triangles between 1711 points" in capsys.readouterr().out


def test_plateaus_need_no_mesh(folder, capsys):
    found = run(capsys, "mesh", folder / "block.npz", "--plateaus")
    (one,) = found["plateaus"]
    assert abs(one["height_mm"] - 5.0) <= one["interval_mm"] < 0.01
    assert {"sigma_mm", "spread_mm", "points", "area_mm2", "centre", "tilt_deg"} <= set(one)
    assert "triangles" not in found
    out = folder / "plateaus.stl"
    assert main([str(word) for word in ("mesh", folder / "block.npz", "--plateaus", "-o", out)]) == 0
    said = capsys.readouterr().out
    assert "1 plateau, heights above the floor with 95 % intervals" in said
    assert "triangles between" in said
    assert run(capsys, "mesh", folder / "bare.npz", "--plateaus")["plateaus"] == []
    assert run(capsys, "mesh", folder / "block.npz", "--plateaus", "--plateau-area", "500")["plateaus"] == []
    assert main(["mesh", str(folder / "bare.npz"), "--plateaus"]) == 0
    assert "no plateaus" in capsys.readouterr().out


def test_a_floor_too_coarse_to_tell_its_flatness(folder, capsys):
    """Its points are 3 mm apart: at most four in a square of 5 mm."""
    path = folder / "coarse.npz"
    x, y = scenes.grid(40, 40, (3.0, 3.0))
    write_points(path, scenes.seen(np.where((np.abs(x) < 12) & (np.abs(y) < 12), 9.0, 0.0), 0.02, (3.0, 3.0)))
    found = run(capsys, "mesh", path, "-o", folder / "coarse.stl")
    assert found["floor"]["flatness_mm"] is None
    assert main(["mesh", str(path), "-o", str(folder / "coarse.stl")]) == 0
    assert "flat within" not in capsys.readouterr().out


def test_a_scan_of_the_stage_is_a_surface(folder, capsys):
    x, _ = scenes.grid()
    block = drawn().points[..., 2] < 297
    for name, high in (("bent", 0.0), ("on-bent", 5.0)):
        image = scenes.seen(0.005 * x**2 + high * block, 0.02, seed=int(high))
        write_points(folder / f"{name}.npz", image)
    found = run(
        capsys, "mesh", folder / "on-bent.npz", "--floor", folder / "bent.npz", "--plateaus", "-o", folder / "b.stl",
        "--png", folder / "b.png",
    )  # fmt: skip
    assert found["plateaus"][0]["height_mm"] == pytest.approx(5.0, abs=0.005)
    assert found["vertices"] == pytest.approx(block.sum(), abs=10)
    assert found["floor"]["sigma_mm"] == pytest.approx(0.02, rel=0.15)
    assert found["floor"]["points_beside_the_scan"] == 0
    assert (folder / "b.png").read_bytes().startswith(b"\x89PNG")
    words = ["mesh", folder / "block.npz", "--floor", folder / "bare.npz", "-o", folder / "c.stl"]
    assert main([str(word) for word in words]) == 0
    assert "points lie beside the scan of the stage" in capsys.readouterr().out


def test_floors_methods_and_options(folder, capsys):
    def triangles(*words: object) -> int:
        return run(capsys, "mesh", folder / "block.npz", "-o", folder / "x.stl", *words)["triangles"]

    alone = triangles()
    picks = "-10,-2,300:10,-2,300:0,10,300"
    assert triangles("--floor", folder / "bare.npz") == triangles(f"--floor={picks}") == alone
    assert triangles("--floor", "keep") > 3 * alone
    words = ["mesh", folder / "block.npz", "--floor", folder / "missing.npz", "-o", folder / "x.stl"]
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr().err
    assert "missing.npz: " in said
    assert "block.npz: " not in said
    assert triangles("--every", "2,2") == pytest.approx(alone / 4, rel=0.2)
    assert triangles("--floor=keep", "--crop=-5,-5,290,5,5,298") < alone
    assert triangles("--grid", "0.4") == pytest.approx(alone / 2, rel=0.1)
    assert triangles("--simplify", "200") <= 200
    assert triangles("--method", "delaunay") == pytest.approx(alone, rel=0.05)
    cloud = run(capsys, "mesh", folder / "block.ply", "-o", folder / "cloud.ply")
    assert cloud["triangles"] > 3 * alone
    assert "searched only in a range image (.npz)" in cloud["note"]
    assert "note" not in run(capsys, "mesh", folder / "block.ply", "-o", folder / "cloud.ply", "--floor=keep")
    # A cloud is joined as the light of a rig shows it, with --method delaunay or without.
    write_rig(folder / "lit.json", RigFile(simulated_rig(0)))
    lit = [
        run(capsys, "mesh", folder / "block.ply", "-o", folder / "cloud.ply", "--rig", folder / "lit.json", *words)
        for words in ((), ("--method", "delaunay"))
    ]
    assert lit[0]["triangles"] == lit[1]["triangles"] != cloud["triangles"]


def test_compare_with_a_mesh_and_with_a_cloud(folder, capsys):
    box = trimesh.creation.box((12, 12, 5), trimesh.transformations.translation_matrix((0, 0, 297.5)))
    box.export(folder / "box.stl")
    run(capsys, "mesh", folder / "block.npz", "-o", folder / "top.npz")
    out = ("-o", folder / "difference.ply", "--png", folder / "difference.png")
    found = run(capsys, "compare", folder / "top.npz", folder / "box.stl", *out)
    assert found["figures"]["rms_mm"] == pytest.approx(0.02, rel=0.1)
    assert abs(found["figures"]["mean_mm"]) < 0.003
    vertex = read_ply_file(folder / "difference.ply").elements["vertex"].columns
    assert {"distance", "red"} <= set(vertex)
    assert (folder / "difference.png").stat().st_size > 10_000
    same = run(
        capsys, "compare", folder / "block.ply", folder / "block.npz", "--region=0,0,295,4", "--region=-9,0,300,2"
    )
    assert same["figures"]["rms_mm"] < 0.1
    assert same["regions"][1]["height_over_first_mm"] == pytest.approx(-5.0, abs=0.02)
    assert same["regions"][0]["rms_mm"] == pytest.approx(0.02, rel=0.1)
    assert main(["compare", str(folder / "block.ply"), "--region=0,0,295,4"]) == 0
    assert "region 1" in capsys.readouterr().out


def test_stray_points_and_a_floor_are_said_beside_the_figures_of_all(folder, capsys):
    plate = trimesh.creation.box((40, 40, 5), trimesh.transformations.translation_matrix((0, 0, 302.5)))
    plate.export(folder / "plate.stl")
    found = run(capsys, "compare", folder / "block.npz", folder / "plate.stl")
    assert found["figures"]["points_far"] == 1713
    assert 0.7 < found["on_floor"] < 0.8
    assert found["figures"]["rms_without_far_mm"] < 0.03 < 2.0 < found["figures"]["rms_mm"]
    assert main(["compare", str(folder / "block.npz"), str(folder / "plate.stl")]) == 0
    said = capsys.readouterr().out
    assert "without    1713 points that are far off" in said
    assert "`jaxscan mesh` removes stray points" in said
    assert "jaxscan mesh " + str(folder / "block.npz") + " -o object.npz" in said


def test_a_fit_that_fails_is_said(folder, capsys):
    """The floor is most of the cloud, and the reference has none."""
    trimesh.PointCloud(trimesh.creation.icosphere(2, 3.0).vertices).export(folder / "ball.ply")
    assert main(["compare", str(folder / "block.npz"), str(folder / "ball.ply"), "--fit"]) == 0
    said = capsys.readouterr().out
    assert "warning: half of the points are more than" in said
    assert "jaxscan mesh block.npz -o object.npz" in said


def test_inspect_meshes_clouds_and_views(folder, capsys):
    run(capsys, "mesh", folder / "block.npz", "-o", folder / "seen.ply", "-o", folder / "seen.stl")
    for ending in ("ply", "stl"):
        summary = run(capsys, "inspect", folder / f"seen.{ending}")
        assert summary["kind"] == "mesh"
        assert summary["triangles"] == 3248
        assert main(["inspect", str(folder / f"seen.{ending}")]) == 0
        assert "triangles" in capsys.readouterr().out
    assert run(capsys, "inspect", folder / "block.ply")["kind"] == "cloud"
    summary = run(capsys, "inspect", folder / "block.npz", "--png", folder / "views.png")
    assert summary["picture"]["path"] == str(folder / "views.png")
    assert summary["picture"]["removed"] == {"mixed": 0, "grazing": 0, "isolated": 2}
    assert (folder / "views.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("mesh one.npz -o x.stl", "one.npz: a surface takes at least two frames, and there is one"),
        ("mesh none.npz -o x.stl", "none.npz: has no points"),
        ("mesh bare.npz -o x.stl", "bare.npz: nothing stands on the floor"),
        ("mesh gone.npz -o x.stl", "gone.npz: there is no such file"),
        ("mesh box.obj -o x.stl", "box.obj: give a range image (.npz) or a cloud (.ply, .xyz, .pcd, .e57, .laz, .las)"),
        ("mesh block.npz -o x.step", "x.step: the ending is not known"),
        ("mesh block.ply -o x.npz", "needs the order of a range image"),
        ("mesh block.ply -o x.stl --fill 3", "--fill needs the order of a range image"),
        ("mesh block.npz", "give -o MESH for what is to be written, or --plateaus"),
        ("mesh block.npz --plateaus --floor keep", "--plateaus: heights are above the floor"),
        ("mesh block.npz --plateaus --plateau-area 0", "--plateau-area 0: give an area"),
        ("mesh block.ply --plateaus", "--plateaus needs the order of a range image"),
        ("mesh block.npz -o x.stl --floor maybe", "--floor maybe: is none of auto, keep"),
        ("mesh block.npz -o x.stl --fill -1", "holes of up to -1 mm"),
        ("mesh block.npz -o x.stl --grid 0", "a grid of 0 mm"),
        ("mesh block.npz -o x.stl --simplify 2", "--simplify 2: give 4"),
        ("mesh block.npz -o x.stl --units m", "--units m: block.npz is a range image, and these are in millimetres"),
        ("mesh block.npz -o x.stl --every 0,1", "--every 0,1: give whole numbers"),
        ("mesh block.npz -o x.stl --every 1", "is not 2 finite numbers"),
        ("mesh block.npz -o nowhere/x.stl", "there is no folder"),
        ("mesh block.npz -o x.stl --rig lit.json", "--rig: only --method delaunay looks along the light of a rig"),
        ("mesh block.ply -o x.stl --rig lit.json --method poisson", "--rig: only --method delaunay looks along"),
        ("inspect one.npz --png x.png --frame 1", "--frame chooses a photograph, and a range image is drawn whole"),
        ("inspect one.npz --png x.png", "one.npz: a surface takes at least two frames"),
        ("compare block.ply", "give a REFERENCE"),
        ("compare block.ply gone.stl", "gone.stl: there is no such file"),
        ("compare block.ply nan.ply", "nan.ply: 1 of 1711 points have a coordinate that is not a finite number"),
        ("mesh nan.ply -o x.stl", "error: nan.ply: 1 of 1711 points have a coordinate"),
        ("compare block.ply far.stl", "block.ply against far.stl: cloud and reference lie apart: see that both"),
        ("compare block.ply block.npz --within -1", "--within -1"),
        ("inspect block.npz --png block.npz", "--png block.npz: the picture is a PNG: end its name with .png"),
        ("mesh block.npz -o x.stl --png x", "--png x: the picture is a PNG"),
        ("mesh block.ply -o block.ply", "block.ply: is read, and writing to it would replace it"),
        ("mesh block.npz -o x.stl -o ./x.stl", "x.stl: two things are to be written there"),
        ("merge block.npz block.ply -o block.ply", "block.ply: is read, and writing to it would replace it"),
        ("view block.ply --png block.ply", "--png block.ply: the picture is a PNG"),
        ("compare block.ply block.npz -o block.ply", "block.ply: is read, and writing to it would replace it"),
        ("compare block.ply block.npz --png x.svg", "--png x.svg: the picture is a PNG"),
        ("compare block.ply --region=0,0,0,1 --reference-units m", "--reference-units m needs a REFERENCE"),
        ("reconstruct scan --rig rig.json -o x.ply -o x.ply", "x.ply: two things are to be written there"),
        ("calibrate session -o report.json --report .", "report.json: two things are to be written there"),
        ("compare block.ply --region -1,0,0,-1", "--region: its radius is -1 mm: give X,Y,Z,R with R more than 0"),
        ("compare block.ply --region=0,0,0,1", "0.0]: ten or more are needed, so give a larger radius"),
    ],
)
def test_bad_input(folder, capsys, monkeypatch, words, problem):
    monkeypatch.chdir(folder)
    before = {path.name: path.read_bytes() for path in folder.glob("block.*")}
    if "far.stl" in words:
        trimesh.creation.box((3, 3, 3)).export("far.stl")
    if "nan.ply" in words:
        main(["mesh", "block.npz", "-o", "nan.ply"])
        content = Path("nan.ply").read_bytes()
        start = content.index(b"end_header\n") + 11
        Path("nan.ply").write_bytes(content[:start] + np.float32(np.nan).tobytes() + content[start + 4 :])
        capsys.readouterr()
    assert main(words.split()) == 2
    assert problem in capsys.readouterr().err
    assert before == {path.name: path.read_bytes() for path in folder.glob("block.*")}
    assert not Path("x.stl").exists() or "x.stl" not in words or Path("x.stl").stat().st_size > 0


def test_a_folded_surface_is_said(folder, capsys):
    image = drawn()
    y = image.points[..., 1]
    wrong = replace(image, points=np.stack([image.points[..., 0], y - 2.0 * np.abs(y), 300 - 3 * np.abs(y)], axis=-1))
    write_points(folder / "folded.npz", wrong)
    assert main(["mesh", str(folder / "folded.npz"), "-o", str(folder / "f.stl"), "--floor", "keep", "--raw"]) == 0
    assert "as when the object moves the other way" in capsys.readouterr().out
