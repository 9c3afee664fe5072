"""Stages driven by a BiStep2A04.

Its language has no checksums, and one byte can do harm: `-1?` reads the count, `-1=` sets it; `2000g` goes to 2000,
`2000=` calls this place 2000. So

- nothing is written during a move but the question for the count, and a move is trusted when two answers on the way
  lay between its ends, in order: a count that was defined is there at once;
- a question that was not answered may have been something else. What it can have defined is its own number, 0 or
  ± 1 and what doubled digits make of it, less than `_OWN_NUMBER`: the next answer clears it where the motor cannot
  have come from there so soon;
- at rest two equal answers count, and after the reference was defined the stage is sent against the switch once more:
  a count that does not change there was defined there.

`x…gi` would report the arrival by itself, but a controller that waits may not hear the order to stop, so it is asked.
Stopping is a reset: the one order that is a single byte, and after which nothing goes on. It forgets the count.
"""

import re
from typing import NoReturn

from hardware.errors import NoAnswerError, PositionUncertainError
from hardware.stages.kinds import register_stage
from hardware.stages.serial_stage import SerialStage
from hardware.stages.travel_settings import SWITCH, Travel

_COUNT = re.compile(rb"X,-1,(-?\d{1,9})\s*\*")
_LATCHES = re.compile(rb"L,(\d{1,2})\s*\*")
_AT_LOWER_SWITCH = 4
_OWN_NUMBER = 100
_ASKED_TWICE = 6
_LEGS = 3
_ANSWER_S = 0.1
_BETWEEN_S = 0.1
_FAR = 50_000


