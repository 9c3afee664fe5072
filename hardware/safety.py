"""Whatever happens, the laser goes off; and when something went wrong, every axis stands."""

import atexit
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from hardware.errors import HardwareError, LeftOnError
from hardware.protocols import LaserDriver, StageDriver

_TRIES = 3


@contextmanager
def safely(axes: Mapping[str, StageDriver], laser: LaserDriver | None) -> Iterator[None]:
    """Switch the laser off at the end of the block, and stop all axes when that ended in an error or a signal.

    A signal has to be an exception by then (`KeyboardInterrupt` is; `scanner` makes one of SIGTERM and SIGHUP). Where
    the interpreter ends without the block, the laser is switched off at its exit.

    Raises:
        LeftOnError: one of them could not be seen to be off; the text says which, and why the block ended.
    """
    if laser is not None:
        atexit.register(laser.off)
    try:
        yield
    except BaseException as error:
        if words := left_on(axes, laser):
            raise LeftOnError(f"{error or type(error).__name__}; {words}") from error
        raise
    else:
        if words := left_on({}, laser):
            raise LeftOnError(words)
    finally:
        if laser is not None:
            atexit.unregister(laser.off)


def left_on(axes: Mapping[str, StageDriver], laser: LaserDriver | None) -> str:
    """Switch the laser off and stop all axes, each as often as it takes; what could not be, in words.

    No axis continues while another is slow to stop: each is stopped by its own thread.
    """
    words = [] if laser is None else [_done("the LASER MAY STILL BE ON", laser.off)]
    orders = [(f"the {name.upper()} MAY STILL BE MOVING", axis.stop) for name, axis in axes.items()]
    if len(orders) > 1:
        said = [""] * len(orders)

        def stop(i: int) -> None:
            said[i] = _done(*orders[i])

        threads = [threading.Thread(target=stop, args=(i,), daemon=True) for i in range(len(orders))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        words += said
    else:
        words += [_done(*order) for order in orders]
    return "; ".join(filter(None, words))


def _done(what: str, off: Callable[[], object]) -> str:
    """Give an order until it is obeyed; what is to be feared where it never was."""
    for attempt in range(_TRIES):
        try:
            off()
            break
        except HardwareError as error:
            if attempt == _TRIES - 1:
                return f"{what} ({error}): switch it off at its supply"
    return ""
