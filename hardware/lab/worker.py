"""Jobs: one at a time, ordered by the holder of the operator's lock, each in a thread of its own.

Whatever moves asks for leave first: somebody has to hold the lock, and the job must not have been ended. When its
holder is lost, a job ordered by hand is stopped at once. A scan goes on by itself, keeping the lock, until it is done
or paused; when another person takes the scanner over it is paused.
"""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from hardware.errors import HardwareError, NotHomedError, SettingsError, StoppedError
from hardware.frame import Frame, in_words
from hardware.lab.badges import Visitor
from hardware.lab.bench import Bench, PermittedStage, check
from hardware.lab.calibrations import Calibrations
from hardware.lab.guidance import Guide, PageOperator
from hardware.lab.lock import OperatorLock
from hardware.lab.logbook import Job, Logbook, State
from hardware.lab.orders import Calibrate, Check, Home, Move, Scan, Shoot, Work, places_of_work, turns_of
from hardware.lab.projects import Projects
from hardware.lab.refusal import CONFLICT, WRONG_VALUE, Refusal
from hardware.lab.run import ENDED_S, Run
from hardware.places import axes_of, check_places, check_scan, check_zero, travel_of
from hardware.scan import Devices, ensure_homed, take
from hardware.scan_plan import PLAN_FILE, Plan, ScanFolder
from hardware.stages import Travel
from jaxscan.errors import JaxscanError
from jaxscan.images import Board, StripeSettings

if TYPE_CHECKING:
    from hardware.guide import Sight

_LOG: Final = logging.getLogger(__name__)


class Audience(Protocol):
    """Whoever looks at what is taken."""

    def begin(self, project: str, scan: ScanFolder) -> None:
        """A job adds photographs to a project."""
        ...

    def show(self, frame: Frame, path: Path | None = None) -> None:
        """A photograph, and its file once it is part of a project."""
        ...

    def see(self, sight: "Sight") -> None:
        """A photograph of the board."""
        ...


@dataclass(frozen=True)
class Habits:
    """How photographs are taken, as the scanner's description says, and which of its parts are simulated."""

    travels: Mapping[str, Travel] = field(default_factory=lambda: {"stage": Travel()})
    stripe: StripeSettings = field(default_factory=StripeSettings)
    exposure_s: float | None = None
    gain: float = 1.0
    simulated: tuple[str, ...] = ()


