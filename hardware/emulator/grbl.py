"""GRBL 1.1, as much of it as moves an axis: `$H`, `$HY`, `$J=`, `$X`, `$G`, M3, M5.

`?`, `!`, jog cancel and reset are obeyed at once.
"""

import math
from collections.abc import Mapping

from hardware.emulator.axis import Axis
from hardware.emulator.lines import LineController, words

_PULL_OFF_MM = 1.0
_STATUS, _HOLD, _RESET, _JOG_CANCEL = ord("?"), ord("!"), 0x18, 0x85


class Grbl(LineController):
    """The controller; axes count from their switches, which are below. `$H` homes X, and `$HY` Y, as in FluidNC."""

    def __init__(self, axes: Mapping[str, Axis], steps_per_mm: float = 250.0):
        super().__init__(axes, steps_per_mm, b"\r\n", _PULL_OFF_MM)
        self._alarm = True
        # After a switch was met in mid-move nothing but a reset is heard.
        self._deaf = False
        self._power = 0.0
        # Soft limits, hard limits, homing, pull-off.
        self.settings = {20: "0", 21: "1", 22: "1", 27: f"{_PULL_OFF_MM:.3f}"}

    def wakes_at_s(self) -> float:
        """When the homing goes on, or a switch is met."""
        meets_s = [axis.rests_at_s() for axis in self.axes.values() if axis.meets_switch]
        return min(super().wakes_at_s(), *meets_s, math.inf) if self.settings[21] == "1" else super().wakes_at_s()

    def wake(self, now_s: float) -> bytes:
        """The homing goes on, or a hard limit ends all moves."""
        if self._homing is not None:
            return super().wake(now_s)
        self._halt(now_s)
        self._alarm = self._deaf = True
        return self._say("ALARM:1") + self._say("[MSG:Reset to continue]")

    def _at_once(self, byte: int, now_s: float) -> bytes | None:
        moving = any(axis.moving(now_s) for axis in self.axes.values())
        if self._deaf and byte != _RESET:
            return b""
        if byte == _STATUS:
            return b"" if self._homing is not None else self._status(now_s)
        if byte in (_HOLD, _JOG_CANCEL):
            if self._homing is None:
                self._halt(now_s)
            return b""
        if byte == _RESET:
            self._alarm |= moving
            self._deaf = False
            self._halt(now_s)
            self._homing, self.laser = None, False
            self._line.clear()
            self._held.clear()
            return self._say("") + self._say("Grbl 1.1h ['$' for help]")
        return None if byte < 128 else b""

    def _status(self, now_s: float) -> bytes:
        moving = any(axis.moving(now_s) for axis in self.axes.values())
        at_switch = "".join(letter for letter, axis in self.axes.items() if axis.at_switch(now_s))
        if at_switch and not self._alarm:
            self._alarm = True
        state = "Alarm" if self._alarm else ("Jog" if moving else "Idle")
        pins = f"|Pn:{at_switch}" if at_switch else ""
        places = ",".join(f"{self._mm(letter, now_s):.3f}" for letter in "XYZ")
        return self._say(f"<{state}|MPos:{places}|FS:0,0{pins}>")

    def _obey(self, line: str, now_s: float) -> bytes:
        plain = line.split(";")[0].strip()
        if not plain or plain.startswith("("):
            return self._say("ok")
        if plain == "$H" or (plain[:2] == "$H" and plain[2:] in self.axes):
            self._home(plain[2:] or "X", now_s)
            return b""
        if plain == "$X":
            self._alarm = False
            return self._say("[MSG:Caution: Unlocked]") + self._say("ok")
        if plain == "$G":
            code = "M3" if self.laser else "M5"
            return self._say(f"[GC:G0 G54 G17 G21 G90 G94 {code} M9 T0 F0 S{self._power:.0f}]") + self._say("ok")
        if plain == "$$":
            return b"".join(self._say(f"${key}={value}") for key, value in self.settings.items()) + self._say("ok")
        if plain.startswith("$J="):
            return self._say(self._jog(plain[3:], now_s))
        if plain.startswith("$"):
            return self._say("error:3")
        return self._say(self._code(plain))

    def _jog(self, text: str, now_s: float) -> str:
        found = words(text)
        if found is None or not set(found) <= {"G", "F", *self.axes} or not set(found.get("G", [])) <= {90, 91, 21}:
            return "error:20"
        if self._alarm:
            return "error:9"
        letters = [letter for letter in self.axes if letter in found]
        if len(letters) != 1 or "F" not in found:
            return "error:22"
        start = self._mm(letters[0], now_s) if 91 in found["G"] else 0.0
        self._go(letters[0], start + found[letters[0]][0], found["F"][0], now_s)
        return "ok"

    def _code(self, text: str) -> str:
        found = words(text)
        if found is None or not set(found) <= {"M", "S"}:
            return "error:20"
        if self._alarm:
            return "error:9"
        self._power = found.get("S", [self._power])[0]
        for code in found.get("M", []):
            if code not in (3, 5):
                return "error:20"
            self.laser = code == 3 and self._power > 0
        return "ok"

    def _homed(self, letter: str) -> None:
        self._alarm = False
