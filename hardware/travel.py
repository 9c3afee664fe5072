"""How long a move takes, and where it is on the way: a ramp up, a stretch at the full rate, a ramp down."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Trapezoid:
    """A move from rest to rest.

    Attributes:
        distance: how far, steps, not negative.
        rate: the greatest speed, steps/s.
        ramp: acceleration and deceleration, steps/s²; infinite for none.
    """

    distance: float
    rate: float
    ramp: float = math.inf

    @property
    def peak(self) -> float:
        """The speed that is reached: √(distance · ramp) where the way is too short for the full rate."""
        return min(self.rate, math.sqrt(self.distance * self.ramp)) if math.isfinite(self.ramp) else self.rate

    @property
    def duration_s(self) -> float:
        """How long it takes: distance / peak + peak / ramp."""
        return self.distance / self.peak + self.peak / self.ramp if self.distance > 0 else 0.0

    def gone(self, elapsed_s: float) -> float:
        """How far it has moved after `elapsed_s` seconds, steps."""
        left = self.duration_s - elapsed_s
        if elapsed_s <= 0 or self.distance <= 0:
            return 0.0
        if left <= 0:
            return self.distance
        ramp_s = self.peak / self.ramp
        if elapsed_s < ramp_s:
            return self.ramp * elapsed_s**2 / 2
        if left < ramp_s:
            return self.distance - self.ramp * left**2 / 2
        return self.peak * (elapsed_s - ramp_s / 2)

    def when(self, gone: float) -> float:
        """The inverse of `gone`, s."""
        if gone >= self.distance:
            return self.duration_s
        ramp_s = self.peak / self.ramp
        ramped = self.peak * ramp_s / 2
        if gone < ramped:
            return math.sqrt(2 * gone / self.ramp)
        if self.distance - gone < ramped:
            return self.duration_s - math.sqrt(2 * (self.distance - gone) / self.ramp)
        return gone / self.peak + ramp_s / 2
