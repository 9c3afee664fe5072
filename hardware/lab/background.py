"""Long work in threads of its own: few at a time, and a queue with an end.

They have the priority of all others: one of lower priority that is put off while it has the interpreter puts off Stop.
"""

import asyncio
import threading
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, TypeVar

from hardware.lab.refusal import FULL, TOO_MANY, Refusal

T = TypeVar("T")
_END: Final = object()


class Workers:
    """Threads for one kind of work.

    Args:
        what: they do, in words: "clouds".
        threads: of them.
        most: pieces of work that are under way or wait.
        each: and of one account or address.
        again_s: when to ask again.
    """

    def __init__(self, what: str, threads: int, most: int, each: int, again_s: float = 5.0):
        self._what, self._most, self._each, self._again_s = what, most, each, again_s
        self._pool = ThreadPoolExecutor(threads, what)
        self._mutex = threading.Lock()
        self._held: Counter[str] = Counter()

    @property
    def under_way(self) -> int:
        """How many pieces of work are under way or wait."""
        with self._mutex:
            return self._held.total()

    @property
    def alive(self) -> bool:
        """Whether something is under way."""
        return self.under_way > 0

    def enter(self, whose: str) -> Callable[[], None]:
        """Take a place; what is returned leaves it, and may be called twice.

        Raises:
            Refusal: there is none, or this account or address has its share.
        """
        with self._mutex:
            if self._held[whose] >= self._each:
                held = self._held[whose]
                raise Refusal(TOO_MANY, f"{held} {self._what} of yours are under way: wait for one", self._again_s)
            if self._held.total() >= self._most:
                raise Refusal(FULL, f"too many {self._what} are under way: try again later", self._again_s)
            self._held[whose] += 1
        left = threading.Lock()

        def leave() -> None:
            if left.acquire(blocking=False):
                with self._mutex:
                    self._held[whose] -= 1
                    self._held += Counter()

        return leave

    async def run(self, whose: str, work: Callable[[], T]) -> T:
        """Do a piece of work, and wait for it.

        Raises:
            Refusal: as `enter`.
        """
        leave = self.enter(whose)
        try:
            future: Future[T] = self._pool.submit(work)
        except BaseException:
            leave()
            raise
        # Whoever asked may be gone before it is done: its place is not free until it is.
        future.add_done_callback(lambda _: leave())
        return await asyncio.wrap_future(future)

    async def each(self, parts: Generator[Any, None, None]) -> AsyncGenerator[Any, None]:
        """What a generator yields, one by one as it is fetched; it is closed where nobody fetches any more."""
        fetched = self._pool.submit(next, parts, _END)
        try:
            while (part := await asyncio.wrap_future(fetched)) is not _END:
                yield part
                fetched = self._pool.submit(next, parts, _END)
        finally:
            # A generator that runs cannot be closed: behind what is under way.
            fetched.add_done_callback(lambda _: parts.close())

    def close(self) -> None:
        """Begin nothing more; what is under way is not waited for."""
        self._pool.shutdown(wait=False, cancel_futures=True)
