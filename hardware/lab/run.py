"""A job under way: its entry in the logbook, what pauses and ends it, and the threads that do so."""

import threading
from collections.abc import Callable

from hardware.lab.guidance import PageOperator
from hardware.lab.logbook import Job, State
from hardware.scan import Control


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
        finished: set once the devices are done with.
        thread: in which it runs.
        stopper: which tells the stage to stand until it has ended.
        operator: who is asked, in a calibration session.
        note: called with the job whenever it changes.
    """

    def __init__(self, job: Job):
        self.job = job
        self.control = _Control(self._changed)
        self.ended_by = ""
        self.ends_as: State = "aborted"
        self.finished = threading.Event()
        self.thread: threading.Thread | None = None
        self.stopper: threading.Thread | None = None
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
