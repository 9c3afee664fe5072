"""An emulated controller as a port of pyserial, by URL, and as a terminal.

    emulator://bistep?speed=20&echo=1&drop=0.001&garble=0.001&pull_s=3&seed=7

`speed` is how many times faster than real time runs, 0 (the default) for as fast as it can; `echo` is the BiStep2A04's,
`steps_per_mm` GRBL's (250 by default) and Marlin's (80);
`length`, `start`, `play` and `stall_rate` are those of `Axis`, `y_length` and so on those of a second axis, Y, of GRBL
and Marlin; everything else is in `Faults`.
"""

import math
import os
import threading
from collections.abc import Mapping
from dataclasses import fields
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import serial

from hardware.clock import Clock, VirtualClock, WallClock
from hardware.emulator.axis import Axis
from hardware.emulator.bistep import BiStep
from hardware.emulator.grbl import Grbl
from hardware.emulator.marlin import Marlin
from hardware.emulator.wire import Faults, Wire

_CONTROLLERS = {"bistep": BiStep, "grbl": Grbl, "marlin": Marlin}
_AXIS = ("length", "start", "play", "stall_rate")


def emulated(url: str) -> tuple[Any, Faults, Clock]:
    """Controller, faults and clock of a URL.

    Raises:
        ValueError: an unknown controller or key, or a value that is no number.
    """
    parts = urlsplit(url)
    if parts.netloc not in _CONTROLLERS:
        raise ValueError(f'"{url}": no such controller: after emulator:// write one of {", ".join(_CONTROLLERS)}')
    values = {key: float(value) for key, value in parse_qsl(parts.query)}
    for key, value in values.items():
        if not 0 <= value < math.inf:
            raise ValueError(f'"{url}": {key} = {value:g}: give 0 or more')
    speed = values.pop("speed", 0.0)
    axis = Axis(**{key: values.pop(key) for key in _AXIS if key in values})
    second = Axis(**{key: values.pop(f"y_{key}") for key in _AXIS if f"y_{key}" in values and parts.netloc != "bistep"})
    special: dict[str, Any] = {}
    if "echo" in values and parts.netloc == "bistep":
        special = {"echo": bool(values.pop("echo"))}
    if "steps_per_mm" in values and parts.netloc != "bistep":
        special = {"steps_per_mm": values.pop("steps_per_mm")}
        if not special["steps_per_mm"]:
            raise ValueError(f'"{url}": steps_per_mm = 0: give more than 0')
    known = [field.name for field in fields(Faults)]
    if unknown := set(values) - set(known):
        raise ValueError(f'"{url}": unknown: {", ".join(sorted(unknown))}; there are {", ".join((*_AXIS, *known))}')
    faults: Any = {key: type(getattr(Faults, key))(value) for key, value in values.items()}
    motors = axis if parts.netloc == "bistep" else {"X": axis, "Y": second}
    return (
        _CONTROLLERS[parts.netloc](motors, **special),
        Faults(**faults),
        WallClock(speed) if speed else VirtualClock(),
    )


class EmulatedPort(serial.SerialBase):
    """A port whose other end is an emulated controller; `clock` is the time in which it lives.

    A laser on the port's RTS line shines while that is set.
    """

    clock: Clock
    controller: Any

    def open(self) -> None:
        """Connect."""
        self.controller, faults, self.clock = emulated(self.portstr or "")
        self._wire = Wire(self.controller, faults, self.baudrate, self.clock.now_s())
        self._changed = threading.Condition()
        self._came = bytearray()
        self.is_open = True

    def close(self) -> None:
        """Disconnect; the controller goes on by itself."""
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        with self._changed:
            self._pump()
            return len(self._came)

    def read(self, size: int = 1) -> bytes:
        """At most `size` bytes: those that came within the port's timeout."""
        with self._changed:
            until_s = self.clock.now_s() + (math.inf if self.timeout is None else self.timeout)
            while True:
                self._pump()
                if len(self._came) >= size or self.clock.now_s() >= until_s:
                    data = bytes(self._came[:size])
                    del self._came[:size]
                    return data
                self.clock.wait(self._changed, min(until_s, self._wire.next_s()))

    def write(self, b: Any, /) -> int:
        """Send; returns when the bytes are in the port's buffer."""
        with self._changed:
            self._pump()
            self._wire.send(bytes(b), self.clock.now_s())
            self._changed.notify_all()
        return len(b)

    def reset_input_buffer(self) -> None:
        """Forget what came."""
        with self._changed:
            self._pump()
            self._came.clear()

    def reset_output_buffer(self) -> None:
        """Nothing is kept here."""

    def flush(self) -> None:
        """Everything is on the wire already."""

    @property
    def axis(self) -> Axis:
        """The motor, or of several X, with all that has happened to it until now."""
        with self._changed:
            self._came += self._wire.pump(self.clock.now_s())
            return self.controller.axis

    @property
    def axes(self) -> Mapping[str, Axis]:
        """All motors of GRBL and Marlin by their letters, likewise."""
        with self._changed:
            self._came += self._wire.pump(self.clock.now_s())
            return self.controller.axes

    @property
    def laser(self) -> bool:
        """Whether a laser shines: one on the RTS line, or one that the controller switches."""
        with self._changed:
            self._came += self._wire.pump(self.clock.now_s())
        return bool(getattr(self.controller, "laser", self.rts))

    @property
    def pulled(self) -> bool:
        """Whether the cable is out."""
        return self._wire.pulled(self.clock.now_s())

    def _pump(self) -> None:
        now_s = self.clock.now_s()
        self._came += self._wire.pump(now_s)
        if not self.is_open:
            raise serial.PortNotOpenError
        if self._wire.pulled(now_s) and not self._wire.faults.silent:
            raise serial.SerialException("device disconnected")

    def _reconfigure_port(self) -> None:
        """Nothing to do: every baud rate is understood."""

    def _update_rts_state(self) -> None:
        if hasattr(self, "_changed"):
            with self._changed:
                self._pump()

    def _update_dtr_state(self) -> None:
        """Wired to nothing."""

    def _update_break_state(self) -> None:
        """Wired to nothing."""


class EmulatedTerminal:
    """An emulated controller behind a pseudo-terminal: `path` opens like a serial port, in any program."""

    def __init__(self, url: str):
        import tty

        self.controller, faults, self.clock = emulated(url)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._wire = Wire(self.controller, faults, 9600, self.clock.now_s())
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> "EmulatedTerminal":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _serve(self) -> None:
        from select import select

        while not self._ended.is_set():
            if select([self._master], [], [], 0.001)[0]:
                self._wire.send(os.read(self._master, 1024), self.clock.now_s())
            if data := self._wire.pump(self.clock.now_s()):
                os.write(self._master, data)
