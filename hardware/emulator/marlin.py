"""Marlin 2, as much of it as moves one axis: numbered lines with checksums, G1, G28, M106, M107, M110, M114.

M410 stops it at once, whatever it does: its EMERGENCY_PARSER is on.
"""

import re

from hardware.emulator.axis import Axis
from hardware.emulator.lines import LineController, words

_NUMBERED = re.compile(r"N(-?\d+)\s*(.*?)\*(\d+)$")

_STOP = b"M410\n"


class Marlin(LineController):
    """The controller; X counts from the switch, which is below."""

    def __init__(self, axis: Axis, steps_per_mm: float = 80.0):
        super().__init__(axis, steps_per_mm, b"\n")
        self._last, self._lately = 0, b""
        self._feed = 1500.0
        self._sent_mm = 0.0

    def _at_once(self, byte: int, now_s: float) -> bytes | None:
        self._lately = (self._lately + bytes([byte]))[-len(_STOP) :]
        if self._lately == _STOP:
            self.axis.halt(now_s)
            self._homing = False
            self._sent_mm = self._x_mm(now_s)
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
            self._home(now_s)
            return b""
        if code in ("G0", "G1"):
            self._feed = found.get("F", [self._feed])[0]
            if "X" in found:
                top = self.axis.length / self.steps_per_mm
                self._sent_mm = min(max(found["X"][0], 0.0), top)
                self._go(self._sent_mm, self._feed, now_s)
        elif code == "M114":
            count = self.axis.counter(now_s)
            place = f"X:{self._sent_mm:.2f} Y:0.00 Z:0.00 E:0.00 Count X:{count} Y:0 Z:0"
            return self._say(place) + self._say("ok")
        elif code in ("M106", "M107"):
            self.laser = code == "M106"
        elif code not in ("M110", "M410", "G90", "G21"):
            return self._say(f'echo:Unknown command: "{text}"') + self._say("ok")
        return self._say("ok")

    def _homed(self) -> None:
        self._sent_mm = 0.0


def checksum(text: str) -> int:
    """The exclusive or of all its bytes."""
    value = 0
    for byte in text.encode("latin-1", "replace"):
        value ^= byte
    return value
