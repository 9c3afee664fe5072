"""Simulated photographs through the commands, as a user types them, and what the commands refuse."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.files.cloud import read_ply
from jaxscan.files.range_npz import read_range_npz
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.simulation import distance, rig_2003
from jaxscan.simulation.folders import read_scan_truth, simulate_scan, simulate_session, write_truth
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.shapes import cup


@pytest.fixture(scope="module")
def scene() -> Scene:
    return rig_2003.scan_scene(rig_2003.simulated_rig(1), cup(rig_2003.OBJECT_Y))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, scene: Scene) -> Path:
    """A session of six boards and five stage photographs, a scan of five frames, calibrated and reconstructed."""
    folder = tmp_path_factory.mktemp("world")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_2003, "BOARD_VIEWS", 6)
        patch.setattr(rig_2003, "STAGE_VIEWS", 5)
        session = simulate_session(folder / "session", 1)
    scan = simulate_scan(folder / "scan", session.rig, scene, 1, frames=5, steps_apart=12000)
    write_truth(folder / "truth", session, scan)
    assert main(["calibrate", str(folder / "session"), "-o", str(folder / "rig.json")]) == 0
    points = ["-o", str(folder / "cup.ply"), "-o", str(folder / "cup.npz")]
    assert main(["reconstruct", str(folder / "scan"), "--rig", str(folder / "rig.json"), *points]) == 0
    return folder


def test_the_cloud_lies_on_the_cup(world: Path, scene: Scene) -> None:
    cloud = read_ply(world / "cup.ply")
    off = distance(scene, cloud.points.astype(np.float64))
    assert np.sqrt((off**2).mean()) < 0.3
    assert cloud.sigma is not None
    assert cloud.sigma_pixel is not None
    assert (cloud.sigma >= cloud.sigma_pixel).all()


def test_what_an_ideal_camera_sees_is_there(world: Path) -> None:
    truth, image = read_scan_truth(world / "truth"), read_range_npz(world / "cup.npz")
    seen = np.isfinite(truth.points).all(axis=-1)
    assert (image.valid & seen).sum() >= 0.95 * seen.sum()
    assert image.steps.tolist() == [0, 12000, 24000, 36000, 48000]


def test_points_move_back_with_the_stage(world: Path, scene: Scene) -> None:
    """The floor of the first and of the last frame is one plane: 48 mm of travel leave no step."""
    image, truth = read_range_npz(world / "cup.npz"), read_scan_truth(world / "truth")
    pair = image.valid & np.isfinite(truth.points).all(axis=-1)
    error = np.where(pair[..., None], image.points - truth.points, np.nan)
    by_frame = np.nanmedian(error, axis=1)
    assert np.abs(by_frame - by_frame.mean(axis=0)).max() < 0.15


def test_the_rig_is_the_true_one_within_its_uncertainty(world: Path) -> None:
    found, true = read_rig(world / "rig.json"), read_rig(world / "truth" / "rig.json")
    assert found.covariance is not None
    for name, a, b in (
        ("camera.focal.0", found.rig.camera.focal[0], true.rig.camera.focal[0]),
        ("laser.plane.1", found.rig.lasers[0].plane[1], true.rig.lasers[0].plane[1]),
    ):
        assert abs(float(a) - float(b)) < 6 * found.covariance.sigma(name)
    assert found.fit["views"] == 6


def test_json_for_programs(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(world / "rig.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "rig"
    out = tmp_path / "again.ply"
    command = ["reconstruct", str(world / "scan"), "--rig", str(world / "rig.json"), "-o", str(out), "--json"]
    assert main(command) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["points"] == len(read_ply(out).points)
    assert "frame" in captured.err


def test_a_rig_of_another_image_size(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = read_rig(world / "rig.json")
    other = replace(content.rig, camera=replace(content.rig.camera, image_size=(1280, 960)))
    write_rig(tmp_path / "other.json", replace(content, rig=other))
    out = tmp_path / "out.ply"
    assert main(["reconstruct", str(world / "scan"), "--rig", str(tmp_path / "other.json"), "-o", str(out)]) == 2
    assert "640 x 480" in capsys.readouterr().err
    assert not out.exists()


def test_a_truncated_frame_is_named_and_nothing_is_written(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "frames").mkdir()
    for i in range(3):
        data = (world / "scan" / "frames" / f"{i:03d}.png").read_bytes()
        (tmp_path / "frames" / f"{i:03d}.png").write_bytes(data if i != 1 else data[: len(data) // 2])
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "frames/*.png"\nsteps_per_frame = 2000\n')
    out = tmp_path / "out.ply"
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 2
    assert "001.png" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames", "scan.toml"]


def test_frames_without_a_stripe(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.zeros((480, 640, 3), np.uint8))
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "*.png"\nsteps_per_frame = 2000\n')
    out = tmp_path / "out.ply"
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 2
    assert "no stripe was found in any of 2 frames" in capsys.readouterr().err
    assert not out.exists()


def test_a_video_is_read_frame_by_frame(world: Path, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "scan.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
    for i in range(3):
        writer.write(cv2.imread(str(world / "scan" / "frames" / f"{i:03d}.png")))
    writer.release()
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "scan.avi"\nsteps_per_frame = 12000\n')
    out = tmp_path / "video.npz"
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 0
    video, photographs = read_range_npz(out), read_range_npz(world / "cup.npz")
    assert video.steps.tolist() == [0, 12000, 24000]
    both = video.valid & photographs.valid[:3]
    assert both.sum() > 0.9 * photographs.valid[:3].sum()
    assert np.nanmedian(np.linalg.norm(video.points - photographs.points[:3], axis=-1)[both]) < 0.2


def test_a_background_is_subtracted(world: Path, tmp_path: Path) -> None:
    """A red lamp in view, present with and without the laser, hides the stripe until it is subtracted."""
    lamp = np.zeros((480, 640, 3), np.uint8)
    lamp[100:130, :, 2] = 200
    frame = cv2.imread(str(world / "scan" / "frames" / "002.png"))
    cv2.imwrite(str(tmp_path / "frame.png"), cv2.add(frame, lamp))
    cv2.imwrite(str(tmp_path / "dark.png"), lamp)
    out = tmp_path / "lamp.npz"
    (tmp_path / "scan.toml").write_text('[scan]\nframes = ["frame.png"]\nsteps = [24000]\nbackground = "dark.png"\n')
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 0
    clean, plain = read_range_npz(out), read_range_npz(world / "cup.npz")
    both = clean.valid[0] & plain.valid[2]
    assert both.sum() > 0.85 * plain.valid[2].sum()
    assert np.median(np.linalg.norm(clean.points[0] - plain.points[2], axis=-1)[both]) < 0.2


def test_the_wrong_board_size_is_named(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (world / "session" / "session.toml").read_text()
    wrong = world / "session" / "wrong.toml"
    lines = ["inner_corners = [12, 11]" if line.startswith("inner_corners") else line for line in _flat(text)]
    wrong.write_text("\n".join(lines))
    out = tmp_path / "rig.json"
    assert main(["calibrate", str(wrong), "-o", str(out)]) == 2
    err = capsys.readouterr().err
    assert "12 x 11" in err
    assert "none of 6 views" in err
    assert "check [board]" in err
    assert not out.exists()


def _flat(text: str) -> list[str]:
    """TOML lines, with arrays that go over several lines put on one."""
    lines, open_line = [], ""
    for line in text.splitlines():
        open_line += line.strip() if open_line else line
        if open_line.count("[") == open_line.count("]"):
            lines.append(open_line)
            open_line = ""
    return lines


def test_an_output_that_cannot_be_written_is_refused_first(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(world / "session"), "-o", str(world / "nowhere" / "rig.json")]) == 2
    assert "create it first" in capsys.readouterr().err
    assert main(["reconstruct", str(world / "scan"), "--rig", str(world / "rig.json"), "-o", "cup.stl"]) == 2
    assert ".stl" in capsys.readouterr().err
