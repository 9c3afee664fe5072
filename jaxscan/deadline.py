"""Threads that are never waited for without a limit.

What counts is time in which this process runs: one that is stopped, by Ctrl-Z or a machine that sleeps, is not stuck.
"""

import math
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from types import TracebackType
from typing import Any, Final, Self, TypeVar

from jaxscan.errors import InputError, StalledError

PATIENCE: Final = "JAXSCAN_PATIENCE_S"
_PATIENCE_S: Final = 600.0
# How long the end of a block waits for its threads; and where it ends by Ctrl-C, which waits for no compiler.
_LET_GO_S: Final = 5.0
_LET_GO_INTERRUPTED_S: Final = 0.2
# The longest that is waited in one go, of which the time that the process was stopped may be the whole.
_LOOK_S: Final = 1.0
# What is stuck uses less of one core than this. On a loaded machine a step of work that goes on takes long: seconds in
# which the process is busy count a tenth, for work without an end is busy too.
IDLE: Final = 0.02
_BUSY_COUNTS: Final = 0.1
HOW_TO_GO_ON: Final = (
    f"try again, and report it if it comes again; if the machine or the disk is only slow, set {PATIENCE} to more "
    "seconds"
)

Item = TypeVar("Item")
Result = TypeVar("Result")


def patience_s() -> float:
    """How long a step of the work may take, in seconds: 600, or what the variable `JAXSCAN_PATIENCE_S` says.

    Raises:
        InputError: it is no positive number.
    """
    text = os.environ.get(PATIENCE, "")
    try:
        seconds = float(text) if text else _PATIENCE_S
    except ValueError:
        seconds = -1.0
    if not 0 < seconds < float("inf"):
        raise InputError(f'{PATIENCE} is "{text}": give a number of seconds above 0, or unset it')
    return seconds


class Workers:
    """Threads for a block of work. The block, and the program, can end while one of them is stuck.

    `concurrent.futures.ThreadPoolExecutor` waits for its threads without a limit. Here the end of the block cancels
    what has not begun, and waits a few seconds for what has, after Ctrl-C a moment.

    Args:
        count: how many threads; as many as the machine has cores by default.
    """

    def __init__(self, count: int | None = None) -> None:
        self._tasks: queue.SimpleQueue[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]] | None]
        self._tasks = queue.SimpleQueue()
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(count or os.cpu_count() or 1)]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        while True:
            try:
                task = self._tasks.get_nowait()
            except queue.Empty:
                break
            if task is not None:
                task[0].cancel()
        for _ in self._threads:
            self._tasks.put(None)
        until = time.monotonic() + (_LET_GO_INTERRUPTED_S if kind is KeyboardInterrupt else _LET_GO_S)
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def submit(self, work: Callable[..., Result], *args: Any) -> "Future[Result]":
        """Begin a task as soon as a thread is free; the tasks begin in their order."""
        future: Future[Result] = Future()
        self._tasks.put((future, work, args))
        return future

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            future, work, args = task
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(work(*args))
            except BaseException as error:  # noqa: BLE001 (raised again in the thread that asks for the result)
                future.set_exception(error)


def result_of(future: "Future[Result]", what: str) -> Result:
    """What a task returns or raises.

    Args:
        future: the task, of which those that were begun before have ended.
        what: the task in words, a file's name for one.

    Raises:
        StalledError: it has not ended in `patience_s` seconds in which the process was idle, or ten times as long.
    """
    limit = patience_s()
    look, waited = limit / math.ceil(limit / _LOOK_S), 0.0
    while waited < limit:
        used = time.process_time()
        try:
            return future.result(look)
        except TimeoutError:
            if future.done():  # its own error
                raise
        busy = time.process_time() - used > IDLE * look
        waited += _BUSY_COUNTS * look if busy else look
    raise StalledError(f"{what}: it was worked on for {limit:g} s without an end: {HOW_TO_GO_ON}")


def in_turn(
    work: Callable[[Item], Result], items: Iterable[Item], count: int, what: str
) -> Iterator[tuple[Item, Result]]:
    """Each item with what is made of it, in their order, while the next ones are worked on.

    Args:
        work: what is done with each.
        items: each is asked for when a thread is free for it and what was made of those before it has been taken.
            Where they end in an error, what was made of those before it comes first.
        count: how many are worked on together; one alone in the thread of whoever asks for it.
        what: the work in words.

    Raises:
        StalledError: the work on one of them has not ended in `patience_s` seconds.
    """
    if count == 1:
        yield from ((item, work(item)) for item in items)
        return
    begun: deque[tuple[Item, Future[Result]]] = deque()
    failed: list[Exception] = []

    def each() -> Iterator[Item]:
        try:
            yield from items
        except Exception as error:  # noqa: BLE001 (raised again once the others have been taken)
            failed.append(error)

    def first() -> tuple[Item, Result]:
        item, future = begun.popleft()
        return item, result_of(future, what)

    with Workers(count) as workers:
        for item in each():
            begun.append((item, workers.submit(work, item)))
            if len(begun) == count:
                yield first()
        while begun:
            yield first()
    if failed:
        raise failed[0]
