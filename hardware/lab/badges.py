"""Whose session or token it is that comes with a request: known in memory, so that no answer waits for the disk.

The database keeps what is here for the next start. Another process (`scanner user`) may change it meanwhile: `tend`
sees that within a second.
"""

import hashlib
import logging
import sqlite3
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from hardware.lab.database import Database

# A session ends so long after its last use, and at the latest so long after its beginning.
IDLE_S, LONGEST_S = 12 * 3600.0, 7 * 86400.0
# Last use is noted no more often than this.
_NOTED_S: Final = 60.0
_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True)
class Visitor:
    """Whoever asks for something.

    Attributes:
        user: number of the account.
        name: its name.
        administrator: whether it is one.
        seat: names the session or the token without giving it away; what the operator's lock is held by.
        csrf: what a page of this session sends with whatever changes something; None for a token.
    """

    user: int
    name: str
    administrator: bool
    seat: str
    csrf: str | None


@dataclass
class _Badge:
    visitor: Visitor
    begun_s: float = 0.0
    seen_s: float = 0.0
    noted_s: float = 0.0
    # Whether the database has it.
    kept: bool = True


class Badges:
    """All sessions and tokens that are valid.

    Args:
        database: where they are kept.
        now_s: seconds since the epoch.
    """

    def __init__(self, database: Database, now_s: Callable[[], float]):
        self._database, self._now_s = database, now_s
        # Held for a few assignments, never while the disk is asked.
        self._mutex = threading.Lock()
        self._loading = threading.Lock()
        self._sessions: dict[bytes, _Badge] = {}
        self._tokens: dict[bytes, _Badge] = {}
        self._changes = 0
        self._version = -1
        self.load()

    def load(self) -> None:
        """Read them all."""
        with self._loading:
            while not self._loaded():
                pass

    def _loaded(self) -> bool:
        """Read them all; False where one came or went meanwhile."""
        changes = self._changes
        users = {row["id"] for row in self._database.read("SELECT id FROM users")}
        sessions = self._database.read(
            "SELECT users.*, digest, csrf, sessions.created_s AS begun_s, seen_s FROM sessions JOIN users "
            "ON users.id = sessions.user"
        )
        tokens = self._database.read("SELECT users.*, digest FROM tokens JOIN users ON users.id = tokens.user")
        with self._mutex:
            if changes != self._changes:
                return False
            found = {key: one for key, one in self._sessions.items() if not one.kept and one.visitor.user in users}
            for row in sessions:
                before = self._sessions.get(row["digest"])
                seen_s = max(row["seen_s"], before.seen_s if before else 0.0)
                found[row["digest"]] = _Badge(_visitor(row, row["csrf"]), row["begun_s"], seen_s, row["seen_s"])
            self._sessions = found
            self._tokens = {row["digest"]: _Badge(_visitor(row, None)) for row in tokens}
        return True

    def tend(self) -> None:
        """See what another process has changed, and keep when sessions were last used; to be called every second."""
        try:
            version = self._database.read("PRAGMA data_version")[0][0]
            if version != self._version:
                self.load()
                self._version = version
            for key, badge in list(self._sessions.items()):
                if badge.kept and badge.seen_s - badge.noted_s > _NOTED_S:
                    self._database("UPDATE sessions SET seen_s = ? WHERE digest = ?", badge.seen_s, key)
                    badge.noted_s = badge.seen_s
        except sqlite3.Error as error:
            _LOG.warning("sessions cannot be kept now: %s", error)

    def of_session(self, token: str) -> Visitor | None:
        """Whose session this is, if it is one that has not ended."""
        badge, now_s = self._sessions.get(digest(token)), self._now_s()
        if badge is None:
            return None
        # A clock that was set back lengthens no session by more than it has.
        badge.begun_s, badge.seen_s, badge.noted_s = (
            min(time_s, now_s) for time_s in (badge.begun_s, badge.seen_s, badge.noted_s)
        )
        if now_s - badge.seen_s > IDLE_S or now_s - badge.begun_s > LONGEST_S:
            return None
        badge.seen_s = now_s
        return badge.visitor

    def of_token(self, token: str) -> Visitor | None:
        """Whose token this is."""
        badge = self._tokens.get(digest(token))
        return None if badge is None else badge.visitor

    def begin(self, token: str, visitor: Visitor) -> None:
        """Know a session, which the database does not have yet."""
        now_s = self._now_s()
        with self._mutex:
            self._changes += 1
            self._sessions[digest(token)] = _Badge(visitor, now_s, now_s, now_s, kept=False)

    def kept(self, token: str) -> None:
        """The database has it."""
        with self._mutex:
            self._changes += 1
            if (badge := self._sessions.get(digest(token))) is not None:
                badge.kept = True

    def end(self, token: str = "", user: int | None = None) -> None:
        """Know a session no more, or those of an account."""
        with self._mutex:
            self._changes += 1
            self._sessions.pop(digest(token), None)
            for key in [key for key, one in self._sessions.items() if one.visitor.user == user]:
                del self._sessions[key]


def digest(token: str) -> bytes:
    """What is kept of a token: it opens no door to whoever reads it."""
    return hashlib.sha256(token.encode("utf-8", "replace")).digest()


def seat(of: bytes) -> str:
    """The name of a seat from its token's digest."""
    return hashlib.sha256(b"seat" + of).hexdigest()[:16]


def _visitor(row: sqlite3.Row, csrf: str | None) -> Visitor:
    return Visitor(row["id"], row["name"], bool(row["administrator"]), seat(row["digest"]), csrf)
