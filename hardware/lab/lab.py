"""The lab: database, accounts, lock, devices, jobs, projects and what is shown of them, put together."""

import asyncio
import json
import logging
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pydantic import BaseModel

from hardware.lab.accounts import HASHES_AT_A_TIME, Accounts
from hardware.lab.background import Workers
from hardware.lab.bench import Bench
from hardware.lab.calibrations import Calibrations
from hardware.lab.database import DATABASE, Database, OnlyServer, make_folder
from hardware.lab.emergency import Emergency
from hardware.lab.gallery import Gallery
from hardware.lab.guidance import Guide
from hardware.lab.hub import Hub
from hardware.lab.lock import Holder, OperatorLock
from hardware.lab.logbook import Job, Logbook
from hardware.lab.preview import Preview
from hardware.lab.projects import Projects
from hardware.lab.rigs import Rigs
from hardware.lab.worker import Habits, Worker
from hardware.scan import Devices

if TYPE_CHECKING:
    from jaxscan import RigFile

LEASE_S: Final = 15.0
# How many times within a lease the holder of the lock is asked whether it is there, and how often this is checked.
_PINGS, _LOOKS = 4, 20
# Sessions and tokens that another process has changed are seen within this time.
_BADGES_S: Final = 1.0
# The state is looked at so often, and told when it has changed.
_STATE_S: Final = 0.2


class Axis(BaseModel):
    """One axis of the scanner.

    Attributes:
        place: where it stands, motor steps; None where it has to be homed first.
        first, last: the step counts between which it may be sent.
        steps_per_turn: of an axis that turns.
    """

    place: int | None
    first: int
    last: int
    steps_per_turn: int | None


class State(BaseModel):
    """What everybody sees of the scanner.

    Attributes:
        operator: who operates; None while nobody does.
        job: the one under way, or the last.
        guide: what a calibration session under way asks for.
        axes: by their names.
        live: whether the camera's live picture is on, and with the laser.
        rig: whether one is in use: profiles then come with points.
        rig_name: the calibration session that it comes from; "" where the server was started with it.
        rig_warnings: what is known against it, in words.
        lease_s: how long the operator may be silent.
        simulated: which parts are no real ones: the camera, axes by their names, the laser.
    """

    operator: Holder | None
    job: Job | None
    guide: Guide | None
    axes: dict[str, Axis]
    live: bool
    live_laser: bool
    rig: bool
    rig_name: str
    rig_warnings: tuple[str, ...]
    lease_s: float
    simulated: tuple[str, ...]


class Lab:
    """All parts of a lab, working.

    Args:
        folder: where its data are; made if need be.
        connect: opens the devices.
        habits: of the scanner.
        rig: of the scanner, for points; by default that which was in use before.
        lease_s: of the operator's lock.
        live_s: time between live pictures.

    Raises:
        InputError: the folder cannot be used, or another server uses it.
    """

    def __init__(
        self,
        folder: Path,
        connect: Callable[[], Devices],
        habits: Habits | None = None,
        rig: "RigFile | None" = None,
        lease_s: float = LEASE_S,
        live_s: float = 1.0,
    ):
        self.habits = habits or Habits()
        self.lease_s = lease_s
        self._ended = threading.Event()
        with ExitStack() as undo:
            make_folder(folder)
            only = OnlyServer(folder / "server.lock")
            undo.callback(only.close)
            database = Database(folder / DATABASE)
            undo.callback(database.close)
            self.rigs = Rigs(folder, rig, self._use_rig)
            undo.callback(self.rigs.close)
            rig = self.rigs.current
            self.accounts, self.projects = Accounts(database), Projects(folder, rig)
            self.hub, self.bench = Hub(), Bench(connect)
            undo.callback(self.bench.close)
            self.gallery = Gallery(self.hub, self.habits.stripe, rig)
            undo.callback(self.gallery.close)
            self.lock = OperatorLock(lease_s, lambda: self.worker.scanning, self._lost)
            self.logbook = Logbook(database)
            undo.callback(self.logbook.close)
            self.calibrations = Calibrations(folder)
            self.worker = Worker(
                self.bench, self.logbook, self.lock, self.projects, self.calibrations, self.gallery, self.habits
            )
            undo.callback(self.worker.close)
            self.emergency = Emergency(self.worker)
            undo.callback(self.emergency.close)
            self.preview = Preview(self.bench, self.lock, self.gallery, lambda: self.worker.busy, live_s)
            undo.callback(self.preview.close)
            # What takes long, and never keeps anything else waiting.
            self.clouds = Workers("clouds", 1, 8, 2)
            self.solves = Workers("calibrations", 1, 4, 1)
            self.downloads = Workers("downloads", 4, 16, 4)
            self.lists = Workers("lists", 4, 64, 16, 1.0)
            self.sign_ins = Workers("sign-ins", HASHES_AT_A_TIME, 16, 4, 1.0)
            self._workers = (self.clouds, self.solves, self.downloads, self.lists, self.sign_ins)
            for workers in self._workers:
                undo.callback(workers.close)
            undo.callback(self.projects.close)
            for name, look, every_s in (
                ("lease", self.lock.expire, lease_s / _LOOKS),
                ("badges", self.accounts.badges.tend, _BADGES_S),
            ):
                thread = threading.Thread(target=self._look_again, args=(look, every_s), name=name, daemon=True)
                thread.start()
                undo.callback(thread.join)
            undo.callback(self._ended.set)
            self._close = undo.pop_all().close

    def state(self) -> State:
        """As it is now."""
        places, rig = self.bench.places, self.rigs.current
        return State(
            operator=self.lock.holder,
            job=self.worker.latest,
            guide=self.worker.guide,
            axes={
                name: Axis(place=places.get(name), first=at.first, last=at.last, steps_per_turn=at.steps_per_turn)
                for name, at in self.habits.travels.items()
            },
            live=self.preview.on,
            live_laser=self.preview.laser,
            rig=rig is not None,
            rig_name=self.rigs.name,
            rig_warnings=() if rig is None else rig.warnings,
            lease_s=self.lease_s,
            simulated=self.habits.simulated,
        )

    async def tell(self) -> None:
        """Tell the watchers of every change of state, and ask whether they are there, until cancelled."""
        told, asked_s, count = None, 0.0, 0
        while True:
            if (state := self.state()) != told:
                self.hub.publish("state", state.model_dump_json().encode())
                told = state
            if time.monotonic() - asked_s > self.lease_s / _PINGS:
                asked_s, count = time.monotonic(), count + 1
                self.hub.publish("ping", json.dumps(count).encode())
            await asyncio.sleep(_STATE_S)

    @property
    def alive(self) -> bool:
        """Whether something is still done that nobody waits for any more, once it is closed."""
        return self.gallery.alive or any(workers.alive for workers in self._workers)

    def close(self) -> None:
        """End what is under way, switch everything off, and close."""
        self._close()

    def _use_rig(self, rig: "RigFile | None") -> None:
        self.projects.use(rig)
        self.gallery.use(rig)

    def _lost(self, taken: bool) -> None:
        self.preview.switch(False, False)
        self.worker.lost(taken)

    def _look_again(self, look: Callable[[], object], every_s: float) -> None:
        while not self._ended.wait(every_s):
            try:
                look()
            except Exception:  # it goes on being looked after, whatever else is broken
                logging.getLogger(__name__).exception("%s", threading.current_thread().name)
