"""How far the work is, on standard error: a bar on a terminal, one line at the end anywhere else."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")


@contextmanager
def progress(words: str, total: int | None = None, unit: str = "image") -> Iterator[Callable[[int], object]]:
    """A bar for the length of the block, advanced by the function that the block is given.

    Args:
        words: what is being done, as "reading corners".
        total: how many units there are, where it is known.
        unit: what one step is, in the singular.
    """
    from tqdm import tqdm

    # Its monitor thread would outlive the command; a bar of ours is moved often enough without it.
    tqdm.monitor_interval = 0
    begin = time.monotonic()
    terminal = sys.stderr.isatty()
    with tqdm(desc=words, total=total, unit=unit, file=sys.stderr, disable=not terminal, leave=True) as bar:
        count = 0

        def advance(by: int = 1) -> None:
            nonlocal count
            count += by
            bar.update(by)

        yield advance
    if not terminal:
        print(f"{words}: {count} {unit}{'' if count == 1 else 's'}, {time.monotonic() - begin:.1f} s", file=sys.stderr)


def track(items: Iterable[Item], words: str, total: int | None = None, unit: str = "image") -> Iterator[Item]:
    """The items, one after the other, with a bar that moves as they are taken."""
    with progress(words, total, unit) as advance:
        for item in items:
            yield item
            advance(1)
