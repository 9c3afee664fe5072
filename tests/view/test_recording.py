"""Recordings for Rerun, read back by its own reader."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import read_scan
from jaxscan.images.shaded import TextureMap
from jaxscan.reconstruction import write_points
from jaxscan.rig import Camera
from jaxscan.simulation.rig_2003 import simulated_rig
from jaxscan.view.recording import as_pinhole, photographs_of, pinhole_pixels, write_recording
from jaxscan.view.view_data import PHOTOGRAPH, view_data
from jaxscan.view.viewer import coloured
from tests.surface.scenes import block


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    write_points(folder / "block.npz", block())
    rig = simulated_rig(0)
    write_rig(folder / "rig.json", RigFile(rig))
    assert main(["mesh", str(folder / "block.npz"), "-o", str(folder / "block.ply")]) == 0
    frames = folder / "scan" / "frames"
    frames.mkdir(parents=True)
    columns, rows = rig.camera.image_size
    for i in range(len(block().valid)):
        # The last one has 16 bits.
        last = i == len(block().valid) - 1
        level = (257 * np.array([i, 100, 200])).astype(np.uint16) if last else np.array([i, 100, 200], np.uint8)
        cv2.imwrite(str(frames / f"{i:03}.png"), np.broadcast_to(level, (rows, columns, 3)).copy())
    (folder / "scan" / "scan.toml").write_text('[scan]\nframes = "frames/*.png"\nsteps_per_frame = 100\n')
    return folder


def read(path: Path) -> dict[str, list[dict[str, Any]]]:
    """What a recording holds of each entity: a row for each time, of its columns that are data."""
    pytest.importorskip("rerun", reason="rerun-sdk (extra rerun) is not installed")
    from rerun.chunk import RrdReader

    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        kept = [name for name in batch.schema.names if name == "frame" or ":" in name]
        found.setdefault(chunk.entity_path, []).extend(batch.select(kept).to_pylist())
    return found


def test_points_and_cameras_are_read_back(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk (extra rerun) is not installed")
    out = folder / "block.rrd"
    words = ["view", str(folder / "block.npz"), "--rig", str(folder / "rig.json"), "--rerun", str(out)]
    assert main([*words, "--photographs", str(folder / "scan"), "--colour", "strength"]) == 0
    frames = len(block().valid)
    assert f"{frames} cameras, {frames} photographs, coloured by strength: {out}" in capsys.readouterr().out
    found = read(out)
    shown = view_data(folder / "block.npz", simulated_rig(0))
    assert shown.setup is not None
    (points,) = found["/points"]
    np.testing.assert_array_equal(points["Points3D:positions"], shown.points)
    packed = np.array(points["Points3D:colors"], np.uint32)
    rgb = np.stack([packed >> 24, packed >> 16 & 255, packed >> 8 & 255], axis=1)
    np.testing.assert_array_equal(rgb, coloured(shown.values["strength"]))
    # The camera at each frame, and its photograph.
    assert [row["frame"] for row in found["/scanner/camera"]] == list(range(frames))
    camera = found["/scanner/camera"][-1]
    turned = np.array(camera["Transform3D:mat3x3"]).reshape(3, 3).T
    np.testing.assert_allclose(turned, Rotation.from_rotvec(shown.setup.at.rotation[-1]).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(camera["Transform3D:translation"][0], block().cameras()[-1], atol=1e-5)
    images = [row for row in found["/scanner/camera/image"] if row.get("EncodedImage:blob")]
    assert [row["frame"] for row in images] == list(range(frames))
    for i, row in enumerate(images):
        picture = cv2.imdecode(np.frombuffer(bytes(row["EncodedImage:blob"][0]), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        np.testing.assert_allclose(picture[200:280, 280:360].mean(axis=(0, 1)), [i, 100, 200], atol=3)
    (light,) = found["/scanner/light"]
    np.testing.assert_allclose(light["Mesh3D:vertex_positions"], shown.setup.sheet, atol=1e-4)


def test_a_point_is_where_the_recorded_camera_sees_it() -> None:
    """A pinhole's pixel of a point shows what the photograph shows where the lens has put the point."""
    camera = Camera.create((640, 480), (500.0, 510.0), (318.0, 243.0), "brown", [-0.6, 0.4, 0.0], [2e-3, -2e-3])
    columns, rows = camera.image_size
    # Blue and green say where a pixel was.
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    photograph = np.stack([u * 255 / columns, v * 255 / rows], axis=-1).round().astype(np.uint8)
    points = np.random.default_rng(0).uniform([-60, -45, 280], [60, 45, 320], (200, 3))
    seen = np.asarray(camera.project(points))
    at = points[:, :2] / points[:, 2:]
    pinhole = at * [float(f) for f in camera.focal] + [float(c) for c in camera.principal]
    assert np.abs(seen - pinhole).max() > 2
    place = np.round(pinhole).astype(int)
    straight = as_pinhole(photograph, pinhole_pixels(camera))
    found = straight[place[:, 1], place[:, 0]] / 255 * [columns, rows]
    # A level is 2.5 pixels wide, and the place is rounded.
    np.testing.assert_allclose(found, seen, atol=2.5)
    assert np.abs(found - pinhole).max() > 3


