"""Stages driven by Marlin 2. Every line is numbered and carries a checksum; what was garbled is asked for again."""

import re
from functools import cached_property
from typing import cast

from hardware.errors import NoAnswerError
from hardware.stages.gcode import MOVING, STILL, GcodeStage, Report
from hardware.stages.kinds import register_stage

_ANSWER = re.compile(rb"(?:^|\n)ok\b[^\n]*\n")
# The first number is where an axis was sent, the second where it is, in steps; what stands beside them has to be whole.
_PLACE = rb"%b:(-?\d+\.\d+) [A-Z]:[^\n]* Count %b%b: ?(-?\d+)%b[^\n]*\n(?:[^\n]*\n)*?ok\b[^\n]*\n"
_SENT_AGAIN = 5
_LOOK_S = 0.1
# A count that is the same so often in a row is that of a motor that stands.
_STILL = 4


class Marlin(GcodeStage):
    """An axis of a controller with Marlin.

    `laser_on` and `laser_off` are the orders that switch a laser on it, by default those of the first fan's output.
    """

    laser_on, laser_off = b"M106 S255", b"M107"

    _number, _regular = 0, False

    @property
    def _lines(self) -> "Marlin":
        """Who counts the controller's lines: the axis that was opened first, for all."""
        return cast("Marlin", self._axes[0])

    @cached_property
    def _place(self) -> "re.Pattern[bytes]":
        letter = self.letter.encode()
        # X is the first, and another follows; any other may be the last.
        around = (b"", rb"(?= [A-Z]:)") if letter == b"X" else (rb"[^\n]* ", rb"(?= [A-Z]:|\r?\n)")
        return re.compile(_PLACE % (letter, around[0], letter, around[1]))

    def _wake(self) -> None:
        self._restart()

    def _home_once(self) -> None:
        self._restart()
        if not self._obeyed(b"G28 %b" % self.letter.encode(), 2 * self.travel.allowed_s(self.travel.span)):
            raise NoAnswerError(f"{self.name}: G28 {self.letter} was not answered: check switch, cable and baud rate")

    def _switch_met_at(self) -> int:
        met = self._steps(self._met())
        # Where homing ends is no constant of the firmware: beside its switch by as much as is found right after it.
        self._home_once()
        home = self._own_settled()
        away = home + self._way * self.travel.approach
        self._send_to(away, self._slow.rate_steps_s)
        self._pause(self._slow.allowed_s(self.travel.approach))
        if self._own_settled() != away:
            raise self._not_met()
        return met - self._way * (self._met() - home)

    def _met(self) -> int:
        """Drive slowly against the switch, which stops it for once: the controller's own count there."""
        if not self._obeyed(b"M211 S0") or not self._obeyed(b"M120"):
            raise NoAnswerError(f"{self.name}: M211 and M120 were not answered: check cable and baud rate")
        until_s, last, still = self._against_switch(), None, 0
        while still < _STILL:
            self._pause(_LOOK_S)
            report = self._report()
            if report is not None:
                still = still + 1 if report.count == last else 0
                last = report.count
            if self.line.clock.now_s() > until_s:
                raise self._not_met()
        switch = re.compile(rb"%b_(?:min|max): ?TRIGGERED[^\n]*\n" % self.letter.lower().encode())
        if last is None or self._ask(b"M119", switch) is None:
            raise self._not_met()
        # Homing looks to its switch by itself; for all else this is as before.
        if not self._obeyed(b"M121") or not self._obeyed(b"M211 S1"):
            raise NoAnswerError(f"{self.name}: M121 and M211 were not answered: check cable and baud rate")
        return last

    def _send_to(self, own: int, rate_steps_s: float | None = None) -> None:
        feed = self._feed_mm_min(rate_steps_s)
        self._obeyed(b"G1 %b%.4f F%.1f" % (self.letter.encode(), self._mm(own), feed))

    def _report(self) -> Report | None:
        place = self._ask(b"M114", self._place)
        if place is None:
            return None
        count = int(place[2])
        return Report(STILL if abs(self._mm(count) - float(place[1])) < 0.01 else MOVING, count)

    def _switched(self, on: bool) -> bool:
        if not self._lines._regular:
            self.line.drain()
        self._lines._regular = True
        if not self._obeyed(self.laser_on if on else self.laser_off):
            return False
        # An `ok` may be a late one. The next line is refused unless this one, with its number, had come.
        return self._ask(b"M114", self._place) is not None and self._lines._regular

    def _halt(self) -> None:
        # Without a number, and several times: any thread may send it, and the counting of lines is the other one's.
        self.line.send(b"\nM410\nM410\n")

    def _obeyed(self, order: bytes, within_s: float = 0.25) -> bool:
        return self._ask(order, _ANSWER, within_s) is not None

    def _ask(self, order: bytes, pattern: "re.Pattern[bytes]", within_s: float = 0.25) -> "re.Match[bytes] | None":
        """Send one numbered line until it is answered; None when it never was."""
        either = re.compile(pattern.pattern + rb"|Resend: ?(?P<again>\d+)\s")
        for _ in range(_SENT_AGAIN):
            self.line.forget()
            line = b"N%d %s" % (self._lines._number + 1, order)
            line += b"*%d\n" % _checksum(line)
            self.line.send(line)
            answer = self.line.expect(either, len(line), within_s, self._stopping.is_set)
            self._check_stop()
            if answer is None:
                # It may have been obeyed and the answer lost: then its number is refused, and a new one taken.
                self._lines._regular = False
                self.line.send(b"\n")
                continue
            if answer["again"] is None:
                self._lines._number += 1
                return answer
            self._lines._regular = False
            self._lines._number = int(answer["again"]) - 1
        return None

    def _restart(self) -> None:
        """Count lines from 0 again."""
        self.line.send(b"\n")
        self._lines._number = -1
        if not self._obeyed(b"M110"):
            raise NoAnswerError(f"{self.name}: no answer: check that the controller is on, cable and baud rate")
        self._lines._number = 0


register_stage("marlin", Marlin, port=str, baud=int, steps_per_mm=float, reverse=bool, axis=str)


def _checksum(line: bytes) -> int:
    value = 0
    for byte in line:
        value ^= byte
    return value
