"""How long something takes."""

import statistics
import time
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

_Answer = TypeVar("_Answer")


class Timed(NamedTuple, Generic[_Answer]):
    """Seconds of the first call, which compiles; the median of the calls after it; what the last returned."""

    first: float
    median: float
    answer: _Answer


def timed(work: Callable[[], _Answer], repeats: int = 5) -> Timed[_Answer]:
    """Call something once, and then some more times."""
    first, answer = _once(work)
    times = []
    for _ in range(repeats):
        seconds, answer = _once(work)
        times.append(seconds)
    return Timed(first, statistics.median(times), answer)


def _once(work: Callable[[], _Answer]) -> tuple[float, _Answer]:
    begin = time.perf_counter()
    answer = work()
    return time.perf_counter() - begin, answer
