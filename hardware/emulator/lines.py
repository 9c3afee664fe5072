"""What the two emulated controllers that speak G-code have in common: lines, words, and axes in millimetres."""

import math
import re
from collections.abc import Mapping

from hardware.emulator.axis import Axis

_WORD = re.compile(r"([A-Z])([-+]?\d*\.?\d*)")


class LineController:
    """A controller that takes its orders line by line and answers each when it is done with it.

    `laser` is what M3 and M106 switch on, M5 and M107 off. `axes` are by their letters; X is there always. Only one
    is homed at a time, and a line moves one at a time.
    """

    def __init__(self, axes: Mapping[str, Axis], steps_per_mm: float, end: bytes, pull_off_mm: float = 0.0):
        self.axes, self.steps_per_mm, self._end = axes, steps_per_mm, end
        self.laser = False
        self._pull_off = round(pull_off_mm * steps_per_mm)
        self._line = bytearray()
        self._held = bytearray()
        # The axis that is being homed, and whether it is still on its way to the switch.
        self._homing: str | None = None
        self._seeking = False
        for axis in axes.values():
            axis.ramp = 5000.0

    @property
    def axis(self) -> Axis:
        """The axis X."""
        return self.axes["X"]

    def receive(self, byte: int, now_s: float) -> bytes:
        """Take one byte; a line ends with either line end."""
        at_once = self._at_once(byte, now_s)
        if at_once is not None:
            return at_once
        if self._homing is not None:
            self._held.append(byte)
            return b""
        if byte not in b"\r\n":
            self._line.append(byte)
            return b""
        line = self._line.decode("latin-1")
        self._line.clear()
        return b"" if byte == 10 and not line else self._obey(line, now_s)

    def wakes_at_s(self) -> float:
        """When the homing ends, or has found the switch."""
        return self.axes[self._homing].rests_at_s() if self._homing is not None else math.inf

    def wake(self, now_s: float) -> bytes:
        """The end of the homing, and the answers to what came meanwhile."""
        assert self._homing is not None
        letter, axis = self._homing, self.axes[self._homing]
        if self._seeking:
            self._seeking = False
            axis.halt(now_s)
            axis.define(0, now_s)
            axis.go(self._pull_off, now_s)
            return b""
        self._homing = None
        self._homed(letter)
        held, self._held = bytes(self._held), bytearray()
        return self._say("ok") + b"".join(self.receive(byte, now_s) for byte in held)

    def _at_once(self, byte: int, now_s: float) -> bytes | None:
        """The answer to a byte that is obeyed outside of any line, None for all others."""
        return None

    def _obey(self, line: str, now_s: float) -> bytes:
        raise NotImplementedError

    def _homed(self, letter: str) -> None:
        """What else is so when the homing of an axis has ended."""

    def _home(self, letter: str, now_s: float) -> None:
        axis = self.axes[letter]
        axis.rate = 1000.0
        axis.go(axis.counter(now_s) - 10 * axis.length, now_s)
        self._homing, self._seeking = letter, True

    def _go(self, letter: str, mm: float, feed_mm_min: float, now_s: float) -> None:
        axis = self.axes[letter]
        axis.rate = min(max(feed_mm_min / 60 * self.steps_per_mm, 1.0), 5000.0)
        axis.go(round(mm * self.steps_per_mm), now_s)

    def _halt(self, now_s: float) -> None:
        for axis in self.axes.values():
            axis.halt(now_s)

    def _mm(self, letter: str, now_s: float) -> float:
        """Where an axis is; 0 for one that is not there."""
        return self.axes[letter].counter(now_s) / self.steps_per_mm if letter in self.axes else 0.0

    def _say(self, text: str) -> bytes:
        return text.encode() + self._end


def words(line: str, bare: bool = False) -> dict[str, list[float]] | None:
    """The letters of a line of G-code with their numbers; None where it is none. A `bare` letter has the number 0."""
    plain = line.replace(" ", "").upper()
    found: dict[str, list[float]] = {}
    at = 0
    for match in _WORD.finditer(plain):
        number = match[2] or ("0" if bare else "")
        if match.start() != at or not re.search(r"\d", number):
            return None
        found.setdefault(match[1], []).append(float(number))
        at = match.end()
    return found if at == len(plain) else None
