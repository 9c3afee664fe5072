"""Calls into libraries that may never return."""

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeVar

from hardware.errors import NoAnswerError

Result = TypeVar("Result")
_LET_GO_S: Final = 5.0


def within(seconds: float, work: Callable[[], Result], words: str) -> Result:
    """What a call returns, or raises, if it does so in time; otherwise it is left behind in a thread of its own.

    Raises:
        NoAnswerError: it did not; the text begins with `words`.
    """
    done: queue.SimpleQueue[tuple[Result | None, BaseException | None]] = queue.SimpleQueue()

    def run() -> None:
        try:
            done.put((work(), None))
        except BaseException as error:  # noqa: BLE001 (raised again in the caller's thread)
            done.put((None, error))

    threading.Thread(target=run, daemon=True).start()
    try:
        result, error = done.get(timeout=seconds)
    except queue.Empty:
        raise NoAnswerError(
            f"{words}: nothing came in {seconds:.1f} s: check its cable and power, and open it again"
        ) from None
    if error is not None:
        raise error
    return result  # pyright: ignore[reportReturnType]


def let_go(work: Callable[[], object]) -> None:
    """Disconnect from a device; one that does not let go, because it is not there any more, is left behind."""
    with suppress(Exception):
        within(_LET_GO_S, work, "")