def test_a_lens_that_sees_less_leaves_black() -> None:
    """A lens that folds back has no image beyond the fold, and a pinhole would see there."""
    camera = Camera.create((640, 480), (300.0, 300.0), (320.0, 240.0), "radial1", [-0.4])
    pixels = pinhole_pixels(camera)
    beyond = np.isnan(pixels[..., 0])
    assert 0.01 < beyond.mean() < 0.9
    straight = as_pinhole(np.full((480, 640, 3), 200, np.uint8), pixels)
    assert (straight[beyond] == 0).all()
    assert (straight[220:260, 300:340] == 200).all()


def test_a_mesh_is_read_back(folder: Path) -> None:
    shown = view_data(folder / "block.ply")
    pytest.importorskip("rerun", reason="rerun-sdk (extra rerun) is not installed")
    assert write_recording(folder / "mesh.rrd", shown, shown.colour(None)) == 0
    found = read(folder / "mesh.rrd")
    (mesh,) = found["/mesh"]
    np.testing.assert_array_equal(mesh["Mesh3D:vertex_positions"], shown.points)
    np.testing.assert_array_equal(mesh["Mesh3D:triangle_indices"], shown.triangles)
    assert len(mesh["Mesh3D:vertex_colors"]) == len(shown.points)
    assert "/scanner/camera" not in found


def test_a_texture_is_recorded(folder: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk (extra rerun) is not installed")
    shown = view_data(folder / "block.ply")
    picture = np.random.default_rng(0).integers(0, 255, (8, 16, 3), np.uint8)
    corner = np.tile([-0.5, 7.5], (len(shown.points), 1))
    shown = replace(shown, colours=np.full((len(shown.points), 3), 9, np.uint8), texture=TextureMap(corner, picture))
    write_recording(folder / "texture.rrd", shown, PHOTOGRAPH)
    (mesh,) = read(folder / "texture.rrd")["/mesh"]
    # Rerun has (0, 0) in the top left corner of a texture, and (1, 1) in the other one.
    np.testing.assert_allclose(mesh["Mesh3D:vertex_texcoords"], corner * 0 + [0.0, 1.0])
    assert bytes(mesh["Mesh3D:albedo_texture_buffer"][0]) == picture.tobytes()
    assert "Mesh3D:vertex_colors" not in mesh


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("block.npz --rerun x.txt", "--rerun x.txt: a recording of Rerun is an .rrd: end its name with .rrd"),
        ("block.npz --rerun x.rrd --png x.png", "--rerun and --png: give one of them at a time"),
        ("block.npz --photographs scan", "--photographs: only a recording has them: add --rerun OUT.rrd"),
        ("block.npz --rerun x.rrd --photographs scan", "--photographs: needs --rig too"),
        ("block.ply --rerun x.rrd --rig rig.json --photographs scan", "block.ply: --photographs needs the frames of"),
        ("block.npz --rerun nowhere/x.rrd", "there is no folder"),
        ("block.npz --rerun x.rrd --rig rig.json --photographs short", "has 59 steps, and the range image 60"),
        ("block.npz --rerun x.rrd --rig rig.json --photographs small", "00.png: has 10 x 20 pixels, and the rig's"),
    ],
)
def test_bad_input(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: str, problem: str
) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk (extra rerun) is not installed")
    monkeypatch.chdir(folder)
    for name, size, count in (("short", (480, 640), 59), ("small", (20, 10), 60)):
        frames = folder / name / "frames"
        if not frames.exists():
            frames.mkdir(parents=True)
            for i in range(count):
                cv2.imwrite(str(frames / f"{i:02}.png"), np.zeros(size, np.uint8))
            text = '[scan]\nframes = "frames/*.png"\nsteps_per_frame = 100\n'
            (folder / name / "scan.toml").write_text(text)
    assert main(["view", *words.split()]) == 2
    assert problem in capsys.readouterr().err
    assert not [path for path in folder.iterdir() if path.name.startswith(("x.", ".x"))]


def test_a_video_has_no_photographs(folder: Path) -> None:
    scan = replace(read_scan(folder / "scan"), video=Path("scan.mp4"))
    with pytest.raises(InputError, match=r"--photographs takes single photographs, and scan\.mp4 is a video"):
        photographs_of(scan, 60)
