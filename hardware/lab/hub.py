"""What all watchers see: made once, shared by all, and for each of them always the latest.

A watcher that is slow, or one of very many, misses some; it never makes anybody wait. What watching costs the server is
bounded by `_EACH_SECOND` messages of a kind to all watchers together.
"""

import asyncio
import random
import threading
from collections.abc import AsyncIterator
from typing import Final

from hardware.lab.refusal import FULL, Refusal

# Streams at a time, two for a page.
MOST_STREAMS: Final = 600
_KEPT: Final = 40
# Messages of one kind to all watchers together, each second, and the most that one of them gets.
_EACH_SECOND: Final = 500.0
_FASTEST_S: Final = 0.1


class Hub:
    """The latest message of each kind. `publish` may be called from any thread once `open` has been."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._latest: dict[str, tuple[int, bytes]] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._changed = asyncio.Event()
        self._closed = False
        self.streams = 0

    def open(self) -> None:
        """Begin, in the event loop that serves."""
        self._loop = asyncio.get_running_loop()

    def close(self) -> None:
        """End all streams; from any thread."""
        self._closed = True
        self._wake()

    def publish(self, kind: str, data: bytes) -> None:
        """Let this be the latest of its kind."""
        with self._mutex:
            self._latest[kind] = (self._latest.get(kind, (0, b""))[0] + 1, data)
        self._wake()

    def latest(self, kind: str) -> tuple[int, bytes]:
        """Number and content of the latest of a kind; number 0 where there is none."""
        with self._mutex:
            return self._latest.get(kind, (0, b""))

    async def watch(self, *kinds: str) -> AsyncIterator[tuple[str, int, bytes]]:
        """The latest of these kinds, now and whenever there is another, until the server ends.

        Raises:
            Refusal: too many watch already.
        """
        seen = dict.fromkeys(kinds, 0)
        self.streams += 1
        try:
            while not self._closed:
                changed = self._changed
                for kind in kinds:
                    number, data = self.latest(kind)
                    if number != seen[kind]:
                        seen[kind] = number
                        yield kind, number, data
                await changed.wait()
                # Not all at the same time: whoever asks for something comes in between.
                await asyncio.sleep(max(_FASTEST_S, self.streams / _EACH_SECOND) * random.uniform(0.75, 1.25))
        finally:
            self.streams -= 1

    def admit(self, first: bool = False) -> None:
        """Look whether another may watch.

        Args:
            first: for the operator, whose lease is asked for by a stream, and for administrators some are kept.

        Raises:
            Refusal: too many do already.
        """
        if self.streams >= MOST_STREAMS + (_KEPT if first else 0):
            raise Refusal(FULL, f"{self.streams} streams are open, and no more are served: try again later", 5.0)

    def _wake(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._swap)

    def _swap(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()
