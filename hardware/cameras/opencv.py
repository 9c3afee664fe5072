"""Cameras that OpenCV opens: USB, a network stream (RTSP), a video file."""

import math
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2

from hardware.cameras.deadline import let_go, within
from hardware.errors import CameraError
from hardware.frame import Frame

# Opening a network stream takes this long at most, and a photograph this much more than its exposures.
_OPEN_S, _SLACK_S = 15.0, 5.0
# Live sources keep finished photographs in a queue: those taken before the laser or the stage came to rest.
_QUEUED = 4


class OpenCvCamera:
    """A camera, a stream or a video behind `cv2.VideoCapture`.

    Args:
        source: the number of a camera, a device, the URL of a stream, or a video file.
        size: columns and rows to ask for; otherwise what the camera has set.
        queued: photographs that may lie in a queue, and are thrown away before each that counts.
    """

    def __init__(self, source: int | str, size: tuple[int, int] | None = None, queued: int = _QUEUED):
        self.source, self._size = source, size
        self._live = not (isinstance(source, str) and Path(source).is_file())
        self._queued = queued if self._live else 0
        self._exposure_s = 1 / 30
        self._capture: Any = None

    def open(self) -> None:
        """Connect.

        Raises:
            CameraError: there is no such camera, or it has no such size.
        """
        # FFmpeg under OpenCV takes its voice from the environment, once: when the process opens its first source.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        capture = within(_OPEN_S, lambda: cv2.VideoCapture(self.source), f"camera {self.source}")
        if not capture.isOpened():
            raise CameraError(
                f"camera {self.source}: cannot be opened: `scanner devices` lists the cameras that are there; another "
                "program may hold this one, or you may not be in its group (video)"
            )
        self._capture = capture
        if self._size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size[1])
            got = tuple(int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            if got != tuple(self._size):
                self.close()
                raise CameraError(
                    f"camera {self.source}: gives {got[0]} x {got[1]} pixels, not {self._size}: ask for those"
                )

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure and gain by hand, without the camera's own automatic.

        Drivers differ in the unit that they take for the exposure: V4L has 100 µs, the others the logarithm to base 2.

        Raises:
            CameraError: the camera does not take them: it would change between the frames of a scan.
        """
        capture = self._opened()
        self._exposure_s = exposure_s
        if not self._live:
            return
        v4l = capture.getBackendName().startswith("V4L")
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1 if v4l else 0.25)
        asked = exposure_s * 1e4 if v4l else math.log2(exposure_s)
        if not capture.set(cv2.CAP_PROP_EXPOSURE, asked):
            raise CameraError(
                f"camera {self.source}: does not let its exposure be set: leave exposure_s out of [camera], and "
                "switch its automatic off by its own means"
            )
        if gain != 1.0 and not capture.set(cv2.CAP_PROP_GAIN, gain):
            raise CameraError(f"camera {self.source}: does not let its gain be set: leave gain out of [camera]")

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """Take one photograph that was begun after this call.

        Raises:
            CameraError: it gives none: the cable is out, or the video has ended.
            NoAnswerError: it does not answer at all.
        """
        capture = self._opened()
        time_s = time.time()

        def read() -> Any:
            for _ in range(self._queued):
                capture.grab()
            return capture.read()

        limit_s = (self._queued + 2) * self._exposure_s + _SLACK_S
        there, image = within(limit_s, read, f"camera {self.source}")
        if not there:
            what = "check its cable and power" if self._live else "the video has ended"
            raise CameraError(f"camera {self.source}: gave no photograph: {what}")
        return Frame(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), positions, time_s, self._exposure_s)

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        if self._capture is not None:
            let_go(self._capture.release)
            self._capture = None

    def _opened(self) -> Any:
        if self._capture is None:
            raise CameraError(f"camera {self.source}: is not open: open it first")
        return self._capture
