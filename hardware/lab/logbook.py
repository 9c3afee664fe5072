"""The logbook: every job there was, who ordered it and what became of it. It outlives the server."""

import logging
import sqlite3
import threading
import time
from typing import Final, Literal

from pydantic import BaseModel

from hardware.lab.database import Database
from hardware.lab.orders import WORK, Work
from hardware.lab.refusal import NOT_THERE, Refusal

State = Literal["running", "pausing", "paused", "done", "aborted", "failed", "interrupted"]
UNDER_WAY: Final = ("running", "pausing", "paused")
_MOST_LISTED: Final = 100
# A disk that refused is asked again.
_AGAIN_S: Final = 1.0
_LOG: Final = logging.getLogger(__name__)


class Job(BaseModel):
    """One job."""

    id: int
    user: str
    work: Work
    state: State
    taken: int
    total: int
    message: str
    began_s: float
    ended_s: float | None

    @property
    def resumable(self) -> bool:
        """Whether it is a scan that ended early."""
        return self.work.kind == "scan" and self.state in ("aborted", "failed", "interrupted")


class Logbook:
    """Jobs in the database, and in memory until they are there: no job waits for the disk, or fails with it."""

    def __init__(self, database: Database):
        self._database = database
        self._number = database("SELECT coalesce(max(id), 0) FROM jobs")[0][0]
        self._come = threading.Condition()
        self._unsaved: dict[int, Job] = {}
        self._closed = False
        self._writer = threading.Thread(target=self._write, name="logbook", daemon=True)
        self._writer.start()

    def begin(self, user: str, work: Work, total: int) -> Job:
        """A job that begins."""
        with self._come:
            self._number += 1
            began_s = time.time()
            return Job(
                id=self._number,
                user=user,
                work=work,
                state="running",
                taken=0,
                total=total,
                message="",
                began_s=began_s,
                ended_s=None,
            )

    def note(self, job: Job) -> None:
        """Note how far it is, at once; it is written as soon as the disk lets it be."""
        with self._come:
            self._unsaved[job.id] = job
            self._come.notify()

    def interrupted(self) -> None:
        """Note of every job that a server left under way that nobody continues it: at the start of the next one."""
        for row in self._database(f"SELECT * FROM jobs WHERE state IN {UNDER_WAY}"):
            job = _job(row)
            words = "the server ended while it ran"
            self.note(job.model_copy(update={"state": "interrupted", "message": words, "ended_s": time.time()}))

    def latest(self) -> list[Job]:
        """The last hundred, latest first."""
        rows = self._database.read(f"SELECT * FROM jobs ORDER BY id DESC LIMIT {_MOST_LISTED}")
        found = {row["id"]: _job(row) for row in rows}
        with self._come:
            found |= self._unsaved
        return [found[number] for number in sorted(found, reverse=True)[:_MOST_LISTED]]

    def one(self, number: int) -> Job:
        """One of them.

        Raises:
            Refusal: there is none of that number.
        """
        with self._come:
            if number in self._unsaved:
                return self._unsaved[number]
        rows = self._database.read("SELECT * FROM jobs WHERE id = ?", number)
        if not rows:
            raise Refusal(NOT_THERE, f"there is no job {number}")
        return _job(rows[0])

    def close(self) -> None:
        """Write what can be written, and end."""
        with self._come:
            self._closed = True
            self._come.notify()
        self._writer.join()

    def _write(self) -> None:
        said = ""
        while True:
            with self._come:
                self._come.wait_for(lambda: self._unsaved or self._closed)
                jobs, last = list(self._unsaved.values()), self._closed
            try:
                for job in jobs:
                    self._save(job)
                said = ""
            except sqlite3.Error as error:
                if str(error) != said:
                    said = str(error)
                    _LOG.warning("the logbook cannot be written now (%s): it is kept in memory", error)
                with self._come:
                    self._come.wait_for(lambda: self._closed, _AGAIN_S)
            if last:
                return

    def _save(self, job: Job) -> None:
        values = {**job.model_dump(), "work": job.work.model_dump_json()}
        names = ", ".join(values)
        changed = ", ".join(f"{name} = excluded.{name}" for name in values if name != "id")
        marks = ", ".join("?" for _ in values)
        self._database(
            f"INSERT INTO jobs ({names}) VALUES ({marks}) ON CONFLICT (id) DO UPDATE SET {changed}", *values.values()
        )
        with self._come:
            if self._unsaved.get(job.id) is job:
                del self._unsaved[job.id]


def _job(row: sqlite3.Row) -> Job:
    return Job(**{**dict(row), "work": WORK.validate_json(row["work"])})