class BiStep2A04(SerialStage):
    """Norberg's stepper controller with the firmware GenStepper; motor X, the reference switch on X−."""

    def __init__(self, port: str, travel: Travel | None = None, *, baud: int = 9600, homed: bool = False):
        super().__init__(port, travel, baud=baud, homed=homed)

    def _call_zero(self) -> None:
        self._set_pace()
        for count in (-_FAR, 0):
            self._define(count)

    def _leg(self, start: int, end: int) -> None:
        for _ in range(_LEGS):
            stands_at, honest = self._watched(start, end)
            if stands_at == end:
                return
            # It stands at the start, every question was answered, and no part of the order leads there: the order did
            # not get through.
            if not honest or stands_at != start or start in _parts(end):
                raise PositionUncertainError(
                    f"{self.name}: on the way to {end} the controller began to report {stands_at}, and an order or a "
                    "count was garbled: home it, and look after the cable"
                )
            self._set_pace(expected=start)
        raise NoAnswerError(
            f"{self.name}: the motor was sent to {end} steps {_LEGS} times and stays at {start}: check motor "
            "supply and cable"
        )

    def _watched(self, start: int, end: int) -> tuple[int, bool]:
        """Send it, watch it, and say where it stands and whether every question was answered."""
        move, clock = self.travel.move(end - start), self.line.clock
        sent_s = clock.now_s()
        watch = _Watch(start, end, self.travel, sent_s)
        self.line.send(b"%dg" % end)
        self._pause(0.3 * move.duration_s)
        while clock.now_s() - sent_s < 0.75 * move.duration_s and watch.seen_between < 2:
            self._note(watch)
            self._pause(min(_BETWEEN_S, 0.1 * move.duration_s))
        self._pause(sent_s + move.duration_s - clock.now_s() + _BETWEEN_S / 2)
        last, repeats = None, 0
        until_s = sent_s + self.travel.allowed_s(end - start)
        while repeats < 2:
            count = self._note(watch)
            repeats = repeats + 1 if count is not None and count == last else (1 if count is not None else 0)
            last = count
            if clock.now_s() > until_s:
                raise NoAnswerError(
                    f"{self.name}: {abs(end - start)} steps at {self.travel.rate_steps_s:g} steps/s take "
                    f"{move.duration_s:.1f} s, and after {clock.now_s() - sent_s:.1f} s it has not arrived at {end} "
                    f"(last said: {last}): home it, and check cable, rate and motor supply"
                )
            self._pause(_BETWEEN_S)
        assert last is not None
        if last != start and not watch.believable:
            self._doubt(watch)
        return last, watch.all_answered

    def _note(self, watch: "_Watch") -> int | None:
        """One question, and what the watch makes of the answer."""
        count = self._ask(watch)
        watch.note(count)
        if watch.doubt:
            self._doubt(watch)
        return count

    def _doubt(self, watch: "_Watch") -> NoReturn:
        raise PositionUncertainError(
            f"{self.name}: the controller's count is not to be trusted, {watch.doubt}: home it, and look after "
            "the cable if it happens again"
        )

    def _settled(self) -> int:
        last = None
        for _ in range(_ASKED_TWICE):
            count = self._ask(None)
            if count is not None and count == last:
                return count
            last = count
        raise NoAnswerError(
            f"{self.name}: asked {_ASKED_TWICE} times, the controller never gave the same position twice: check "
            "that it is on, cable and baud rate; `scanner console` shows what it says"
        )

    def _ask(self, watch: "_Watch | None") -> int | None:
        """One question for the count, None when no whole answer came."""
        self._check_stop()
        self.line.forget()
        asked_s = self.line.clock.now_s()
        self.line.send(b"-1?")
        match = self.line.expect(_COUNT, 18, _ANSWER_S, self._stopping.is_set)
        self._check_stop()
        if watch is not None:
            watch.asked(asked_s, self.line.clock.now_s())
        return int(match[1]) if match else None

    def _latches(self) -> int:
        """The latches since the last time; 0 when there was no answer."""
        for _ in range(_ASKED_TWICE):
            self.line.forget()
            self.line.send(b"L")
            if match := self.line.expect(_LATCHES, 8, _ANSWER_S, self._stopping.is_set):
                return int(match[1])
            self._check_stop()
        return 0

    def _set_pace(self, travel: Travel | None = None, expected: int | None = None) -> None:
        """Select motor X and set rate and ramp, those of the axis or others, at rest."""
        travel = travel or self.travel
        self.line.send(b"x%dr%dp" % (round(travel.rate_steps_s), round(travel.ramp_steps_s2)))
        self._pause(_BETWEEN_S)
        if expected is not None and self._settled() != expected:
            raise PositionUncertainError(f"{self.name}: setting the rate changed the position: home it")

    @property
    def verifiable(self) -> bool:
        """Where there is a switch: it stops the motor, and the count stays."""
        return self.travel.reference == SWITCH

    def _switch_met_at(self) -> int:
        self._set_pace(self._slow)
        return self._against_switch(self._slow)

    def _find_switch(self) -> None:
        travel = self.travel
        self._set_pace()
        self._against_switch(travel)
        # First a count far from any that the motor could come to, so that the change proves itself.
        for count in (travel.switch - _FAR, travel.switch):
            self._define(count)
        self.line.send(b"%dg" % (travel.switch - travel.approach))
        self._pause(travel.allowed_s(travel.approach))
        if self._settled() != travel.switch:
            raise PositionUncertainError(
                f"{self.name}: the stage was not on its switch when its count was set: check switch and cable"
            )

    def _define(self, count: int) -> None:
        """Call the present place so, and see that it is."""
        for _ in range(_ASKED_TWICE):
            self.line.send(b"%d=" % count)
            self._pause(_BETWEEN_S)
            if self._settled() == count:
                return
        raise PositionUncertainError(f"{self.name}: the reference could not be set: check the cable")

    def _against_switch(self, travel: Travel) -> int:
        """Drive down at some pace until the switch stops it; the count there."""
        clock = self.line.clock
        first = last = self._settled()
        distance = travel.span + travel.span // 10
        until_s = clock.now_s() + travel.allowed_s(distance)
        self.line.send(b"%dg" % (first - distance))
        still = 0
        while still < 2:
            self._pause(max(2 * _BETWEEN_S, (until_s - clock.now_s()) / 100))
            count = self._ask(None)
            if count is not None:
                still = still + 1 if count == last else 0
                last = count
            if clock.now_s() > until_s or last > first:
                raise NoAnswerError(
                    f"{self.name}: driving down for {distance} steps at {travel.rate_steps_s:g} steps/s the "
                    f"switch was not reached (last said: {last}): check the switch on X−, and the direction of the "
                    "motor"
                )
        if not self._latches() & _AT_LOWER_SWITCH:
            raise NoAnswerError(
                f"{self.name}: the motor stopped at {last}, but not at the switch on X−: check the switch, and "
                "that nothing is in the way"
            )
        return self._settled()

    def _halt(self) -> None:
        self.line.send(b"!!!")

    def _standing(self) -> bool:
        clock = self.line.clock
        until_s = clock.now_s() + 3.0
        last = None
        while clock.now_s() < until_s:
            self.line.forget()
            self.line.send(b"-1?")
            match = self.line.expect(_COUNT, 18, _ANSWER_S)
            count = int(match[1]) if match else None
            if count is not None and count == last:
                return True
            last = count
            clock.sleep(_BETWEEN_S)
        return False


