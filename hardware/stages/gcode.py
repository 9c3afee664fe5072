"""What GRBL and Marlin have in common: orders by line, a count of their own that no ordinary byte can define.

Only homing sets that count, so a reference counts when it was found twice, with a move away in between: a homing that a
garbled byte turned into something harmless leaves another count behind.
"""

from abc import abstractmethod
from dataclasses import dataclass

from hardware.errors import NoAnswerError, PositionUncertainError, SettingsError
from hardware.stages.serial_stage import SerialStage
from hardware.stages.travel_settings import SWITCH, Travel

_ASKED = 6
_BETWEEN_S = 0.1
_PROMPT_S = 0.05
_LEGS = 3
_HOMED_TWICE = 4
# Counts are reported in millimetres with three decimals.
_MOST_STEPS_PER_MM = 500.0

STILL, MOVING, LOST = "still", "moving", "lost"
# In the order in which GRBL reports them.
LETTERS = ("X", "Y", "Z", "A", "B", "C")


@dataclass(frozen=True)
class Report:
    """What a controller says of itself.

    Attributes:
        state: `STILL`, `MOVING`, or `LOST`: it stands, but its count may be wrong.
        count: its own, in its own steps.
        at_switch: whether it says that the axis is on a switch; False where it does not speak of that.
    """

    state: str
    count: int
    at_switch: bool = False


