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


def side_by_side(limit: Callable[[], object], work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median seconds of both, taken in turn, so that a busy machine weighs on both."""
    times = [(_once(limit)[0], _once(work)[0]) for _ in range(repeats)]
    of_limit, of_work = (statistics.median(some) for some in zip(*times, strict=True))
    return of_limit, of_work


def _once(work: Callable[[], _Answer]) -> tuple[float, _Answer]:
    begin = time.perf_counter()
    answer = work()
    return time.perf_counter() - begin, answer
