"""Time as a driver sees it: of the wall, or of an emulated controller that runs faster, or as fast as it can."""

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Seconds that pass; deadlines are reckoned in them."""

    def now_s(self) -> float:
        """Seconds since some fixed moment."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return when `seconds` have passed."""
        ...

    def wait(self, changed: threading.Condition, until_s: float) -> None:
        """Return at this time, or earlier when the condition, which the caller holds, is notified."""
        ...


class WallClock:
    """The time of the wall, `speed` times as fast."""

    def __init__(self, speed: float = 1.0):
        self._speed = speed

    def now_s(self) -> float:
        """Monotonic seconds."""
        return time.monotonic() * self._speed

    def sleep(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(max(0.0, seconds) / self._speed)

    def wait(self, changed: threading.Condition, until_s: float) -> None:
        """Wait for the condition."""
        changed.wait(max(0.0, until_s - self.now_s()) / self._speed)


class VirtualClock:
    """Time that passes only while somebody waits for it, and then at once: the same course of events in every run."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        """Seconds waited so far."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Set the time forward by `seconds`."""
        self._now_s += max(0.0, seconds)

    def wait(self, changed: threading.Condition, until_s: float) -> None:
        """Let it be that time."""
        self._now_s = max(self._now_s, until_s)


class PacedClock(VirtualClock):
    """Time that passes only while somebody waits for it, and takes time: on a busy machine nothing is ever late.

    Args:
        speed: how many times as fast as the wall's.
    """

    def __init__(self, speed: float):
        super().__init__()
        self._speed = speed

    def sleep(self, seconds: float) -> None:
        """Sleep, and set the time forward by `seconds`."""
        time.sleep(max(0.0, seconds) / self._speed)
        super().sleep(seconds)

    def wait(self, changed: threading.Condition, until_s: float) -> None:
        """Wait for the condition; the time that this took has passed."""
        left_s = max(0.0, until_s - self.now_s())
        changed.wait(left_s / self._speed)
        super().wait(changed, until_s)


WALL = WallClock()
