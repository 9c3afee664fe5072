"""A serial line as drivers use it: nothing on it waits without a deadline, and a cable that is out says so."""

import os
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import serial

from hardware.clock import WALL, Clock
from hardware.errors import LineLostError, SettingsError

# Where pyserial finds the class of `emulator://`.
_HANDLERS = "hardware.emulator"
# A read gives up after this long and looks whether anybody has called `stop`.
_POLL_S = 0.02
_WRITE_S = 1.0
# Windows gives a port to one program alone by itself.
_EXCLUSIVE: Final = True if os.name == "posix" else None
_LONGEST_COMMAND: Final = 200
# What a controller and the driver of a USB adapter may take to answer.
_ANSWER_S = 0.25
# What has not come so long after it was due does not come, and how long a line may go on talking.
_LATE_S, _DRAIN_S = 0.6, 3.0


class Line:
    """A port of pyserial, or a URL of it.

    Attributes:
        name: the port, as the user gave it.
        port: pyserial's object.
        clock: the time in which deadlines are reckoned; an emulated port brings its own.
    """

    def __init__(self, name: str, baud: int):
        if _HANDLERS not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(_HANDLERS)
        self.name = name
        self._byte_s = 10 / baud
        self._writing = threading.Lock()
        try:
            # The system locks it before any of its lines is set: RTS may be another program's laser.
            self.port: Any = serial.serial_for_url(
                name, do_not_open=True, baudrate=baud, timeout=_POLL_S, write_timeout=_WRITE_S, exclusive=_EXCLUSIVE
            )
            self.port.rts = False
            self.port.open()
        except (OSError, ValueError, ImportError) as error:
            if holder := _holder(name):
                raise SettingsError(
                    f"{name}: is in use by {holder}: wait until that has ended, or end it; what a scanner does at a "
                    "time, one program asks of it"
                ) from error
            raise SettingsError(
                f"{name}: cannot be opened ({error}): `scanner devices` lists the ports that are there; another "
                "program may hold this one, or you may not be in its group (dialout)"
            ) from error
        self.clock: Clock = getattr(self.port, "clock", WALL)

    def close(self) -> None:
        """Disconnect."""
        self.port.close()

    def send(self, data: bytes) -> None:
        """Write; safe from any thread.

        Raises:
            LineLostError: the port is gone, or takes nothing.
        """
        with self._writing, self._carried():
            self.port.write(data)

    def set_rts(self, on: bool) -> None:
        """Set the modem line RTS.

        Raises:
            LineLostError: the port is gone.
        """
        with self._carried():
            self.port.rts = on

    def forget(self) -> None:
        """Drop what came unread.

        Raises:
            LineLostError: the port is gone.
        """
        with self._carried():
            self.port.reset_input_buffer()

    def expect(
        self, pattern: "re.Pattern[bytes]", sent: int, within_s: float = _ANSWER_S, given_up: Callable[[], bool] = bool
    ) -> "re.Match[bytes] | None":
        """Read until a pattern is found in what comes.

        Args:
            pattern: of the answer, its end included.
            sent: bytes on their way to the controller, which has to have them all first.
            within_s: how long the controller may take, beyond the bytes' own time on the line.
            given_up: asked between reads; whether to return without the answer.

        Returns:
            The match, or None when there was none in time.

        Raises:
            LineLostError: the port is gone.
        """
        came = bytearray()
        until_s = self.clock.now_s() + within_s + sent * self._byte_s
        while not given_up():
            with self._carried():
                more = self.port.read(max(1, self.port.in_waiting))
            came += more
            if match := pattern.search(came):
                return match
            # Bytes that come prove that it is answering, and take their time.
            until_s += len(more) * self._byte_s
            if self.clock.now_s() >= until_s:
                break
        return None

    def listen(self, seconds: float) -> bytes:
        """All that comes in some time.

        Raises:
            LineLostError: the port is gone.
        """
        came, until_s = bytearray(), self.clock.now_s() + seconds
        while self.clock.now_s() < until_s:
            with self._carried():
                came += self.port.read(max(1, self.port.in_waiting))
        return bytes(came)

    def drain(self) -> None:
        """Wait until nothing has come for a while, so that no late answer is taken for that to the next question.

        Raises:
            LineLostError: the port is gone.
        """
        until_s = self.clock.now_s() + _DRAIN_S
        quiet_s = self.clock.now_s() + _LATE_S
        while self.clock.now_s() < min(quiet_s, until_s):
            with self._carried():
                if self.port.read(max(1, self.port.in_waiting)):
                    quiet_s = self.clock.now_s() + _LATE_S

    def _carried(self) -> "_Carried":
        return _Carried(self.name)


def _holder(port: str) -> str:
    """Which other process has the port open, in words; "" where none is seen.

    Processes of other users are not looked into, nor on systems without /proc.
    """
    place = os.path.realpath(port)
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            if any(os.path.realpath(opened) == place for opened in (process / "fd").iterdir()):
                command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                return f"process {process.name} ({command[:_LONGEST_COMMAND]})"
        except OSError:
            continue
    return ""


class _Carried:
    """Turns whatever pyserial and the system say of a port that is gone into a `LineLostError`."""

    def __init__(self, name: str):
        self._name = name

    def __enter__(self) -> None:
        return

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # serial.SerialException is an OSError; a port closed under a reader gives TypeError or AttributeError.
        if isinstance(error, OSError | TypeError | AttributeError):
            raise LineLostError(
                f"{self._name}: the line is gone ({error}): plug the cable in again; until the controller has been "
                "reached, take it that the motor is still turning"
            ) from error
