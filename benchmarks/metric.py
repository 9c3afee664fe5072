"""A measured figure: its unit, which way is better, its goal, and how much worse than the baseline it may be."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    """One figure.

    Attributes:
        name: what was measured, as `suite.figure`.
        value: the figure.
        unit: its unit, or "" for a ratio or a count.
        better: whether lower or higher is better, or whether it is only shown.
        target: what it is to reach, or None.
        slack: by which part of the baseline it may be worse before the gate fails: tight for accuracy and for ratios
            taken in one run, loose for absolute times.
        floor: differences smaller than this, in the figure's own unit, are not a regression.
        target_suffices: what reaches its target is no regression either.
    """

    name: str
    value: float
    unit: str = ""
    better: Literal["lower", "higher", "shown"] = "shown"
    target: float | None = None
    slack: float = 0.05
    floor: float = 0.0
    target_suffices: bool = False

    def reaches_target(self) -> bool | None:
        """Whether the target is reached; None where there is none."""
        if self.target is None or self.better == "shown":
            return None
        return self.value <= self.target if self.better == "lower" else self.value >= self.target

    def worse_than(self, baseline: float) -> bool:
        """Whether the figure is worse than the baseline by more than its slack."""
        if self.better == "shown" or (self.target_suffices and self.reaches_target()):
            return False
        # A figure that is not a number is never good enough.
        if self.better == "lower":
            return not self.value - baseline <= max(self.slack * abs(baseline), self.floor)
        return not baseline - self.value <= max(self.slack / (1 + self.slack) * abs(baseline), self.floor)


def ratio(name: str, value: float, target: float, better: Literal["lower", "higher"] = "lower") -> Metric:
    """A ratio of two times taken in one run.

    On a shared machine one and the same code measured 0.43 and 0.74 on two days: the gate lets it double, and asks for
    no more than its target.
    """
    return Metric(name, value, "", better, target, slack=1.0, target_suffices=True)
