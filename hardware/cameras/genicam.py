"""Industrial cameras (GigE Vision, USB3 Vision) by their maker's GenTL producer and harvesters: the extra `genicam`."""

import time
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hardware.cameras.deadline import let_go, within
from hardware.errors import CameraError, HardwareError, NoAnswerError
from hardware.frame import Frame

_OPEN_S, _SLACK_S = 20.0, 5.0
_DEPTHS = {"Mono8": np.uint8, "Mono10": np.uint16, "Mono12": np.uint16, "Mono16": np.uint16, "RGB8": np.uint8}


class GenICamCamera:
    """A camera with a software trigger.

    Args:
        producer: the maker's `.cti` file.
        serial_number: which of several cameras; by default the first.
    """

    def __init__(self, producer: Path, serial_number: str | None = None):
        try:
            self._harvester: Any = import_module("harvesters.core").Harvester()
        except ImportError as error:
            raise CameraError("GenICam cameras need the extra: pip install 'jaxscan[genicam]'") from error
        self._producer, self._which = Path(producer), serial_number
        self._acquirer: Any = None
        self._exposure_s = 1 / 30

    def open(self) -> None:
        """Connect, and wait for software triggers.

        Raises:
            CameraError: no producer, no camera, or one without these features.
        """
        if not self._producer.is_file():
            raise CameraError(f"{self._producer}: no such GenTL producer: name the .cti file of the camera's maker")

        def connect() -> None:
            self._harvester.add_file(str(self._producer))
            self._harvester.update()
            self._acquirer = self._harvester.create(0 if self._which is None else {"serial_number": self._which})
            nodes = self._acquirer.remote_device.node_map
            nodes.TriggerSelector.value, nodes.TriggerMode.value, nodes.TriggerSource.value = (
                "FrameStart",
                "On",
                "Software",
            )
            self._acquirer.start()

        try:
            self._try(_OPEN_S, connect, "check its cable and power, and that nothing else uses it")
        except HardwareError:
            self.close()
            raise

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure and gain (dB, by the factor).

        Raises:
            CameraError: out of the camera's range.
        """
        nodes = self._opened().remote_device.node_map

        def set_both() -> None:
            nodes.ExposureTime.value = 1e6 * exposure_s
            nodes.Gain.value = 20 * float(np.log10(gain))

        self._try(_SLACK_S, set_both, f"it does not take {exposure_s} s, gain {gain}: choose others")
        self._exposure_s = exposure_s

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """Trigger one photograph.

        Raises:
            NoAnswerError: it did not come.
            CameraError: the camera is gone, or its pixels are of a format that is not read here.
        """
        acquirer, time_s = self._opened(), time.time()
        limit_s = self._exposure_s + _SLACK_S

        def take() -> Any:
            acquirer.remote_device.node_map.TriggerSoftware.execute()
            return acquirer.try_fetch(timeout=limit_s)

        buffer = self._try(limit_s + _SLACK_S, take, "check its cable and power")
        if buffer is None:
            raise NoAnswerError(f"GenICam camera: no photograph in {limit_s:.1f} s: check its cable and power")
        with buffer:
            part = buffer.payload.components[0]
            depth = _DEPTHS.get(part.data_format)
            if depth is None:
                raise CameraError(
                    f"GenICam camera: pixels of {part.data_format}: set PixelFormat to {', '.join(_DEPTHS)}"
                )
            shape = (part.height, part.width, 3) if part.data_format == "RGB8" else (part.height, part.width)
            image = np.array(part.data, depth).reshape(shape)
        return Frame(image, positions, time_s, self._exposure_s)

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        if self._acquirer is not None:
            let_go(self._acquirer.destroy)
            self._acquirer = None
        let_go(self._harvester.reset)

    def _opened(self) -> Any:
        if self._acquirer is None:
            raise CameraError("the camera is not open: open it first")
        return self._acquirer

    @staticmethod
    def _try(seconds: float, work: Callable[[], Any], fix: str) -> Any:
        try:
            return within(seconds, work, "GenICam camera")
        except HardwareError:
            raise
        except Exception as error:  # its exceptions are the maker's, and of many families
            raise CameraError(f"GenICam camera: {error}: {fix}") from error
