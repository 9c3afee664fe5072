"""The operator's lock: one holder at a time, for as long as it is heard of.

Held by a *seat*, a session in a browser or a token: somebody who is signed in twice operates from one of the two. The
lease is renewed by its holder every few seconds and by whatever it orders; a scan that is running keeps it, so that it
may go on without a browser. A restart of the server frees it.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from hardware.lab.badges import Visitor
from hardware.lab.refusal import CONFLICT, FORBIDDEN, Refusal


@dataclass(frozen=True)
class Holder:
    """Who operates."""

    name: str
    seat: str


class OperatorLock:
    """The lock.

    Attributes:
        lease_s: how long a holder that is not heard of keeps it.

    Args:
        lease_s: the same.
        kept: whether something is under way that keeps it without its holder.
        lost: called, with no lock held, after somebody lost it in another way than by letting go: with True when
            another person has taken it over.
    """

    def __init__(
        self,
        lease_s: float,
        kept: Callable[[], bool] = lambda: False,
        lost: Callable[[bool], object] = lambda taken: None,
        now_s: Callable[[], float] = time.monotonic,
    ):
        self.lease_s = lease_s
        self._kept, self._lost, self._now_s = kept, lost, now_s
        self._mutex = threading.Lock()
        self._holder: Holder | None = None
        self._until_s = 0.0

    @property
    def holder(self) -> Holder | None:
        """Who holds it."""
        return self._holder

    def held_by(self, visitor: Visitor) -> bool:
        """Whether somebody operates."""
        holder = self._holder
        return holder is not None and holder.seat == visitor.seat

    def take(self, visitor: Visitor) -> None:
        """Take it, or go on holding it.

        Raises:
            Refusal: somebody else holds it.
        """
        self.expire()
        with self._mutex:
            holder = self._holder
            if holder and holder.seat != visitor.seat:
                where = " in another browser or program" if holder.name == visitor.name else ""
                raise Refusal(CONFLICT, f"{holder.name} operates{where}: wait until the scanner is free")
            self._give(visitor)

    def take_over(self, visitor: Visitor) -> None:
        """Take it from somebody: administrators may, and everybody from another seat of their own.

        Raises:
            Refusal: neither of the two.
        """
        self.expire()
        with self._mutex:
            holder = self._holder
            other = holder is not None and holder.name != visitor.name
            if other and not visitor.administrator:
                raise Refusal(FORBIDDEN, "only an administrator may take the scanner over")
            moved = holder is not None and holder.seat != visitor.seat
            self._give(visitor)
        if moved:
            self._lost(other)

    def release(self, visitor: Visitor) -> None:
        """Let go; nothing happens where somebody else holds it.

        Raises:
            Refusal: a scan is running.
        """
        with self._mutex:
            if self._holder is None or self._holder.seat != visitor.seat:
                return
            if self._kept():
                raise Refusal(CONFLICT, "a scan is running: pause or abort it before you leave the scanner")
            self._holder = None
        self._lost(False)

    def require(self, visitor: Visitor) -> None:
        """Renew the lease of whoever gives an order, or says that it is there.

        Raises:
            Refusal: it does not hold it.
        """
        with self._mutex:
            holder = self._holder
            if holder is None or holder.seat != visitor.seat:
                whose = f"{holder.name} operates" if holder else "nobody operates"
                raise Refusal(FORBIDDEN, f"{whose}: take the scanner before you give it orders")
            self._give(visitor)

    def expire(self) -> None:
        """End a lease that has run out: the one place where that is done, to be called a few times within a lease."""
        with self._mutex:
            if self._holder is None:
                return
            if self._kept():
                self._until_s = self._now_s() + self.lease_s
            if self._now_s() <= self._until_s:
                return
            self._holder = None
        self._lost(False)

    def _give(self, visitor: Visitor) -> None:
        self._holder = Holder(visitor.name, visitor.seat)
        self._until_s = self._now_s() + self.lease_s