class GcodeStage(SerialStage):
    """An axis of a controller that takes G-code.

    A step is 1/`steps_per_mm` of the controller's millimetre, or of its degree; with `reverse` the steps count against
    the controller's way. `travel.switch` is the count where its homing ends.

    Args:
        port, travel, baud, beside: as in `SerialStage`.
        steps_per_mm: the controller's own number for this axis.
        reverse: whether steps count against the controller's way.
        axis: its letter, in capitals; None for X on a controller whose homing is that of X alone.
    """

    def __init__(
        self,
        port: str,
        travel: Travel | None = None,
        *,
        steps_per_mm: float,
        reverse: bool = False,
        axis: str | None = None,
        baud: int = 115200,
        beside: "SerialStage | None" = None,
    ):
        if axis not in (None, *LETTERS):
            raise SettingsError(
                f'axis = "{axis}": give the letter by which the controller knows it: {", ".join(LETTERS)}'
            )
        if not 0 < steps_per_mm <= _MOST_STEPS_PER_MM:
            raise SettingsError(
                f"steps_per_mm = {steps_per_mm}: give the controller's own number (GRBL $100, Marlin M92), at most "
                f"{_MOST_STEPS_PER_MM:g}"
            )
        if beside is not None and (type(beside) is not type(self) or axis in (None, beside.letter)):
            raise SettingsError(
                f'{port}: is the port of another axis: give each its letter (axis = "Y"), and the same kind'
            )
        super().__init__(port, travel, baud=baud, beside=beside)
        self._axis = axis
        self._per_mm = -steps_per_mm if reverse else steps_per_mm
        # The controller's count, in its own steps, at `travel.switch`.
        self._own_at_switch = 0

    @property
    def letter(self) -> str:
        """The letter by which the controller knows the axis."""
        return self._axis or "X"

    @property
    def name(self) -> str:
        """The port, and the axis where there are several."""
        return self.line.name if self._axis is None else f"{self.line.name} axis {self._axis}"

    def set_laser(self, on: bool) -> None:
        """Switch the laser that is connected to the controller, and see that it was understood.

        Raises:
            NoAnswerError: the controller did not confirm it.
        """
        with self._busy:
            for _ in range(_ASKED):
                if self._switched(on):
                    return
        raise NoAnswerError(f"{self.name}: the controller did not confirm that the laser is {'on' if on else 'off'}")

    def _call_zero(self) -> None:
        self._wake()
        self._own_at_switch = self._own_settled() + self._way * self.travel.switch

    def _find_switch(self) -> None:
        found = None
        for _ in range(_HOMED_TWICE):
            self._home_once()
            own = self._own_settled()
            if own == found:
                self._own_at_switch = own
                return
            away = own + self._way * self.travel.approach
            found = own if self._sent(own, away) == away else None
        raise NoAnswerError(
            f"{self.name}: homing ended at a different place each time: check the switch, and that homing is on "
            "(GRBL $22=1)"
        )

    def _leg(self, start: int, end: int) -> None:
        for _ in range(_LEGS):
            stands_at = self._sent(self._own(start), self._own(end))
            if stands_at == self._own(end):
                return
            if stands_at != self._own(start):
                raise PositionUncertainError(
                    f"{self.name}: sent to {end} steps it stands {stands_at - self._own(end):+d} beside: an "
                    "order was garbled, or a switch was met: home it"
                )
        raise NoAnswerError(
            f"{self.name}: the motor was sent to {end} steps {_LEGS} times and stays at {start}: check motor "
            "supply, the controller's own limits and alarms (`scanner console`)"
        )

    def _sent(self, start: int, end: int) -> int:
        """Send it, see that it goes no faster than told, and say where it stands; all by the controller's counts."""
        clock, move = self.line.clock, self.travel.move(end - start)
        sent_s = before_s = clock.now_s()
        until_s = sent_s + self.travel.allowed_s(end - start)
        self._send_to(end)
        self._pause(0.3 * move.duration_s)
        seen_between, before, still_at = 0, start, None
        while clock.now_s() <= until_s:
            asked_s = clock.now_s()
            report = self._report()
            if report is not None:
                if abs(report.count - before) > self.travel.reach(clock.now_s() - before_s):
                    raise PositionUncertainError(
                        f"{self.name}: the motor runs faster than {self.travel.rate_steps_s:g} steps/s and may "
                        "have lost steps: home it, and look after the cable"
                    )
                # An answer that took its time may be of any moment of it.
                prompt = clock.now_s() - asked_s < _PROMPT_S
                seen_between += prompt and min(start, end) < report.count < max(start, end)
                if report.state == STILL and report.count == still_at:
                    if still_at != start and seen_between < 2:
                        raise PositionUncertainError(f"{self.name}: it was not seen on its way: home it")
                    return report.count
                before_s, before = asked_s, report.count
            still_at = report.count if report is not None and report.state == STILL else None
            left_s = sent_s + move.duration_s - clock.now_s()
            self._pause(left_s if seen_between >= 2 and left_s > 0 else _BETWEEN_S)
        raise NoAnswerError(
            f"{self.name}: {abs(end - start)} steps at {self.travel.rate_steps_s:g} steps/s take "
            f"{move.duration_s:.1f} s, and after {clock.now_s() - sent_s:.1f} s it does not stand still: check "
            "cable, rate, acceleration (GRBL $120, Marlin M201) and steps_per_mm (GRBL $100, Marlin M92), and that no "
            "alarm is left"
        )

    @property
    def verifiable(self) -> bool:
        """Where there is a switch."""
        return self.travel.reference == SWITCH

    def _against_switch(self) -> float:
        """Send it slowly down, further than the switch can be; when the way to the last place would be over, s."""
        distance = self.travel.span + self.travel.span // 10
        self._send_to(self._own_settled() - self._way * distance, self._slow.rate_steps_s)
        return self.line.clock.now_s() + self._slow.allowed_s(distance)

    def _not_met(self) -> NoAnswerError:
        return NoAnswerError(
            f"{self.name}: driving slowly down, the switch was not met: check the switch, and the motor's direction"
        )

    def _steps(self, own: int) -> int:
        """A step count from the controller's own."""
        return round((own - self._own_at_switch) * self._way) + self.travel.switch

    def _settled(self) -> int:
        return self._steps(self._own_settled())

    def _own_settled(self) -> int:
        last = None
        for _ in range(_ASKED):
            report = self._report()
            count = report.count if report is not None and report.state == STILL else None
            if count is not None and count == last:
                return count
            last = count
            self._pause(_BETWEEN_S)
        raise NoAnswerError(
            f"{self.name}: asked {_ASKED} times, the controller never gave the same position twice: check that "
            "it is on, cable and baud rate, and that no alarm is left; `scanner console` shows what it says"
        )

    def _standing(self) -> bool:
        clock = self.line.clock
        until_s = clock.now_s() + 3.0
        last = None
        while clock.now_s() < until_s:
            report = self._report()
            if report is not None and report.state != MOVING and report.count == last:
                return True
            last = report.count if report is not None else None
            clock.sleep(_BETWEEN_S)
        return False

    def _own(self, step_count: int) -> int:
        """A step count as the controller counts it."""
        return self._own_at_switch + self._way * (step_count - self.travel.switch)

    @property
    def _way(self) -> int:
        return 1 if self._per_mm > 0 else -1

    def _mm(self, own: int) -> float:
        return own / abs(self._per_mm)

    def _feed_mm_min(self, rate_steps_s: float | None) -> float:
        return 60 * (rate_steps_s or self.travel.rate_steps_s) / abs(self._per_mm)

    @abstractmethod
    def _wake(self) -> None:
        """Make the controller ready for orders without a homing."""

    @abstractmethod
    def _home_once(self) -> None:
        """The controller's own homing, to its end."""

    @abstractmethod
    def _send_to(self, own: int, rate_steps_s: float | None = None) -> None:
        """Order a move to one of the controller's own counts, at the axis's rate or another."""

    @abstractmethod
    def _report(self) -> "Report | None":
        """What the controller says of itself, None when it did not."""

    @abstractmethod
    def _switched(self, on: bool) -> bool:
        """Switch the laser once; whether that was confirmed."""
