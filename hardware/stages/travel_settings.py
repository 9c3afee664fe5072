"""What a driver has to know of the stage that it drives."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hardware.errors import SettingsError
from hardware.travel import Trapezoid

# Where the count of an axis may come from.
SWITCH, HERE = "switch", "here"
# The last leg of a move takes at least this long, so that it can be watched.
_LEAST_LEG_S = 1.0
# A move may take this multiple of the time that its distance and rate give, plus this.
_SLOWER, _SLACK_S = 1.25, 1.0
# A motor may run this many times as fast as specified, and be this number of steps further by jitter of the line.
_FASTER, _JITTER_STEPS = 1.1, 10


@dataclass(frozen=True)
class Travel:
    """A stage's way and pace, in motor steps.

    Attributes:
        rate_steps_s: speed of all moves.
        ramp_steps_s2: acceleration and deceleration.
        first, last: the step counts between which it may be sent.
        switch: the step count of the reference switch, below `first` by more than an approach.
        backlash: play of the screw; a move ends with at least this much from below.
        steps_per_turn: of an axis that turns; None for one that does not.
        reference: where the count comes from: "switch", or "here" for an axis without one, which is at step 0 where it
            stands when it is homed.
    """

    rate_steps_s: float = 800.0
    ramp_steps_s2: float = 2000.0
    first: int = 0
    last: int = 250_000
    switch: int = -1000
    backlash: int = 200
    steps_per_turn: int | None = None
    reference: str = SWITCH

    def __post_init__(self) -> None:
        """Refuse what no stage can be.

        Raises:
            SettingsError: which value, and why.
        """
        if not 1 <= self.rate_steps_s < math.inf or not 1 <= self.ramp_steps_s2 < math.inf:
            raise SettingsError(
                f"rate_steps_s = {self.rate_steps_s}, ramp_steps_s2 = {self.ramp_steps_s2}: give 1 or more for each"
            )
        if self.steps_per_turn is not None and self.steps_per_turn < 1:
            raise SettingsError(f"steps_per_turn = {self.steps_per_turn}: give the motor steps of a full turn")
        if self.backlash < 0 or self.first >= self.last:
            raise SettingsError(
                f"first = {self.first}, last = {self.last}, backlash = {self.backlash}: a stage has some way to go, "
                "and no negative play"
            )
        if self.reference not in (SWITCH, HERE):
            raise SettingsError(f'reference = "{self.reference}": must be one of {SWITCH}, {HERE}')
        if self.reference == HERE and not self.first <= 0 <= self.last:
            raise SettingsError(
                f'first = {self.first}, last = {self.last}: with reference = "{HERE}" it is homed at 0, which has to '
                "lie between them"
            )
        if self.reference == SWITCH and self.switch > self.first - self.approach:
            raise SettingsError(
                f"switch = {self.switch}: moves end from below, so the switch has to be at least {self.approach} steps "
                f"below the first place, {self.first}: give {self.first - self.approach} or less"
            )

    @property
    def approach(self) -> int:
        """Steps of the shortest leg that ends a move: all of the play, and long enough to be watched."""
        watched = Trapezoid(1e9, self.rate_steps_s, self.ramp_steps_s2).gone(_LEAST_LEG_S)
        return max(self.backlash, math.ceil(watched), 4)

    @property
    def span(self) -> int:
        """Steps from the switch to the last place."""
        return self.last - self.switch

    def check(self, steps: Sequence[int], name: str = "axis") -> None:
        """See that the axis may be sent to all of these; errors call it by its name.

        Raises:
            SettingsError: it may not.
        """
        low, high = min(steps), max(steps)
        if low < self.first or high > self.last:
            asked = f"step {low}" if low == high else f"steps {low} to {high}"
            raise SettingsError(f"{asked}: the {name} goes from {self.first} to {self.last}: stay between them")

    def legs(self, start: int, target: int) -> list[int]:
        """Where to go one after the other: the last leg comes from below, and none is too short to be watched."""
        if target - start >= self.approach:
            return [target]
        if target == start:
            return []
        return [min(target, start) - self.approach, target]

    def move(self, distance: int) -> Trapezoid:
        """A move over `distance` steps."""
        return Trapezoid(abs(distance), self.rate_steps_s, self.ramp_steps_s2)

    def allowed_s(self, distance: int) -> float:
        """How long a move may take before something is wrong."""
        return _SLOWER * self.move(distance).duration_s + _SLACK_S

    def reach(self, seconds: float) -> float:
        """How far the motor can have gone in some time, steps."""
        return _FASTER * self.rate_steps_s * seconds + _JITTER_STEPS
