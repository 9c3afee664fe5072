"""Scans: what is on the disk at any moment, and what is switched off afterwards."""

import json
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from hardware import Frame
from hardware.errors import CameraError, HardwareError, LeftOnError, StoppedError
from hardware.lasers import FixedLaser, RtsLaser
from hardware.safety import safely
from hardware.scan import Control, Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan
from jaxscan.images import read_image


class GreyCamera:
    """Photographs a grey that says where the stage truly is, and whether the laser is on."""

    def __init__(self, stage: SimulatedStage, laser: SimulatedLaser | FixedLaser):
        self.stage, self.laser = stage, laser
        self.fails_at = -1
        self.exposure_s = 0.01

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        self.exposure_s = exposure_s

    def expose(self, positions: Mapping[str, int]) -> Frame:
        if positions["stage"] == self.fails_at:
            raise CameraError("no photograph: check its cable")
        level = round(self.stage.true_position() / 1000) + (100 if getattr(self.laser, "lit", True) else 0)
        return Frame(np.full((4, 5, 3), level, np.uint8), positions, 0.0, self.exposure_s)

    def close(self) -> None:
        """Nothing."""


def devices(**how: float) -> Devices:
    stage, laser = SimulatedStage(Travel(last=20000), play=150, **how), SimulatedLaser()
    return Devices(GreyCamera(stage, laser), {"stage": stage}, laser)


def levels(paths: tuple[Path, ...]) -> list[int]:
    return [int(read_image(path)[0, 0, 0]) for path in paths]


def test_every_frame_is_on_the_disk_before_the_next_move(tmp_path: Path):
    there = devices()
    folder = ScanFolder.create(
        tmp_path / "scan", Plan({"stage": (0, 5000, 3000)}, dark=True, exposure_s=0.02, name="cup")
    )
    counted = []

    def taken(path: Path, frame: Frame) -> None:
        scan = read_scan(tmp_path / "scan")
        counted.append(len(scan.frames))
        assert scan.frames[-1].name == path.name
        assert there.axes["stage"].position() == frame.positions["stage"] == scan.axes["stage"][-1]

    take(folder, there, taken=taken)
    assert counted == [1, 2, 3]
    scan = read_scan(tmp_path / "scan")
    assert (scan.axes["stage"], scan.name, scan.exposures_s) == ((0, 5000, 3000), "cup", (0.02,) * 3)
    assert levels(scan.frames) == [100, 105, 103]
    assert levels(scan.backgrounds) == [0, 5, 3]
    assert not there.laser.lit
    take(ScanFolder.resume(tmp_path / "scan"), there)


def test_a_camera_that_fails_leaves_a_scan_that_goes_on(tmp_path: Path):
    there = devices()
    there.camera.fails_at = 3000
    with pytest.raises(CameraError, match="check its cable"):
        take(ScanFolder.create(tmp_path / "scan", Plan({"stage": (0, 1000, 2000, 3000)})), there)
    assert not there.laser.lit
    (tmp_path / "scan" / "frames" / "0003.png").write_bytes(b"half a photograph")
    (tmp_path / "scan" / "frames" / ".0003.png.ab.part").write_bytes(b"half")
    there.camera.fails_at = -1
    folder = ScanFolder.resume(tmp_path / "scan")
    assert folder.left == ({"stage": 3000},)
    take(folder, there)
    assert levels(read_scan(tmp_path / "scan").frames) == [100, 101, 102, 103]
    assert not list((tmp_path / "scan").rglob("*.part"))


def test_pause_resume_abort_from_another_thread(tmp_path: Path):
    there, control = devices(), Control()
    folder = ScanFolder.create(tmp_path / "scan", Plan({"stage": tuple(range(0, 20000, 1000))}))
    at_three, ended = threading.Event(), []

    def taken(path: Path, frame: Frame) -> None:
        if frame.positions["stage"] == 2000:
            control.pause()
            at_three.set()

    def run() -> None:
        try:
            take(folder, there, control, taken)
        except HardwareError as error:
            ended.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    assert at_three.wait(10)
    thread.join(0.2)
    assert thread.is_alive()
    assert len(read_scan(tmp_path / "scan").frames) == 3
    assert not there.laser.lit
    control.abort()
    thread.join(10)
    assert isinstance(ended[0], StoppedError)
    folder = ScanFolder.resume(tmp_path / "scan")
    assert len(folder.left) == 17
    control = Control()
    control.pause()
    control.resume()
    take(folder, there, control)
    assert len(read_scan(tmp_path / "scan").frames) == 20


