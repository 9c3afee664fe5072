"""Simulated photographs through the commands, as a user types them, and what the commands refuse."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

from hardware.guide import guided_session
from hardware.lasers import FixedLaser
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.operator import SimulatedOperator
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan.cli.main import main
from jaxscan.files.cloud import read_ply
from jaxscan.files.range_npz import read_range_npz
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.files.session import read_session
from jaxscan.simulation import distance, rig_2003
from jaxscan.simulation.folders import read_scan_truth
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.shapes import cup


@pytest.fixture(scope="module")
def scene() -> Scene:
    return rig_2003.scan_scene(rig_2003.simulated_rig(1), cup(rig_2003.OBJECT_Y))


def test_hardware_to_file_to_points(world: Path, scene: Scene, tmp_path: Path) -> None:
    """The simulated scanner, its stage with play: a guided session, a scan, and the points that come of them."""
    stage, laser = SimulatedStage(Travel(last=80000, backlash=900), play=900), SimulatedLaser()
    simulated = SimulatedWorld(1, cup(rig_2003.OBJECT_Y))
    laser.on()
    devices = Devices(SimulatedCamera(simulated, {"stage": stage}, laser), {"stage": stage}, FixedLaser())
    said: list[str] = []
    operator = SimulatedOperator(simulated, 6, said.append)
    how = {"views": 6, "stage_steps": range(0, 60001, 15000)}
    session = guided_session(tmp_path / "session", devices, rig_2003.BOARD, operator, **how)
    assert read_session(tmp_path / "session") == session
    assert any("now tilt the board" in words for words in said)
    simulated.put_object()
    plan = Plan({"stage": tuple(range(0, 48001, 12000))}, name="cup")
    take(ScanFolder.create(tmp_path / "scan", plan), devices)
    assert main(["calibrate", str(tmp_path / "session"), "-o", str(tmp_path / "rig.json")]) == 0
    out = tmp_path / "cup.ply"
    assert main(["reconstruct", str(tmp_path / "scan"), "--rig", str(tmp_path / "rig.json"), "-o", str(out)]) == 0
    points = read_ply(out).points.astype(np.float64)
    assert len(points) > 0.95 * len(read_ply(world / "cup.ply").points)
    assert np.sqrt((distance(scene, points) ** 2).mean()) < 0.16


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
        ("lights.0.plane.1", found.rig.lights[0].plane[1], true.rig.lights[0].plane[1]),
    ):
        assert abs(float(a) - float(b)) < 6 * found.covariance.sigma(name)
    assert found.fit["views"] == 6


def test_the_report_is_there(world: Path) -> None:
    page = (world / "report" / "report.html").read_text()
    values = json.loads((world / "report" / "report.json").read_text())
    assert values["format"] == "jaxscan-calibration-report/1"
    assert "What photograph would help most?" in page
    assert "Do not use" not in values["verdict"]["statement"]
    assert len(values["numbers"]["diagnostics"]["photographs"]) == 11


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


def test_frames_of_another_depth_are_named_however_late_they_come(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_module("jaxscan.reconstruction.frames"), "FRAMES_AT_ONCE", 1)
    frame = cv2.imread(str(world / "scan" / "frames" / "000.png"))
    cv2.imwrite(str(tmp_path / "0.png"), frame)
    cv2.imwrite(str(tmp_path / "1.png"), frame.astype(np.uint16) * 257)
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "*.png"\nsteps_per_frame = 2000\n')
    out = tmp_path / "out.ply"
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 2
    assert "1.png: is uint16" in capsys.readouterr().err
    assert not out.exists()


def test_a_rig_that_sees_nothing_of_the_stripe(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sheet above the optical axis; the stripe of the scan is below it everywhere."""
    rig = json.loads((world / "rig.json").read_text())
    rig = {key: rig[key] for key in ("format", "units", "camera", "lights", "motion")}
    rig["lights"][0]["plane"] = [0.0, -0.05, -0.01]
    (tmp_path / "rig.json").write_text(json.dumps(rig))
    (tmp_path / "frame.png").symlink_to(world / "scan" / "frames" / "000.png")
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "frame.png"\nsteps = [0]\n')
    out = ["-o", str(tmp_path / "out.ply")]
    assert main(["reconstruct", str(tmp_path), "--rig", str(tmp_path / "rig.json"), *out]) == 2
    assert "no ray through it meets the rig's light plane" in capsys.readouterr().err


