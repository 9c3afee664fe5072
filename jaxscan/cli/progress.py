"""How far the work is, on standard error: a bar that moves on a terminal, a line now and then anywhere else.

A thread beside the work watches it. Work that neither gets on nor uses the processor for too long is stuck, and the
command ends with a message.

`working` is for the rest of a command, in which nothing is counted: what it is doing stands in one line, which is
wiped out again.
"""

import faulthandler
import os
import sys
import threading
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, Final, TypeVar

from jaxscan.cli.compiled import compiling
from jaxscan.deadline import HOW_TO_GO_ON, IDLE, patience_s

Item = TypeVar("Item")

_PULSE_S: Final = 0.5
# Without a terminal a line is printed this often: at first, and in work that takes longer than a minute.
_LINE_S, _LATER_LINE_S = 4.0, 15.0
_LATER_S: Final = 60.0
# Work that is not counted is shown after this long. Its line fits the narrowest terminal.
_QUIET_S: Final = 1.0
_WIDTH, _HEIGHT = 79, 24
_COMPILING: Final = "compiling, this once"


class Progress:
    """What a block of work says of itself. Calling it says that some units are done."""

    def __init__(self, words: str, unit: str, bar: Any, at_work: Collection[str] = ()) -> None:
        self._words, self._unit, self._bar, self._at_work = words, unit, bar, at_work
        self._begin = time.monotonic()
        self._calls, self._used = 0, time.process_time()
        self._count = 0
        self._doing = ""

    def __call__(self, by: int = 1) -> None:
        """Add `by` units to what is done."""
        self._calls, self._used = self._calls + 1, time.process_time()
        self._count += by
        self._bar.update(by)

    def says(self, doing: str) -> None:
        """Another unit is done; what is being done next, in words."""
        self._doing = doing
        self._bar.set_postfix_str(doing, refresh=False)
        self()

    def line(self) -> str:
        """How far it is."""
        total = "" if self._bar.total is None or self._count == self._bar.total else f" of {self._bar.total}"
        number = self._bar.total if total else self._count
        doing = f" ({said})" if (said := self._says()) else ""
        units = f"{self._unit}{'' if number == 1 else 's'}"
        return f"{self._words}: {self._count}{total} {units}{doing}, {time.monotonic() - self._begin:.1f} s"

    def _says(self) -> str:
        """What is being done, and that it is compiled for, which no later command does again."""
        return ", ".join(each for each in (self._doing, _COMPILING * compiling()) if each)

    def _line_s(self) -> float:
        """Seconds from one line to the next."""
        return _LINE_S if time.monotonic() - self._begin < _LATER_S else _LATER_LINE_S

    def watch(self, ended: threading.Event, limit: float) -> None:
        """Keep the bar moving, or print lines, until the block has ended; end the program where it is stuck."""
        printed = time.monotonic()
        calls, idle = self._calls, 0.0
        while not ended.wait(_PULSE_S):
            if not self._bar.disable:
                self._bar.set_postfix_str(self._says(), refresh=False)
                self._bar.refresh()
            elif time.monotonic() - printed > self._line_s():
                printed = time.monotonic()
                print(self.line(), file=sys.stderr, flush=True)
            # Counted and not read from a clock: a process that was stopped, by Ctrl-Z for one, is not stuck.
            calls, idle = self._calls, idle + _PULSE_S if calls == self._calls else 0.0
            if idle > limit and time.process_time() - self._used < IDLE * limit:
                self._give_up(limit)

    def _give_up(self, limit: float) -> None:
        self._bar.close()
        among = f" (at {', '.join(sorted(self._at_work))})" if self._at_work else ""
        print(f"error: {self.line()}: stuck for {limit:g} s{among}: {HOW_TO_GO_ON}", file=sys.stderr, flush=True)
        if os.environ.get("JAXSCAN_DEBUG"):
            faulthandler.dump_traceback(all_threads=True)
        # Whatever is stuck would not let the program end. Files are renamed into place whole, so none is half-written.
        os._exit(1)