register_stage("bistep", BiStep2A04, port=str, baud=int)


def _parts(count: int) -> set[int]:
    """Where the controller may be sent by an order of which only the end got through, as in `2=00g`."""
    digits = str(abs(count))
    parts = {int(digits[i:] or 0) for i in range(len(digits) + 1)}
    return parts | {-part for part in parts}


class _Watch:
    """The answers during one leg, and whether they can be those of a motor on its way from start to end."""

    def __init__(self, start: int, end: int, travel: Travel, sent_s: float):
        self._start, self._end, self._travel = start, end, travel
        self._sign = 1 if end > start else -1
        self._sent_s = sent_s
        self.seen_between = 0
        self.all_answered = True
        self.doubt = ""
        self._strange: int | None = None
        self._last: tuple[float, int] | None = None
        self._silent_since_s: float | None = None
        self._asked_s = self._answered_s = sent_s

    @property
    def believable(self) -> bool:
        """Whether the end may be trusted once it is reported."""
        if not self.doubt and self.seen_between < 2:
            self.doubt = "it was not seen twice on its way there"
        if not self.doubt and self._silent_since_s is not None:
            self.doubt = "the last question was not answered"
        return not self.doubt

    def asked(self, from_s: float, to_s: float) -> None:
        """When the question was sent and its answer was complete."""
        self._asked_s, self._answered_s = from_s, to_s

    def note(self, count: int | None) -> None:
        """Take an answer, or its absence."""
        if count is None:
            self.all_answered = False
            self._silent()
            return
        if not self._on_the_way(count):
            # One such answer may have been garbled itself; the count may have been, too.
            if self._strange is not None:
                self.doubt = f"it came by {self._strange} and {count} on the way from {self._start} to {self._end}"
            self._strange = count
            self._silent()
            return
        if self._silent_since_s is not None:
            if abs(count) <= _OWN_NUMBER + self._reach(self._silent_since_s):
                self.doubt = f"a question was not answered, and may have set it to what came to be {count}"
            self._silent_since_s = None
        if count not in (self._start, self._end) and (self._last is None or count != self._last[1]):
            self.seen_between += 1
        self._last = (self._asked_s, count)

    def _silent(self) -> None:
        if self._silent_since_s is None:
            self._silent_since_s = self._asked_s

    def _on_the_way(self, count: int) -> bool:
        """Whether it lies between where it was last seen and the end, no further than the motor can have gone."""
        since_s, before = self._last or (self._sent_s, self._start)
        ahead = (count - before) * self._sign
        return 0 <= ahead <= self._reach(since_s) and (self._end - count) * self._sign >= 0

    def _reach(self, since_s: float) -> float:
        """How far the motor can have gone, in steps."""
        return self._travel.reach(self._answered_s - since_s)
