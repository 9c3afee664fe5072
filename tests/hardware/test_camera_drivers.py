"""Cameras: those of files as they are, those of extras on stand-ins for their libraries, the simulated one."""

import sys
import time
import types
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hardware import CameraDriver
from hardware.cameras.deadline import let_go, within
from hardware.cameras.folder import FolderCamera
from hardware.cameras.genicam import GenICamCamera
from hardware.cameras.gphoto import GPhotoCamera
from hardware.cameras.opencv import OpenCvCamera
from hardware.devices import read_photograph
from hardware.errors import CameraError, NoAnswerError

RED = np.zeros((48, 64, 3), np.uint8)
RED[..., 0] = 200


def test_a_call_that_never_returns_is_left_behind():
    begin = time.monotonic()
    with pytest.raises(NoAnswerError, match="the camera: nothing came in"):
        within(0.1, lambda: time.sleep(5), "the camera")
    assert time.monotonic() - begin < 2
    assert within(1, lambda: 7, "") == 7
    with pytest.raises(ZeroDivisionError):
        within(1, lambda: 1 / 0, "")


def test_a_camera_that_does_not_let_go_is_left_behind(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hardware.cameras.deadline._LET_GO_S", 0.1)
    begin = time.monotonic()
    let_go(lambda: time.sleep(5))
    let_go(lambda: 1 / 0)
    assert time.monotonic() - begin < 2


def test_a_video_by_opencv(tmp_path: Path):
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for i in range(2):
        writer.write(cv2.cvtColor(RED // (i + 1), cv2.COLOR_RGB2BGR))
    writer.release()
    camera = OpenCvCamera(str(tmp_path / "v.avi"))
    with pytest.raises(CameraError, match="open it first"):
        camera.expose({"stage": 0})
    camera.open()
    camera.configure(0.02)
    first, second = camera.expose({"stage": 0}), camera.expose({"stage": 2000})
    assert first.image[..., 0].mean() == pytest.approx(200, abs=5)
    assert first.image[..., 2].mean() < 10
    assert second.image[..., 0].mean() == pytest.approx(100, abs=5)
    assert second.positions == {"stage": 2000}
    with pytest.raises(CameraError, match="the video has ended"):
        camera.expose({"stage": 4000})
    camera.close()
    camera.close()


def test_a_camera_that_is_not_there(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OPENCV_LOG_LEVEL", "OFF")
    with pytest.raises(CameraError, match="scanner devices"):
        OpenCvCamera(93).open()


def test_photographs_in_their_order_and_by_their_steps(tmp_path: Path):
    paths = [tmp_path / f"{name}.png" for name in (2, 10)]
    for path in paths:
        cv2.imwrite(str(path), cv2.cvtColor(RED // int(path.stem), cv2.COLOR_RGB2BGR))
    camera = FolderCamera(paths, read_photograph)
    assert isinstance(camera, CameraDriver)
    camera.open()
    assert [int(camera.expose({"stage": i}).image[0, 0, 0]) for i in range(2)] == [100, 20]
    with pytest.raises(CameraError, match="2 in all"):
        camera.expose({"stage": 2})
    camera = FolderCamera(paths, read_photograph, positions=[{"stage": 500}, {"stage": 0}])
    assert [int(camera.expose({"stage": i}).image[0, 0, 0]) for i in (500, 0, 500)] == [100, 20, 100]
    with pytest.raises(CameraError, match="step 1000"):
        camera.expose({"stage": 1000})
    paths[0].write_bytes(b"")
    with pytest.raises(CameraError, match="file is empty"):
        camera.expose({"stage": 500})
    with pytest.raises(CameraError, match="no photographs"):
        FolderCamera([], read_photograph).open()


def test_extras_that_are_not_installed(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(CameraError, match=r"jaxscan\[gphoto2\]"):
        GPhotoCamera()
    with pytest.raises(CameraError, match=r"jaxscan\[genicam\]"):
        GenICamCamera(Path("maker.cti"))


def stand_in(**members: Any) -> Any:
    return types.SimpleNamespace(**members)


def test_gphoto2(monkeypatch: pytest.MonkeyPatch):
    """Stands in for python-gphoto2: a camera with three shutter speeds."""
    jpeg = cv2.imencode(".jpg", cv2.cvtColor(RED, cv2.COLOR_RGB2BGR))[1].tobytes()
    chosen: dict[str, str] = {}

    class Widget:
        def __init__(self, name: str):
            self.name = name

        def get_choices(self) -> list[str]:
            return {"shutterspeed": ["1/100", "1/10", "bulb"], "iso": ["Auto", "100", "200"]}[self.name]

        def set_value(self, value: str) -> None:
            chosen[self.name] = value

    deleted = []
    device = stand_in(
        init=lambda: None,
        exit=lambda: None,
        get_config=lambda: stand_in(get_child_by_name=Widget),
        set_config=lambda config: None,
        capture=lambda kind: stand_in(folder="/", name="a.jpg"),
        file_get=lambda *path: stand_in(get_data_and_size=lambda: jpeg),
        file_delete=lambda *path: deleted.append(path),
    )
    gp: Any = stand_in(Camera=lambda: device, GPhoto2Error=OSError, GP_CAPTURE_IMAGE=0, GP_FILE_TYPE_NORMAL=1)
    monkeypatch.setitem(sys.modules, "gphoto2", gp)
    camera = GPhotoCamera()
    assert isinstance(camera, CameraDriver)
    with pytest.raises(CameraError, match="open it first"):
        camera.expose({"stage": 0})
    camera.open()
    camera.configure(0.08, gain=1.9)
    assert chosen == {"shutterspeed": "1/10", "iso": "200"}
    frame = camera.expose({"stage": 40})
    assert frame.image[..., 0].mean() == pytest.approx(200, abs=5)
    assert (frame.positions, frame.exposure_s, len(deleted)) == ({"stage": 40}, 0.08, 1)
    device.capture = lambda kind: (_ for _ in ()).throw(OSError("[-110] I/O in progress"))
    with pytest.raises(CameraError, match="I/O in progress: focus by hand"):
        camera.expose({"stage": 40})
    camera.close()
    camera.close()


def test_genicam(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Stands in for harvesters: a camera that answers to two triggers."""
    triggers = []

    class Buffer:
        def __init__(self, form: str):
            part = stand_in(data_format=form, height=2, width=3, data=np.arange(6))
            self.payload = stand_in(components=[part])

        def __enter__(self) -> "Buffer":
            return self

        def __exit__(self, *_: object) -> None:
            triggers.append("queued again")

    def node() -> Any:
        return stand_in(value=None, execute=lambda: triggers.append("triggered"))

    names = "TriggerSelector TriggerMode TriggerSource ExposureTime Gain TriggerSoftware"
    nodes = stand_in(**{name: node() for name in names.split()})
    given = iter([Buffer("Mono12"), Buffer("BayerRG8"), None])
    acquirer = stand_in(
        remote_device=stand_in(node_map=nodes),
        start=lambda: None,
        destroy=lambda: None,
        try_fetch=lambda timeout: next(given),
    )
    harvester = stand_in(
        add_file=lambda path: None, update=lambda: None, create=lambda which: acquirer, reset=lambda: None
    )
    monkeypatch.setitem(sys.modules, "harvesters.core", stand_in(Harvester=lambda: harvester))
    with pytest.raises(CameraError, match=r"name the \.cti file"):
        GenICamCamera(tmp_path / "none.cti").open()
    (tmp_path / "maker.cti").touch()
    camera = GenICamCamera(tmp_path / "maker.cti")
    assert isinstance(camera, CameraDriver)
    camera.open()
    camera.configure(0.005, gain=10.0)
    assert (nodes.ExposureTime.value, nodes.Gain.value, nodes.TriggerMode.value) == (5000, 20, "On")
    image = camera.expose({"stage": 0}).image
    assert (image.dtype, image.shape) == (np.uint16, (2, 3))
    assert triggers == ["triggered", "queued again"]
    with pytest.raises(CameraError, match="BayerRG8"):
        camera.expose({"stage": 0})
    with pytest.raises(NoAnswerError, match="check its cable"):
        camera.expose({"stage": 0})
    acquirer.try_fetch = lambda timeout: (_ for _ in ()).throw(OSError("device is gone"))
    with pytest.raises(CameraError, match="device is gone: check its cable"):
        camera.expose({"stage": 0})
    camera.close()
    camera.close()