class Working:
    """What a command shows while nothing else does."""

    def __init__(self, name: str) -> None:
        self._name, self._words = name, "starting"
        self._began = time.monotonic()
        # When the screen last said something.
        self._said = self._began
        self._shown, self._resting = "", 0
        self._lock = threading.RLock()

    def does(self, words: str) -> None:
        """What is done from now on, in words."""
        self._words = words

    @contextmanager
    def rest(self) -> Iterator[None]:
        """Show nothing in the block, in which something else writes to the screen."""
        with self._lock:
            self._resting += 1
            self._wipe()
        try:
            yield
        finally:
            with self._lock:
                self._resting -= 1
                self._said = time.monotonic()

    def watch(self, ended: threading.Event) -> None:
        """Show what is being done, until the event."""
        while not ended.wait(_PULSE_S):
            with self._lock:
                if not self._resting:
                    self._show()
        with self._lock:
            self._wipe()

    def _show(self) -> None:
        now, line = time.monotonic(), f"{self._name}: {self._words}{f', {_COMPILING}' * compiling()}"
        if not sys.stderr.isatty():
            # Who reads a log later does not wait, and short commands leave it empty.
            if now - self._said > _LATER_LINE_S:
                self._said = now
                print(f"{line}, {now - self._began:.1f} s", file=sys.stderr, flush=True)
        elif self._shown or now - self._said > _QUIET_S:
            self._wipe()
            seconds = f", {now - self._began:.0f} s"
            self._shown = line[: _WIDTH - len(seconds)] + seconds
            print(self._shown, end="", file=sys.stderr, flush=True)

    def _wipe(self) -> None:
        if self._shown:
            print(f"\r{' ' * len(self._shown)}\r", end="", file=sys.stderr, flush=True)
            self._shown = ""


# That of the command that runs, if one does: a process runs one.
_working: Working | None = None


@contextmanager
def working(name: str) -> Iterator[None]:
    """Show what the command of a name is doing wherever it says nothing else for a second."""
    global _working
    _working = made = Working(name)
    ended = threading.Event()
    watch = threading.Thread(target=made.watch, args=(ended,), daemon=True)
    watch.start()
    try:
        yield
    finally:
        _working = None
        ended.set()
        watch.join()


def step(words: str) -> None:
    """Say what the command does from now on, as "finding the floor"; shown where that takes a second."""
    if _working is not None:
        _working.does(words)


def resting() -> Any:
    """A block in which `working` shows nothing, for something else writes to the screen, or nothing goes on."""
    return nullcontext() if _working is None else _working.rest()


def say(line: str) -> None:
    """Print a line on standard error, clear of what `working` shows."""
    with resting():
        print(line, file=sys.stderr, flush=True)


@contextmanager
def progress(
    words: str,
    total: int | None = None,
    unit: str = "image",
    elsewhere: bool = False,
    at_work: Collection[str] = (),
) -> Iterator[Progress]:
    """A bar for the length of the block, advanced by the object that the block is given.

    Args:
        words: what is being done, as "reading corners".
        total: how many units there are, where it is known.
        unit: what one step is, in the singular.
        elsewhere: whether others do the work, so that this process is idle.
        at_work: what is being worked on, in words, which the work keeps up to date; named where it is stuck.
    """
    from tqdm import tqdm

    # Its monitor thread would outlive the command, and ours moves the bar.
    tqdm.monitor_interval = 0
    limit, ended = float("inf") if elsewhere else patience_s(), threading.Event()
    with resting():
        shown = sys.stderr.isatty()
        columns, rows = _size(shown)
        with tqdm(
            desc=words, total=total, unit=unit, file=sys.stderr, disable=not shown, ncols=columns, nrows=rows
        ) as bar:
            # A bar that is not shown forgets its total.
            bar.total = total
            made = Progress(words, unit, bar, at_work)
            watch = threading.Thread(target=made.watch, args=(ended, limit), daemon=True)
            watch.start()
            try:
                yield made
            finally:
                ended.set()
                watch.join()
        if not shown:
            print(made.line(), file=sys.stderr)
    step("going on")


def _size(terminal: bool) -> tuple[int | None, int | None]:
    """Columns and rows for the bar where a terminal does not say how large it is, as through a serial line."""
    try:
        known = terminal and min(os.get_terminal_size(sys.stderr.fileno())) > 0
    except (OSError, ValueError, AttributeError):
        known = False
    return (None, None) if known or not terminal else (_WIDTH, _HEIGHT)


def track(items: Iterable[Item], words: str, total: int | None = None, unit: str = "image") -> Iterator[Item]:
    """The items, one after the other, with a bar that moves as they are taken."""
    with progress(words, total, unit) as advance:
        for item in items:
            yield item
            advance(1)
