"""Marlin 2, as much of it as moves an axis: numbered lines with checksums, G1, G28, M106, M107, M110, M114.

M410 stops it at once, whatever it does: its EMERGENCY_PARSER is on.
"""

import math
import re
from collections.abc import Mapping

from hardware.emulator.axis import Axis
from hardware.emulator.lines import LineController, words

_NUMBERED = re.compile(r"N(-?\d+)\s*(.*?)\*(\d+)$")

_STOP = b"M410\n"


class Marlin(LineController):
    """The controller; axes count from their switches, which are below."""

    def __init__(self, axes: Mapping[str, Axis], steps_per_mm: float = 80.0):
        super().__init__(axes, steps_per_mm, b"\n")
        self._last, self._lately = 0, b""
        self._feed = 1500.0
        self._sent_mm = dict.fromkeys(axes, 0.0)
        self._trusted: set[str] = set()
        self._limits = True

    def _at_once(self, byte: int, now_s: float) -> bytes | None:
        self._lately = (self._lately + bytes([byte]))[-len(_STOP) :]
        if self._lately == _STOP:
            self._halt(now_s)
            self._homing = None
            self._sent_mm = {letter: self._mm(letter, now_s) for letter in self.axes}
        return None

    def _obey(self, line: str, now_s: float) -> bytes:
        if not line.strip():
            return b""
        numbered = _NUMBERED.match(line.strip())
        if numbered is None and ("*" in line or line.lstrip().startswith("N")):
            return self._resend("No Checksum with line number")
        text = line.strip()
        if numbered is not None:
            text = numbered[2].strip()
            if checksum(line.strip().rsplit("*", 1)[0]) != int(numbered[3]):
                return self._resend("checksum mismatch")
            number = int(numbered[1])
            if number != self._last + 1 and not text.startswith("M110"):
                return self._resend("Line Number is not Last Line Number+1")
            self._last = number
        return self._do(text, now_s)

    def _resend(self, reason: str) -> bytes:
        lines = f"Error:{reason}, Last Line: {self._last}", f"Resend: {self._last + 1}", "ok"
        return b"".join(map(self._say, lines))

    def _do(self, text: str, now_s: float) -> bytes:
        found = words(text, bare=True) or {}
        code = next((letter + f"{found[letter][0]:g}" for letter in "GM" if letter in found), "")
        if code == "G28":
            self._home(next((letter for letter in self.axes if letter in found), "X"), now_s)
            return b""
        if code in ("G0", "G1"):
            self._feed = found.get("F", [self._feed])[0]
            for letter in set(self.axes) & set(found):
                # Its limits hold for an axis that has been homed.
                top = self.axes[letter].length / self.steps_per_mm if letter in self._trusted else math.inf
                bottom = 0.0 if letter in self._trusted and self._limits else -math.inf
                self._sent_mm[letter] = min(max(found[letter][0], bottom), top)
                self._go(letter, self._sent_mm[letter], self._feed, now_s)
        elif code == "M114":
            sent = " ".join(f"{letter}:{self._sent_mm.get(letter, 0.0):.2f}" for letter in "XYZE")
            counts = {letter: axis.counter(now_s) for letter, axis in self.axes.items()}
            place = " ".join(f"{letter}:{counts.get(letter, 0)}" for letter in "XYZ")
            return self._say(f"{sent} Count {place}") + self._say("ok")
        elif code == "M119":
            places = {letter: axis.at_switch(now_s) for letter, axis in self.axes.items()}
            lines = (f"{letter.lower()}_min: {'TRIGGERED' if at < 0 else 'open'}" for letter, at in places.items())
            return b"".join(map(self._say, ("Reporting endstop status", *lines, "ok")))
        elif code == "M211":
            self._limits = found.get("S", [1])[0] != 0
        elif code in ("M106", "M107"):
            self.laser = code == "M106"
        elif code not in ("M110", "M120", "M121", "M410", "G90", "G21"):
            return self._say(f'echo:Unknown command: "{text}"') + self._say("ok")
        return self._say("ok")

    def _homed(self, letter: str) -> None:
        self._sent_mm[letter] = 0.0
        self._trusted.add(letter)


def checksum(text: str) -> int:
    """The exclusive or of all its bytes."""
    value = 0
    for byte in text.encode("latin-1", "replace"):
        value ^= byte
    return value
