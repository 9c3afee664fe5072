"""A job under way: its entry in the logbook, what pauses and ends it, and the threads that do so."""

import threading
import time
from collections.abc import Callable
from typing import Final

from hardware.lab.guidance import PageOperator
from hardware.lab.logbook import Job, State
from hardware.scan import Control

# The order to stop is repeated to an axis until its job has ended.
_AGAIN_S: Final = 0.2
ENDED_S: Final = 15.0


class _Control(Control):
    """Also says when the scan stands."""

    def __init__(self, changed: Callable[[], object]):
        super().__init__()
        self._waiting = False
        self._changed = changed

    @property
    def standing(self) -> bool:
        """Whether it is paused, and the photograph that was being taken is done."""
        return self.paused and self._waiting

    def wait(self) -> None:
        if self.paused:
            self._waiting = True
            self._changed()
        super().wait()
        self._waiting = False
        self._changed()


class Run:
    """A job under way.

    Attributes:
        job: as the logbook has it.
        control: of a scan.
        ended_by: who or what ended it; "" while nobody has.
        ends_as: its state where somebody has.
        thread: in which it runs.
        operator: who is asked, in a calibration session.
        note: called with the job whenever it changes.
    """

    def __init__(self, job: Job):
        self.job = job
        self.control = _Control(self._changed)
        self.ended_by = ""
        self.ends_as: State = "aborted"
        self.thread: threading.Thread | None = None
        # Held for a few assignments, never for what may take time.
        self._mutex = threading.RLock()
        self._finished = threading.Event()
        self._stopper: threading.Thread | None = None
        self.note: Callable[[Job], object] = lambda job: None
        self.operator: PageOperator | None = None

    @property
    def scans(self) -> bool:
        """Whether it is a scan."""
        return self.job.work.kind == "scan"

    def _changed(self) -> None:
        self.update(state="paused" if self.control.standing else "pausing" if self.control.paused else "running")

    def update(self, **values: object) -> None:
        """Note what has changed of it."""
        with self._mutex:
            self.job = self.job.model_copy(update=values)
            self.note(self.job)

    def pause(self) -> None:
        """Let a scan stand after the photograph that is being taken."""
        self.control.pause()
        self._changed()

    def resume(self) -> None:
        """Let it go on."""
        self.control.resume()
        self._changed()

    def revoke(self, words: str, ends_as: State, halt: Callable[[], object]) -> None:
        """End it at once: all axes are ordered to stop until it has ended. From any thread; it waits for nothing."""
        with self._mutex:
            if self._finished.is_set():
                return
            self.ended_by, self.ends_as = words, ends_as
            self.control.abort()

            def stop() -> None:
                until_s = time.monotonic() + ENDED_S
                while not self._finished.is_set() and time.monotonic() < until_s:
                    halt()
                    self._finished.wait(_AGAIN_S)

            if self._stopper is None:
                self._stopper = threading.Thread(target=stop, name=f"stop job {self.job.id}", daemon=True)
                self._stopper.start()

    def finish(self) -> None:
        """The devices are done with: return once no stop order is left that could reach the next job."""
        with self._mutex:
            self._finished.set()
            stopper = self._stopper
        if stopper is not None:
            stopper.join()
