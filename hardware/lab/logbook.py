"""The logbook: every job there was, who ordered it and what became of it. It outlives the server."""

import sqlite3
import time
from typing import Final, Literal

from pydantic import BaseModel

from hardware.lab.database import Database
from hardware.lab.orders import WORK, Work
from hardware.lab.refusal import NOT_THERE, Refusal

State = Literal["running", "pausing", "paused", "done", "aborted", "failed", "interrupted"]
UNDER_WAY: Final = ("running", "pausing", "paused")
_MOST_LISTED: Final = 100


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
    """Jobs in the database."""

    def __init__(self, database: Database):
        self._database = database

    def begin(self, user: str, work: Work, total: int) -> Job:
        """Note a job that begins."""
        rows = self._database(
            "INSERT INTO jobs (user, work, state, taken, total, message, began_s) VALUES (?, ?, ?, 0, ?, '', ?) "
            "RETURNING *",
            user,
            work.model_dump_json(),
            "running",
            total,
            time.time(),
        )
        return _job(rows[0])

    def note(self, job: Job) -> None:
        """Note how far it is."""
        self._database(
            "UPDATE jobs SET user = ?, state = ?, taken = ?, message = ?, ended_s = ? WHERE id = ?",
            job.user,
            job.state,
            job.taken,
            job.message,
            job.ended_s,
            job.id,
        )

    def interrupted(self) -> None:
        """Note of every job that a server left under way that nobody goes on with it: at the start of the next one."""
        for row in self._database(f"SELECT * FROM jobs WHERE state IN {UNDER_WAY}"):
            job = _job(row)
            words = "the server ended while it ran"
            self.note(job.model_copy(update={"state": "interrupted", "message": words, "ended_s": time.time()}))

    def latest(self) -> list[Job]:
        """The last hundred, latest first."""
        return [_job(row) for row in self._database(f"SELECT * FROM jobs ORDER BY id DESC LIMIT {_MOST_LISTED}")]

    def one(self, number: int) -> Job:
        """One of them.

        Raises:
            Refusal: there is none of that number.
        """
        rows = self._database("SELECT * FROM jobs WHERE id = ?", number)
        if not rows:
            raise Refusal(NOT_THERE, f"there is no job {number}")
        return _job(rows[0])


def _job(row: sqlite3.Row) -> Job:
    return Job(**{**dict(row), "work": WORK.validate_json(row["work"])})
