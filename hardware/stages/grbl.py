"""Stages driven by GRBL 1.1 or FluidNC.

`MPos` is the machine's own position: no offset changes it. Moves are jogs (`$J=`), which leave no mode behind. Stopping
is a soft reset: a single byte that ends a homing too, and switches the laser off.
"""

import re
from functools import cached_property

from hardware.errors import NoAnswerError, SettingsError
from hardware.stages.gcode import LETTERS, LOST, MOVING, STILL, GcodeStage, Report
from hardware.stages.kinds import register_stage

_STATUS = re.compile(rb"<(\w+)(?::\d)?\|MPos:([^<>|]+)([^<>]*)>")
_PLACE = re.compile(rb"-?\d+\.\d+")
_PINS = re.compile(rb"\|Pn:(\w+)")
_OK = re.compile(rb"(ok|error:\d+|ALARM:\d+)\r?\n")
# Nothing but the answer itself: `$X` instead of `$H` would say more.
_BARE_OK = re.compile(rb"^\s*ok\r?\n")
_MODES = re.compile(rb"\[GC:[^\[\]]*\b(M[345])\b[^\[\]]* S(\d+)(?:\.\d+)?\]")
_RESET = b"\x18"
# Soft limits, hard limits, homing, and by how many millimetres homing pulls off its switch.
_SETTING = re.compile(rb"\$(20|21|22|27)=(\d+(?:\.\d+)?)\r?\n")
_SETTINGS = re.compile(rb"\$22=.*\$27=.*\nok\r?\n", re.DOTALL)
_ASKED = 6
_SILENT = 3
_LOOK_S = 0.1


class Grbl(GcodeStage):
    """An axis of a controller with GRBL; homing ($22) has to be on where there is a switch.

    Where its letter is given the axis is homed by itself (`$HX`), as FluidNC and grblHAL can, and GRBL that was built
    with HOMING_SINGLE_AXIS_COMMANDS; otherwise by `$H`.
    """

    def _wake(self) -> None:
        # After a reset in mid-move it refuses all orders.
        self.line.send(b"\r\n")
        self._pause(0.1)
        self.line.forget()
        self.line.send(b"$X\r\n")
        if self.line.expect(_OK, 4, given_up=self._stopping.is_set) is None:
            self._check_stop()
            raise NoAnswerError(f"{self.name}: $X was not answered: check that it is on, cable and baud rate")

    def _home_once(self) -> None:
        # What a garbled byte left in the controller's line ends here.
        self.line.send(b"\r\n")
        self._pause(0.1)
        self.line.forget()
        order = b"$H" + (self._axis or "").encode()
        self.line.send(order + b"\r\n")
        answer = self.line.expect(_OK, 4, 2 * self.travel.allowed_s(self.travel.span), self._stopping.is_set)
        self._check_stop()
        if answer is None or answer[1] != b"ok" or not _BARE_OK.match(answer.string[: answer.end()]):
            said = b"nothing" if answer is None else answer.string[: answer.end()].strip()
            raise NoAnswerError(
                f"{self.name}: {order.decode()} was answered by {said.decode('latin-1')!r}: check the switch, that "
                "homing is on ($22=1), that the firmware homes single axes where a letter is given, and "
                "that no alarm is left"
            )

    @property
    def verifiable(self) -> bool:
        """Where its hard limits stop it at its switch ($21=1), and no soft limit before ($20=0)."""
        said = self._settings
        return super().verifiable and (said.get(20), said.get(21), said.get(22)) == (0, 1, 1) and 27 in said

    @cached_property
    def _settings(self) -> dict[int, float]:
        """Those of the controller that matter here, as two answers agree on them; none where no two do."""
        last: dict[int, float] = {}
        with self._busy:
            for _ in range(_ASKED):
                self.line.forget()
                self.line.send(b"$$\r\n")
                answer = self.line.expect(_SETTINGS, 4, given_up=self._stopping.is_set)
                self._check_stop()
                said = {} if answer is None else dict(_SETTING.findall(answer.string))
                found = {int(number): float(value) for number, value in said.items()}
                if found and found == last:
                    return found
                last = found
        return {}

    def _switch_met_at(self) -> int:
        # A hard limit ends the jog at once, in an alarm in which only a reset is heard. Its count stays.
        until_s, silent = self._against_switch(), 0
        while silent < _SILENT:
            report = self._report()
            silent = 0 if report is not None and report.state == MOVING else silent + 1
            if self.line.clock.now_s() > until_s:
                raise self._not_met()
            self._pause(_LOOK_S)
        self._halt()
        last = None
        for _ in range(_ASKED):
            self._pause(_LOOK_S)
            report = self._report()
            if report is not None and report.at_switch and report == last:
                # Homing ends where it has pulled off.
                return self._steps(report.count) + round(self._settings[27] * abs(self._per_mm))
            last = report
        raise self._not_met()

    def _send_to(self, own: int, rate_steps_s: float | None = None) -> None:
        self.line.forget()
        feed = self._feed_mm_min(rate_steps_s)
        order = b"$J=G90G21%s%.3fF%.1f\r\n" % (self.letter.encode(), self._mm(own), feed)
        self.line.send(order)
        self.line.expect(_OK, len(order), given_up=self._stopping.is_set)
        self._check_stop()

    def _report(self) -> Report | None:
        self.line.forget()
        self.line.send(b"?")
        status = self.line.expect(_STATUS, 1, given_up=self._stopping.is_set)
        self._check_stop()
        if status is None:
            return None
        # In an alarm the motor stands, but may have lost steps.
        state = {b"Idle": STILL, b"Alarm": LOST}.get(status[1], MOVING)
        places, index = status[2].split(b","), LETTERS.index(self.letter)
        if index >= len(places) and all(map(_PLACE.fullmatch, places)):
            raise SettingsError(
                f"{self.name}: the controller reports {len(places)} axes and no {self.letter}: check axis"
            )
        # A number beside which a comma was lost, or that was garbled itself.
        if index >= len(places) or not _PLACE.fullmatch(places[index]):
            return None
        pins = _PINS.search(status[3])
        at_switch = pins is not None and self.letter.encode() in pins[1]
        return Report(state, round(float(places[index]) * abs(self._per_mm)), at_switch)

    def _switched(self, on: bool) -> bool:
        self.line.forget()
        self.line.send(b"M3 S1000\r\n" if on else b"M5\r\n")
        self.line.expect(_OK, 10)
        self.line.forget()
        self.line.send(b"$G\r\n")
        modes = self.line.expect(_MODES, 4)
        if modes is None:
            self.line.send(b"\r\n")
            return False
        return (modes[1] == b"M3" and int(modes[2]) == 1000) if on else modes[1] == b"M5"

    def _halt(self) -> None:
        self.line.send(3 * _RESET)


register_stage("grbl", Grbl, port=str, baud=int, steps_per_mm=float, reverse=bool, axis=str)
