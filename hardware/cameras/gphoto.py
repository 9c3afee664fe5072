"""Tethered still cameras (Canon, Nikon and others) by libgphoto2: the extra `gphoto2`."""

import time
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import cv2
import numpy as np

from hardware.cameras.deadline import let_go, within
from hardware.errors import CameraError
from hardware.frame import Frame

_OPEN_S, _SLACK_S = 10.0, 20.0


class GPhotoCamera:
    """The first camera that gphoto2 finds; its mode dial stands on M, its focus on manual."""

    def __init__(self) -> None:
        try:
            self._gp: Any = import_module("gphoto2")
        except ImportError as error:
            raise CameraError("cameras by gphoto2 need the extra: pip install 'jaxscan[gphoto2]'") from error
        self._camera: Any = None
        self._exposure_s = 1 / 30

    def open(self) -> None:
        """Connect.

        Raises:
            CameraError: no camera, or another program has mounted it.
        """
        camera = self._gp.Camera()
        self._try(_OPEN_S, camera.init, "unmount it where the desktop has mounted it, and switch it on")
        self._camera = camera

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set the nearest shutter speed, and ISO 100 times the gain.

        Raises:
            CameraError: the camera has no such settings, or not these.
        """
        config = self._try(_OPEN_S, self._opened().get_config, "put its mode dial on M")
        for name, wanted in (("shutterspeed", exposure_s), ("iso", 100 * gain)):
            try:
                widget = config.get_child_by_name(name)
            except self._gp.GPhoto2Error as error:
                raise CameraError(f"the camera has no setting {name}: put its mode dial on M") from error
            choices = {text: value for text in widget.get_choices() if (value := _number(text)) is not None}
            if not choices:
                raise CameraError(f"the camera's {name} cannot be chosen: put its mode dial on M")
            widget.set_value(min(choices, key=lambda text: abs(np.log(choices[text] / wanted))))
        self._try(_OPEN_S, lambda: self._opened().set_config(config), "put its mode dial on M")
        self._exposure_s = exposure_s

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """Take one photograph and fetch it.

        Raises:
            CameraError: it was not taken, or is a raw file.
            NoAnswerError: the camera does not answer.
        """
        gp, camera, time_s = self._gp, self._opened(), time.time()

        def take() -> bytes:
            path = camera.capture(gp.GP_CAPTURE_IMAGE)
            data = bytes(camera.file_get(path.folder, path.name, gp.GP_FILE_TYPE_NORMAL).get_data_and_size())
            camera.file_delete(path.folder, path.name)
            return data

        data = self._try(self._exposure_s + _SLACK_S, take, "focus by hand; a dark picture stops the automatic")
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise CameraError("the camera's file is no JPEG: set its quality to JPEG, without raw")
        return Frame(image, positions, time_s, self._exposure_s)

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        if self._camera is not None:
            let_go(self._camera.exit)
            self._camera = None

    def _opened(self) -> Any:
        if self._camera is None:
            raise CameraError("the camera is not open: open it first")
        return self._camera

    def _try(self, seconds: float, work: Any, fix: str) -> Any:
        try:
            return within(seconds, work, "gphoto2 camera")
        except self._gp.GPhoto2Error as error:
            raise CameraError(f"gphoto2 camera: {error}: {fix}") from error


def _number(text: str) -> float | None:
    """1/125, 0.8 or 2 as a number."""
    try:
        top, _, bottom = text.partition("/")
        value = float(top) / float(bottom or 1)
    except (ValueError, ZeroDivisionError):
        return None
    return value if value > 0 else None
