"""A program as a process: what Ctrl-C does wherever it comes, and how the process ends.

Python tells of Ctrl-C by an exception in the main thread. Two places lose it. In a callback of the garbage collector,
and JAX has one, an exception is printed and forgotten; so it is raised once more. And when the interpreter ends, it
stops threads that are still inside of native code, which aborts an interrupted process, and it looks through all that
JAX has traced, which takes half a second. So a process ends at once, after everything that waits for its end has been
done.
"""

import _thread
import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, Final, NoReturn

INTERRUPTED: Final = 130
# After which time an interruption that was lost is raised once more, s.
_AGAIN_S: Final = 0.05

_owned = False


def own() -> None:
    """Say that this process runs one of our programs and nothing else: nobody changes what its functions do."""
    global _owned
    _owned = True


def owned() -> bool:
    """Whether this process runs one of our programs and nothing else."""
    return _owned


def run_as_process(program: Callable[[], int]) -> NoReturn:
    """Run a program and end the process with its exit status."""
    own()
    ended: list[int] = []
    # What is registered first is called last.
    atexit.register(_leave, ended)
    others = sys.unraisablehook

    def not_lost(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            again = threading.Timer(_AGAIN_S, _interrupt)
            again.daemon = True
            again.start()
        else:
            others(unraisable)

    sys.unraisablehook = not_lost
    ended.append(program())
    sys.exit(ended[0])


def _interrupt() -> None:
    """Interrupt the main thread, where it sleeps too."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


def _leave(ended: list[int]) -> None:
    if not ended:  # an exception ended the program; Python shows it
        return
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:  # Python tries again, says so, and ends with a status of its own
        return
    os._exit(ended[0])
