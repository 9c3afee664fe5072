"""How many requests an account or an address may make, in a second and at a time.

Pages and programs stay far below; a loop that has gone wild, or an attacker, has to wait.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from hardware.lab.refusal import TOO_MANY, Refusal

# Accounts and addresses that are remembered; of more those that have rested longest are forgotten.
_MOST_KNOWN: Final = 4096


@dataclass(frozen=True)
class Limit:
    """What one may ask for.

    Attributes:
        each_second: requests, in the long run.
        at_once: that may come together after a rest.
        open: that are being answered at a time.
    """

    each_second: float
    at_once: float
    open: int


# Somebody who has signed in; an address from which nobody has yet, which needs the sign-in page and nothing else.
ACCOUNT: Final = Limit(200.0, 1000.0, 64)
STRANGER: Final = Limit(50.0, 200.0, 32)


@dataclass
class _Held:
    left: float
    seen_s: float
    open: int = 0


class Limits:
    """Counts requests, from any thread."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic):
        self._now_s = now_s
        # Held for a few assignments.
        self._mutex = threading.Lock()
        self._held: dict[str, _Held] = {}

    @contextmanager
    def request(self, whose: str, limit: Limit, stays: bool = False) -> Iterator[None]:
        """Count a request for as long as it takes; of one that stays, as a stream does, that it came.

        Raises:
            Refusal: there are too many; says when to ask again.
        """
        held = self._counted(whose, limit, stays)
        try:
            yield
        finally:
            if not stays:
                with self._mutex:
                    held.open -= 1

    def _counted(self, whose: str, limit: Limit, stays: bool) -> _Held:
        with self._mutex:
            now_s = self._now_s()
            held = self._held.pop(whose, None) or _Held(limit.at_once, now_s)
            # The one that was used last is at the end.
            self._held[whose] = held
            while len(self._held) > _MOST_KNOWN:
                self._held.pop(next(iter(self._held)))
            held.left = min(limit.at_once, held.left + (now_s - held.seen_s) * limit.each_second)
            held.seen_s = now_s
            if held.left < 1:
                wait_s = max(1.0, (1 - held.left) / limit.each_second)
                raise Refusal(TOO_MANY, f"more than {limit.each_second:g} requests a second: wait", wait_s)
            if held.open >= limit.open:
                raise Refusal(TOO_MANY, f"{held.open} requests of yours wait for their answers already", 1.0)
            held.left -= 1
            held.open += not stays
            return held
