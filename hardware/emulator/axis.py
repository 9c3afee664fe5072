"""A stepper motor on a screw between two switches: what its controller counts, and where its load really is."""

import math

from hardware.travel import Trapezoid


class Axis:
    """One motor; all lengths in motor steps, all times in seconds of the caller's clock.

    The *counter* is what the controller assumes; the *motor* is where the shaft really is, from 0 at the lower switch
    to `length` at the upper one; the *load* follows it with play. Lower than its rate of stalling the motor loses no
    step; above it, it loses every other one and nobody notices.
    """

    def __init__(
        self,
        length: float = 20000,
        start: float = 3000,
        rate: float = 400,
        ramp: float = math.inf,
        play: float = 0,
        stall_rate: float = math.inf,
    ):
        self.length, self.play, self.stall_rate = length, play, stall_rate
        self.rate, self.ramp = rate, ramp
        self._counter, self._motor, self._load = 0.0, float(start), float(start)
        self._began_s, self._sign, self._slip, self._reach = 0.0, 1, 1.0, 0.0
        self._target: float | None = None
        self._move = Trapezoid(0, rate, ramp)

    def go(self, target: float, now_s: float) -> None:
        """Start from rest towards a count; a move under way ends where it is."""
        self.halt(now_s)
        self._began_s, self._target = now_s, target
        self._sign = 1 if target >= self._counter else -1
        self._move = Trapezoid(abs(target - self._counter), max(self.rate, 1e-3), max(self.ramp, 1e-3))
        self._slip = 0.5 if self._move.peak > self.stall_rate else 1.0
        room = self.length - self._motor if self._sign > 0 else self._motor
        self._reach = min(self._move.distance, room / self._slip)

    def halt(self, now_s: float) -> None:
        """Stand still at once, on a whole step."""
        count, motor, _ = self._state(now_s)
        whole = self.counter(now_s)
        motor = round(motor + self._slip * (whole - count))
        self._counter, self._motor, self._load = whole, motor, min(max(self._load, motor), motor + self.play)
        self._move = Trapezoid(0, self.rate, self.ramp)
        self._target, self._reach = None, 0.0

    def push(self, steps: float, now_s: float) -> None:
        """Move shaft and load by hand, at rest: nothing that counts notices."""
        self.halt(now_s)
        self._motor += steps
        self._load += steps

    def define(self, count: float, now_s: float) -> None:
        """Call the present place so; a move under way goes on to the count that it was sent to."""
        target = self._target if self.moving(now_s) else None
        self.halt(now_s)
        self._counter = float(count)
        if target is not None:
            self.go(target, now_s)

    def counter(self, now_s: float) -> int:
        """What the controller counts."""
        count = self._state(now_s)[0]
        return math.floor(count + 1e-6) if self._sign > 0 else math.ceil(count - 1e-6)

    def motor(self, now_s: float) -> float:
        """Where the shaft is, from the lower switch."""
        return self._state(now_s)[1]

    def load(self, now_s: float) -> float:
        """Where the load is: with the motor when it arrived from below, up to `play` above it otherwise."""
        return self._state(now_s)[2]

    def moving(self, now_s: float) -> bool:
        """Whether it has not come to rest yet."""
        return now_s < self.rests_at_s()

    def rests_at_s(self) -> float:
        """When the move under way ends, at its target or at a switch."""
        return self._began_s + self._move.when(self._reach) if self._reach > 0 else self._began_s

    @property
    def meets_switch(self) -> bool:
        """Whether the move under way, or the last, was sent beyond a switch."""
        return self._target is not None and self._reach < self._move.distance

    def at_switch(self, now_s: float) -> int:
        """−1 at the lower switch, 1 at the upper one, 0 between them."""
        motor = self.motor(now_s)
        return -1 if motor <= 0 else (1 if motor >= self.length else 0)

    def _state(self, now_s: float) -> tuple[float, float, float]:
        gone = self._sign * min(self._move.gone(now_s - self._began_s), self._reach)
        motor = self._motor + self._slip * gone
        return self._counter + gone, motor, min(max(self._load, motor), motor + self.play)