def test_frames_without_a_stripe(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.zeros((480, 640, 3), np.uint8))
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "*.png"\nsteps_per_frame = 2000\n')
    out = tmp_path / "out.ply"
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 2
    assert "no stripe was found in any of 2 frames" in capsys.readouterr().err
    assert not out.exists()


def test_the_colour_that_shows_a_stripe_is_named(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A red laser whose folder says green, in a scan and in a session."""
    scan, session = tmp_path / "scan", tmp_path / "session"
    for name, folders in (("scan", ["frames"]), ("session", ["boards", "stage"])):
        (tmp_path / name).mkdir()
        for folder in folders:
            (tmp_path / name / folder).symlink_to(world / name / folder)
    (scan / "scan.toml").write_text(
        '[scan]\nframes = "frames/*.png"\nsteps_per_frame = 2000\n[laser]\ncolor = "green"\n'
    )
    out = ["--rig", str(world / "rig.json"), "-o", str(tmp_path / "out.ply")]
    assert main(["reconstruct", str(scan), *out]) == 2
    assert 'no stripe was found in any of 5 frames, but with color = "red" there is one' in capsys.readouterr().err
    text = (world / "session" / "session.toml").read_text()
    (session / "session.toml").write_text(text.replace('color = "red"', 'color = "blue"'))
    assert 'color = "blue"' in (session / "session.toml").read_text()
    assert main(["calibrate", str(session), "-o", str(tmp_path / "rig.json")]) == 2
    said = capsys.readouterr().err
    assert 'no stripe was found with color = "blue", but with color = "red" there is one: set this' in said


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


def test_a_video_with_fewer_frames_than_steps(world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "scan.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
    writer.write(cv2.imread(str(world / "scan" / "frames" / "000.png")))
    writer.release()
    (tmp_path / "scan.toml").write_text('[scan]\nframes = "scan.avi"\nsteps = [0, 2000]\n')
    out = tmp_path / "video.npz"
    assert main(["reconstruct", str(tmp_path), "--rig", str(world / "rig.json"), "-o", str(out)]) == 2
    assert "2 positions of the axes, but" in capsys.readouterr().err
    assert not out.exists()


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
    # Three photographs: each is searched in every way that there is.
    other = {"inner_corners": "[12, 11]", "boards": '["boards/00.png", "boards/01.png", "boards/02.png"]'}
    pairs = [line.partition(" = ") for line in _flat(text)]
    lines = ["".join((key, equals, other.get(key, value))) for key, equals, value in pairs]
    wrong.write_text("\n".join(lines))
    out = tmp_path / "rig.json"
    assert main(["calibrate", str(wrong), "-o", str(out)]) == 2
    err = capsys.readouterr().err
    assert "12 x 11" in err
    assert "none of 3 views" in err
    assert "check [board]" in err
    assert not out.exists()


def test_sessions_that_do_not_go_together_are_refused_before_their_photographs_are_looked_at(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = world / "session" / "other.toml"
    other.write_text((world / "session" / "session.toml").read_text().replace("square_mm = 16.0", "square_mm = 16.5"))
    assert main(["calibrate", str(world / "session"), str(other), "-o", str(tmp_path / "rig.json")]) == 2
    err = capsys.readouterr().err
    assert "at 16.5 mm" in err
    assert "finding boards" not in err


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
    toml = world / "session" / "session.toml"
    assert main(["calibrate", str(world / "session"), "-o", str(toml)]) == 2
    assert "end its name with .json" in capsys.readouterr().err
    assert toml.read_text().startswith("[board]")
