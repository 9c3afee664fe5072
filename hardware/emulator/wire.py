"""A serial line in both directions, byte by byte: how long each takes, and what becomes of it on the way."""

import math
import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Faults:
    """What may happen to a byte, each with its probability, in either direction.

    Attributes:
        drop: it is lost.
        double: it arrives twice.
        garble: another one arrives in its place.
        delay: it, and all after it, come late by up to `delay_s`.
        delay_s: how late at most, s.
        pull_s: when the cable is pulled, seconds after opening; never by default.
        silent: a pulled cable is not noticed by the port: as RS-232, where a USB adapter would say so.
        strike_at, strike_with: which byte on its way to the controller, counted from 0, becomes which other one.
        seed: of all of this.
    """

    drop: float = 0.0
    double: float = 0.0
    garble: float = 0.0
    delay: float = 0.0
    delay_s: float = 0.5
    pull_s: float = math.inf
    silent: bool = False
    strike_at: int = -1
    strike_with: int = 0
    seed: int = 0


class Controller(Protocol):
    """What stands at the far end of the line."""

    def receive(self, byte: int, now_s: float) -> bytes:
        """Take one byte, and answer."""
        ...

    def wakes_at_s(self) -> float:
        """When it will say something of its own accord; infinite for never."""
        ...

    def wake(self, now_s: float) -> bytes:
        """What it says then."""
        ...


class Direction:
    """One direction of the line."""

    def __init__(self, faults: Faults, random_: random.Random, byte_s: float):
        self._faults, self._random, self._byte_s = faults, random_, byte_s
        self._free_s = 0.0
        self.under_way: deque[tuple[float, int]] = deque()

    def carry(self, data: bytes, now_s: float) -> None:
        """Put bytes on the line."""
        for byte in data:
            self._free_s = max(self._free_s, now_s) + self._byte_s
            faults = self._faults
            odds = faults.drop, faults.double, faults.garble, faults.delay
            (fault,) = self._random.choices(("drop", "double", "garble", "delay", ""), (*odds, 1 - sum(odds)))
            if fault == "garble":
                byte = (byte + self._random.randrange(1, 256)) % 256
            elif fault == "delay":
                self._free_s += self._random.uniform(0, faults.delay_s)
            for _ in range({"drop": 0, "double": 2}.get(fault, 1)):
                self.under_way.append((self._free_s, byte))

    def arrived(self, now_s: float) -> Iterator[tuple[float, int]]:
        """The bytes that are there by now, with the time of each."""
        while self.under_way and self.under_way[0][0] <= now_s:
            yield self.under_way.popleft()

    def next_s(self) -> float:
        """When the next byte arrives."""
        return self.under_way[0][0] if self.under_way else math.inf


class Wire:
    """A controller and the line to it; its owner calls `pump` with the time."""

    def __init__(self, controller: Controller, faults: Faults, baud: int, now_s: float):
        random_ = random.Random(faults.seed)
        byte_s = 10 / baud
        self.controller = controller
        self.faults = faults
        self._opened_s = now_s
        self._sent = 0
        self._there, self._back = (Direction(faults, random_, byte_s) for _ in range(2))

    def pulled(self, now_s: float) -> bool:
        """Whether the cable is out."""
        return now_s >= self._opened_s + self.faults.pull_s

    def send(self, data: bytes, now_s: float) -> None:
        """Send to the controller."""
        struck = self.faults.strike_at - self._sent
        self._sent += len(data)
        if 0 <= struck < len(data):
            data = data[:struck] + bytes([self.faults.strike_with]) + data[struck + 1 :]
        if not self.pulled(now_s):
            self._there.carry(data, now_s)

    def pump(self, now_s: float) -> bytes:
        """Let the controller live until now; what has come back from it since the last time."""
        while (then_s := min(self._there.next_s(), self.controller.wakes_at_s())) <= now_s:
            if self._there.next_s() <= then_s:
                arrival_s, byte = next(self._there.arrived(then_s))
                answer = self.controller.receive(byte, arrival_s)
            else:
                answer = self.controller.wake(then_s)
            if not self.pulled(then_s):
                self._back.carry(answer, then_s)
        until_s = min(now_s, self._opened_s + self.faults.pull_s)
        return bytes(byte for _, byte in self._back.arrived(until_s))

    def next_s(self) -> float:
        """When something happens next of which nobody but the wire knows."""
        back_s = self._back.next_s()
        return min(self._there.next_s(), math.inf if self.pulled(back_s) else back_s, self.controller.wakes_at_s())
