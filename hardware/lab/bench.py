"""The devices on the bench: connected when they are needed, used by one at a time, stopped by anyone."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from hardware.errors import (
    CameraError,
    HardwareError,
    LeftOnError,
    LineLostError,
    NotHomedError,
    PositionUncertainError,
)
from hardware.frame import Frame
from hardware.places import Place
from hardware.protocols import StageDriver, Verifiable
from hardware.safety import left_on, safely
from hardware.scan import Devices

# After these a device may be one that answers no more, and is connected again.
_LOST = (CameraError, LeftOnError, LineLostError)


class Bench:
    """Camera, axes and laser.

    Args:
        connect: opens them.

    Attributes:
        places: where each axis stands, motor steps, of those of which it is known.
    """

    def __init__(self, connect: Callable[[], Devices]):
        self._connect = connect
        self._using = threading.Lock()
        self._devices: Devices | None = None
        self.places: Place = {}

    @contextmanager
    def devices(self) -> Iterator[Devices]:
        """The devices, for the length of the block; whoever comes meanwhile waits.

        Raises:
            HardwareError: they cannot be connected, or whatever the block raises.
        """
        with self._using:
            try:
                if self._devices is None:
                    self._devices = self._connect()
                yield self._devices
            except HardwareError as error:
                self.places = {}
                if isinstance(error, _LOST):
                    self._disconnect()
                raise

    def stop(self) -> str:
        """Switch the laser off and halt all axes, whoever uses them; what could not be, in words."""
        if (devices := self._devices) is None:
            return ""
        self.places = {}
        return left_on(devices.axes, devices.laser)

    def close(self) -> None:
        """Stop, and disconnect."""
        self.stop()
        with self._using:
            self._disconnect()

    def _disconnect(self) -> None:
        devices, self._devices, self.places = self._devices, None, {}
        if devices is not None:
            for device in (devices.camera, *devices.axes.values()):
                # What is lost already need not be reported.
                with suppress(HardwareError, OSError):
                    device.close()


def check(devices: Devices) -> Frame:
    """See that all axes and the camera answer; nothing moves.

    Raises:
        HardwareError: one of them does not.
    """
    with safely(devices.axes, devices.laser):
        places: Place = {}
        for name, axis in devices.axes.items():
            try:
                places[name] = axis.position()
            except (NotHomedError, PositionUncertainError):
                axis.check()
        return devices.camera.expose(places)


class PermittedStage:
    """An axis that asks for leave before every move.

    Args:
        stage: the real one.
        permit: raises what forbids the move.
        arrived: called with the place at which it stands.
    """

    def __init__(self, stage: StageDriver, permit: Callable[[], object], arrived: Callable[[int], object]):
        self._stage, self._permit, self._arrived = stage, permit, arrived

    def home(self) -> None:
        """Home it."""
        self._permit()
        self._stage.home()
        self._arrived(self._stage.position())

    def move_to(self, step_count: int) -> None:
        """Go there."""
        self._permit()
        self._stage.move_to(step_count)
        self._arrived(step_count)

    def position(self) -> int:
        """Where it stands."""
        return self._stage.position()

    @property
    def verifiable(self) -> bool:
        """Whether it can find out that steps were lost."""
        return isinstance(self._stage, Verifiable) and self._stage.verifiable

    def verify(self) -> int:
        """Let it meet its switch again."""
        self._permit()
        assert isinstance(self._stage, Verifiable)
        off = self._stage.verify()
        self._arrived(self._stage.position())
        return off

    def check(self) -> None:
        """See that it answers."""
        self._stage.check()

    def settle(self, seconds: float) -> None:
        """Wait."""
        self._stage.settle(seconds)

    def stop(self) -> None:
        """Stop it."""
        self._stage.stop()

    def close(self) -> None:
        """Disconnect it."""
        self._stage.close()
