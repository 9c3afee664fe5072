"""Whatever happens, the laser goes off; and when something went wrong, the stage stands."""

import atexit
from collections.abc import Iterator
from contextlib import contextmanager

from hardware.errors import HardwareError, LeftOnError
from hardware.protocols import LaserDriver, StageDriver

_TRIES = 3


@contextmanager
def safely(stage: StageDriver | None, laser: LaserDriver | None) -> Iterator[None]:
    """Switch the laser off at the end of the block, and stop the stage when that ended in an error or a signal.

    A signal has to be an exception by then (`KeyboardInterrupt` is; `scanner` makes one of SIGTERM and SIGHUP). Where
    the interpreter ends without the block, the laser is switched off at its exit.

    Raises:
        LeftOnError: one of the two could not be seen to be off; the text says which, and why the block ended.
    """
    if laser is not None:
        atexit.register(laser.off)
    try:
        yield
    except BaseException as error:
        if words := left_on(stage, laser):
            raise LeftOnError(f"{error or type(error).__name__}; {words}") from error
        raise
    else:
        if words := left_on(None, laser):
            raise LeftOnError(words)
    finally:
        if laser is not None:
            atexit.unregister(laser.off)


def left_on(stage: StageDriver | None, laser: LaserDriver | None) -> str:
    """Switch the laser off and stop the stage, each as often as it takes; what could not be, in words."""
    words, orders = [], []
    if laser is not None:
        orders.append(("the LASER MAY STILL BE ON", laser.off))
    if stage is not None:
        orders.append(("the STAGE MAY STILL BE MOVING", stage.stop))
    for what, off in orders:
        for attempt in range(_TRIES):
            try:
                off()
                break
            except HardwareError as error:
                if attempt == _TRIES - 1:
                    words.append(f"{what} ({error}): switch it off at its supply")
    return "; ".join(words)
