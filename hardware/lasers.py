"""Lasers: one that is always on, one on a modem line of a serial port, one on the stage's controller."""

from typing import Protocol, runtime_checkable

from hardware.errors import LineLostError
from hardware.stages.line import Line


class FixedLaser:
    """A laser that nothing here switches."""

    @property
    def switchable(self) -> bool:
        """No."""
        return False

    def on(self) -> None:
        """It is."""

    def off(self) -> None:
        """It stays on."""


class RtsLaser:
    """A laser behind a transistor or relay on RTS, of a port of its own or the controller's."""

    def __init__(self, line: Line):
        self._line = line

    @property
    def switchable(self) -> bool:
        """Yes."""
        return True

    def on(self) -> None:
        """Set RTS."""
        self._line.set_rts(True)

    def off(self) -> None:
        """Clear RTS.

        Raises:
            LineLostError: the port is gone.
        """
        try:
            self._line.set_rts(False)
        except LineLostError as error:
            raise LineLostError(f"{self._line.name}: the LASER MAY STILL BE ON, switch it off at its supply") from error


@runtime_checkable
class LaserSwitch(Protocol):
    """A controller that switches a laser."""

    def set_laser(self, on: bool) -> None:
        """Switch it."""
        ...


class ControllerLaser:
    """A laser on the output of a GRBL or Marlin controller."""

    def __init__(self, controller: LaserSwitch):
        self._controller = controller

    @property
    def switchable(self) -> bool:
        """Yes."""
        return True

    def on(self) -> None:
        """Switch it on, confirmed."""
        self._controller.set_laser(True)

    def off(self) -> None:
        """Switch it off, confirmed.

        Raises:
            HardwareError: it was not.
        """
        try:
            self._controller.set_laser(False)
        except LineLostError as error:
            raise LineLostError(f"{error}; the LASER MAY STILL BE ON, switch it off at its supply") from error