class Worker:
    """Takes orders, and carries out one at a time."""

    def __init__(
        self,
        bench: Bench,
        logbook: Logbook,
        lock: OperatorLock,
        projects: Projects,
        calibrations: Calibrations,
        audience: Audience,
        habits: Habits,
    ):
        self._bench, self._logbook, self._lock = bench, logbook, lock
        self._projects, self._calibrations = projects, calibrations
        self._audience, self._habits = audience, habits
        # Held by orders, for as long as the disk takes; never by what stops.
        self._mutex = threading.RLock()
        self._stops = 0
        self._run: Run | None = None
        self.latest: Job | None = None
        logbook.interrupted()
        if jobs := logbook.latest():
            self.latest = jobs[0]

    @property
    def busy(self) -> bool:
        """Whether a job is under way, standing ones too."""
        return self._run is not None

    @property
    def scanning(self) -> bool:
        """Whether a scan is under way that does not stand: it keeps the operator's lock."""
        run = self._run
        return run is not None and run.scans and not run.control.standing

    @property
    def guide(self) -> Guide | None:
        """What a calibration session under way asks for."""
        run = self._run
        return None if run is None or run.operator is None else run.operator.guide

    def uses(self, *, project: str | None = None, session: str | None = None) -> bool:
        """Whether the job under way adds to this project, or to this calibration session."""
        run = self._run
        work = None if run is None else run.job.work
        if isinstance(work, Calibrate):
            return work.session == session
        return isinstance(work, Shoot | Scan) and work.project == project

    def start(self, work: Work, visitor: Visitor) -> Job:
        """Begin a job.

        Raises:
            Refusal: the visitor does not operate, another job is under way, or it cannot be done.
        """
        with self._mutex:
            self._lock.require(visitor)
            stops = self._stops
            self._must_be_idle()
            self._check(work)
            folder = self._folder(work)
            total = len(folder.left) if folder else 0
            if isinstance(work, Calibrate):
                total = work.views + work.stage_frames + work.turntable_frames
            self._must_go_on(stops)
            return self._go(self._logbook.begin(visitor.name, work, total), folder, stops)

    def resume(self, number: int, visitor: Visitor) -> Job:
        """Continue a scan that is paused, or one that ended early.

        Raises:
            Refusal: the visitor does not operate, or there is nothing to continue.
        """
        with self._mutex:
            self._lock.require(visitor)
            if (run := self._run) is not None and run.job.id == number and run.scans:
                run.update(user=visitor.name)
                run.resume()
                return run.job
            stops = self._stops
            job = self._logbook.one(number)
            self._must_be_idle()
            if not job.resumable or not isinstance(job.work, Scan):
                raise Refusal(CONFLICT, f"job {number} is no scan that ended early: order another one")
            folder = self._unfinished(job.work)
            taken = job.total - len(folder.left)
            again = {"user": visitor.name, "state": "running", "message": "", "taken": taken, "ended_s": None}
            self._must_go_on(stops)
            return self._go(job.model_copy(update=again), folder, stops)

    def answer(self, number: int, visitor: Visitor, go: bool) -> Job:
        """Tell a calibration session that the board is held as it asks, or (not `go`) that it has been held enough.

        Raises:
            Refusal: the visitor does not operate, or the job does not ask.
        """
        with self._mutex:
            self._lock.require(visitor)
            run = self._under_way(number)
            if run.operator is None or not run.operator.answer(go):
                raise Refusal(CONFLICT, f"job {number} ({run.job.work.kind}) needs no photograph now")
            return run.job

    def pause(self, number: int, visitor: Visitor) -> Job:
        """Let a scan stand after the photograph that is being taken.

        Raises:
            Refusal: the visitor does not operate, or the job is no scan under way.
        """
        with self._mutex:
            self._lock.require(visitor)
            run = self._under_way(number)
            if not run.scans:
                raise Refusal(CONFLICT, "only a scan can be paused: stop the stage, or wait until it has arrived")
            run.pause()
            return run.job

    def abort(self, number: int, visitor: Visitor) -> Job:
        """End a scan after the photograph that is being taken, any other job at once.

        Raises:
            Refusal: the visitor does not operate, or the job is not under way.
        """
        with self._mutex:
            self._lock.require(visitor)
            run = self._under_way(number)
            if run.scans:
                run.ended_by = f"aborted by {visitor.name}"
                run.control.abort()
            else:
                self._revoke(run, f"aborted by {visitor.name}")
            return run.job

    def may_stop(self, visitor: Visitor) -> None:
        """Look whether somebody may stop the scanner.

        Raises:
            Refusal: the visitor neither operates nor is an administrator.
        """
        if not visitor.administrator:
            self._lock.require(visitor)

    def stop(self, name: str) -> str:
        """Stand still and switch the laser off, at once, for somebody who may; what could not be, in words.

        It waits for no order: one that has not begun by now does not begin.
        """
        self._stops += 1
        if (run := self._run) is not None:
            self._revoke(run, f"stopped by {name}")
        return self._bench.stop()

    def lost(self, taken: bool) -> None:
        """The operator is gone, or (`taken`) another person operates now; it waits for no order either."""
        if (run := self._run) is None:
            return
        if not run.scans:
            self._revoke(run, "taken over" if taken else "stopped: its operator is gone")
        elif taken:
            run.pause()

    def close(self) -> None:
        """End whatever is under way; the logbook says that it was interrupted."""
        with self._mutex:
            if (run := self._run) is None or run.thread is None:
                return
            self._revoke(run, "the server ended while it ran", "interrupted")
        run.thread.join(ENDED_S)

    def _must_be_idle(self) -> None:
        if (run := self._run) is not None:
            doing = "is paused: continue or abort it" if run.control.standing else "is under way: wait, or end it"
            raise Refusal(CONFLICT, f"job {run.job.id} ({run.job.work.kind}) {doing}")

    def _must_go_on(self, stops: int) -> None:
        if self._stops != stops:
            raise Refusal(CONFLICT, "the scanner was stopped before this job began: order it again")

    def _under_way(self, number: int) -> Run:
        if (run := self._run) is None or run.job.id != number:
            job = self._logbook.one(number)
            raise Refusal(CONFLICT, f"job {number} is not under way: it is {job.state}")
        return run

    def _check(self, work: Work) -> None:
        """See that it can be done.

        Raises:
            Refusal: a place beyond the travel, or what is no session.
        """
        try:
            if isinstance(work, Calibrate):
                from hardware.guide import check_session

                check_session(work.views, work.steps, turns_of(work, self._habits.travels))
                self._calibrations.new(work.session)
            travels = self._habits.travels
            places = places_of_work(work, travels)
            if isinstance(work, Home) and work.axis is not None:
                travel_of(travels, work.axis)
            check = check_scan if isinstance(work, Shoot | Scan) else check_places
            check(travels, places)
        except (SettingsError, JaxscanError) as error:
            raise Refusal(WRONG_VALUE, str(error)) from error

    def _folder(self, work: Work) -> ScanFolder | None:
        """The folder in which a job takes the photographs of a scan, with those before it.

        Raises:
            Refusal: a photograph that is there already.
        """
        if not isinstance(work, Shoot | Scan):
            return None
        path = self._projects.path(work.project)
        habits, dark = self._habits, isinstance(work, Scan) and work.dark
        try:
            places = places_of_work(work, habits.travels)
            if not (path / PLAN_FILE).exists():
                plan = Plan(
                    axes_of(places),
                    work.settle_s,
                    dark,
                    habits.exposure_s,
                    habits.gain,
                    name=work.project,
                    laser=habits.stripe,
                )
                return self._projects.begin(work.project, plan)
            folder = ScanFolder.resume(path)
            if isinstance(work, Scan) and dark != folder.plan.dark:
                raise Refusal(
                    CONFLICT,
                    f"project {work.project} was begun {'with' if folder.plan.dark else 'without'} dark photographs: "
                    "go on so, or begin another project",
                )
            if there := [place for place in places if place in folder.taken]:
                raise Refusal(
                    CONFLICT,
                    f"project {work.project} has a photograph of {in_words(there[0])} already: choose other places, or "
                    "another project",
                )
            self._check_zero(folder)
            folder.go_on_at(places, work.settle_s)
            return folder
        except (SettingsError, JaxscanError) as error:
            raise Refusal(CONFLICT, str(error).replace(str(path), work.project)) from error

    def _unfinished(self, work: Scan) -> ScanFolder:
        """The folder of a scan that ended early, with the places that it did not come to."""
        path = self._projects.path(work.project)
        try:
            folder = ScanFolder.resume(path)
            self._check_zero(folder)
            places = places_of_work(work, self._habits.travels)
            folder.go_on_at([place for place in places if place not in folder.taken], work.settle_s)
        except (SettingsError, JaxscanError) as error:
            raise Refusal(CONFLICT, str(error).replace(str(path), work.project)) from error
        return folder

    def _check_zero(self, folder: ScanFolder) -> None:
        if folder.done.frames:
            check_zero(self._habits.travels, folder.plan.axes, self._bench.places)

    def _go(self, job: Job, folder: ScanFolder | None, stops: int) -> Job:
        run = Run(job)

        def note(changed: Job) -> None:
            self._logbook.note(changed)
            self.latest = changed

        run.note = note
        note(job)
        run.thread = threading.Thread(target=self._work, args=(run, folder), name=f"job {job.id}", daemon=True)
        self._run = run
        # Whoever stops counts first and then looks for a job: one of the two sees the other.
        if self._stops != stops:
            self._revoke(run, "stopped as it began")
        run.thread.start()
        return job

    def _work(self, run: Run, folder: ScanFolder | None) -> None:
        """The whole of a job, in its own thread."""
        state: State = "done"
        words = ""
        try:
            with self._bench.devices() as devices:
                words = self._do(run, folder, devices)
        except StoppedError as error:
            state, words = run.ends_as, run.ended_by or str(error)
        except NotHomedError as error:
            # Whoever stops an axis takes its reference.
            state, words = (run.ends_as, run.ended_by) if run.ended_by else ("failed", str(error))
        except (HardwareError, JaxscanError) as error:
            state, words = (run.ends_as, f"{run.ended_by}; {error}") if run.ended_by else ("failed", str(error))
        except OSError as error:
            state, words = "failed", f"the lab's disk: {error.strerror or error}"
        except Exception as error:  # noqa: BLE001 (said in the log; the next job may do)
            _LOG.exception("job %d", run.job.id)
            state, words = "failed", f"unexpected error: {type(error).__name__}: {error}"
        run.finish()
        with self._mutex:
            # A clock that was set back makes no job end before it began.
            ended_s = max(time.time(), run.job.began_s)
            run.update(state=state, message=self._projects.without_place(words), ended_s=ended_s)
            self._run = None

    def _do(self, run: Run, folder: ScanFolder | None, devices: Devices) -> str:
        """The work itself; what is to be said of it, though it is done."""
        work, camera, laser = run.job.work, devices.camera, devices.laser

        def permit() -> None:
            if run.ended_by:
                raise StoppedError(run.ended_by)
            if self._lock.holder is None:
                raise StoppedError("stopped: nobody operates")

        def arrived(name: str, place: int) -> None:
            self._bench.places = {**self._bench.places, name: place}

        def taken(path: Path, frame: Frame) -> None:
            run.update(taken=run.job.taken + 1)
            self._audience.show(frame, path)

        axes = {name: PermittedStage(axis, permit, partial(arrived, name)) for name, axis in devices.axes.items()}
        if isinstance(work, Home):
            for name in axes if work.axis is None else (work.axis,):
                axes[name].home()
            return ""
        if isinstance(work, Move):
            ensure_homed({work.axis: axes[work.axis]})
            axes[work.axis].move_to(work.step)
        if isinstance(work, Check | Scan):
            self._audience.show(check(devices))
        if folder is not None and isinstance(work, Shoot | Scan):
            self._audience.begin(work.project, folder)
            verify = work.verify if isinstance(work, Scan) else None
            return "; ".join(take(folder, Devices(camera, axes, laser), run.control, taken, verify=verify))
        if isinstance(work, Calibrate):
            self._calibrate(run, work, Devices(camera, axes, laser), permit)
        return ""

    def _calibrate(self, run: Run, work: Calibrate, devices: Devices, permit: Callable[[], object]) -> None:
        from hardware.guide import guided_session
        from hardware.simulated.operator import simulated_operator

        def said(words: str, taken: int) -> None:
            run.update(message=words, taken=taken)

        hand = simulated_operator(devices.camera, work.views)
        run.operator = PageOperator(permit, self._audience.see, said, hand)
        board = Board.checkerboard((work.columns, work.rows), work.square_mm)
        how = {
            "views": work.views,
            "stage_steps": work.steps,
            "turntable_steps": turns_of(work, self._habits.travels),
            "turntable_at": work.turntable_at,
            "stripe": self._habits.stripe,
        }
        try:
            guided_session(self._calibrations.new(work.session), devices, board, run.operator, **how)
        finally:
            if hand is not None:
                hand.leave()

    def _revoke(self, run: Run, words: str, ends_as: State = "aborted") -> None:
        """End a job at once."""
        run.revoke(words, ends_as, self._bench.stop)