def test_a_cable_pulled_says_that_stage_and_laser_may_be_on(tmp_path: Path):
    stage = SimulatedStage(Travel(last=20000), pull_s=25)
    laser = RtsLaser(stage.line)
    there = Devices(GreyCamera(stage, FixedLaser()), {"stage": stage}, laser)
    with pytest.raises(LeftOnError) as caught:
        take(ScanFolder.create(tmp_path / "scan", Plan({"stage": tuple(range(0, 20000, 1000))})), there)
    assert "LASER MAY STILL BE ON" in str(caught.value)
    assert "STAGE MAY STILL BE MOVING" in str(caught.value)
    assert 1 < len(read_scan(tmp_path / "scan").frames) < 20


@pytest.mark.parametrize("reason", [KeyboardInterrupt, SystemExit, ZeroDivisionError])
def test_the_laser_goes_off_whatever_happens(reason: type[BaseException]):
    there = devices(speed=10)
    there.axes["stage"].home()
    there.laser.on()

    def move() -> None:
        with pytest.raises(StoppedError):
            there.axes["stage"].move_to(20000)

    mover = threading.Thread(target=move)
    mover.start()

    def fail() -> None:
        with safely(there.axes, there.laser):
            raise reason

    with pytest.raises(reason):
        fail()
    mover.join(5)
    assert not there.laser.lit
    assert not there.axes["stage"].line.port.axis.moving(there.axes["stage"].line.clock.now_s())


def test_an_interpreter_that_ends_without_the_block_switches_it_off():
    code = """
from hardware.safety import safely
class Laser:
    def off(self): print("off")
block = safely({}, Laser())
block.__enter__()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert "off" in done.stdout


def test_scans_that_cannot_be(tmp_path: Path):
    once = {"stage": (0,)}
    for wrong in (
        {"axes": {"stage": ()}},
        {"axes": {"stage": (0, 0)}},
        {"axes": {}},
        {"axes": {"stage": (0, 1), "turntable": (0,)}},
        {"axes": {"the stage": (0, 1)}},
        {"axes": once, "settle_s": -1},
        {"axes": once, "exposure_s": 0},
    ):
        with pytest.raises(InputError, match=list(wrong)[-1]):
            Plan(**wrong)
    ScanFolder.create(tmp_path / "scan", Plan({"stage": (0, 1000)}))
    assert read_scan(tmp_path / "scan").frames == ()
    with pytest.raises(InputError, match="--resume"):
        ScanFolder.create(tmp_path / "scan", Plan({"stage": (0,)}))
    with pytest.raises(InputError, match="without --resume"):
        ScanFolder.resume(tmp_path / "other")
    there = devices()
    always = Devices(there.camera, there.axes, FixedLaser())
    with pytest.raises(InputError, match="always on"):
        take(ScanFolder.create(tmp_path / "dark", Plan({"stage": (0,)}, dark=True)), always)
    plan = json.loads((tmp_path / "scan" / "plan.json").read_text())
    take(ScanFolder.resume(tmp_path / "scan"), there)
    (tmp_path / "scan" / "plan.json").write_text(json.dumps({**plan, "axes": {"stage": [0, 2000]}}))
    with pytest.raises(InputError, match="changed by hand"):
        ScanFolder.resume(tmp_path / "scan")
    (tmp_path / "scan" / "plan.json").write_text(json.dumps({**plan, "settles": 1}))
    with pytest.raises(InputError, match='did you mean "settle_s"'):
        ScanFolder.resume(tmp_path / "scan")


def test_a_listed_frame_that_is_not_whole_is_named(tmp_path: Path):
    there = devices()
    take(ScanFolder.create(tmp_path / "scan", Plan({"stage": (0, 1000)})), there)
    path = tmp_path / "scan" / "frames" / "0001.png"
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(InputError, match=r"0001\.png: the image is cut off"):
        ScanFolder.resume(tmp_path / "scan")


def test_a_scan_needs_no_jax():
    code = "import sys, hardware.scan, hardware.scan_plan; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "False"
