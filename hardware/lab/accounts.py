"""Who may use the lab: people with passwords, their sessions in browsers, their tokens for programs.

Of session and token only a digest is kept, so the database opens no door to whoever reads it. They are random, of 256
bits, so a plain hash is enough; passwords are argon2id's.
"""

import hmac
import logging
import re
import secrets
import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from hardware.lab.badges import IDLE_S, LONGEST_S, Badges, Visitor, digest, seat
from hardware.lab.database import Database
from hardware.lab.refusal import NOT_THERE, SIGN_IN, Refusal
from hardware.lab.throttle import Throttle
from jaxscan.errors import InputError

NAME: Final = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$"
SHORTEST_PASSWORD, LONGEST_PASSWORD = 10, 1000
# Each takes 64 MiB for as long as it takes.
HASHES_AT_A_TIME: Final = 2
# Sessions of one account; with one more the oldest ends.
_MOST_SESSIONS: Final = 50
_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True)
class Account:
    """A person, as the list of them shows."""

    name: str
    administrator: bool


@dataclass(frozen=True)
class Token:
    """A token, as the list of them shows."""

    id: int
    name: str
    created_s: float


class Accounts:
    """People, sessions and tokens."""

    def __init__(self, database: Database, now_s: Callable[[], float] = time.time):
        self._database, self._now_s = database, now_s
        self._throttle = Throttle(database, now_s)
        self._hasher = PasswordHasher()
        self._hashing = threading.BoundedSemaphore(HASHES_AT_A_TIME)
        self.badges = Badges(database, now_s)

    @cached_property
    def _nobody(self) -> str:
        """What the password of somebody who is not there is compared with: it takes as long."""
        return self._hasher.hash(secrets.token_hex())

    def check_free(self, name: str) -> None:
        """Refuse a name that somebody has, in whatever capitals.

        Raises:
            InputError: the name is taken.
        """
        if self._database.read("SELECT id FROM users WHERE name = ?", name):
            raise _taken(name)

    def check_known(self, name: str) -> None:
        """Refuse a name that nobody has.

        Raises:
            InputError: there is nobody of that name.
        """
        self._user(name)

    def add(self, name: str, password: str, administrator: bool = False) -> None:
        """Register somebody.

        Raises:
            InputError: the name is taken or none, or the password too short.
        """
        if not re.fullmatch(NAME, name):
            raise InputError(f"{name!r}: a name is up to 32 letters, digits, . _ and -, a letter or digit first")
        hashed = self._hash(password)
        try:
            self._database(
                "INSERT INTO users (name, hash, administrator, created_s) VALUES (?, ?, ?, ?)",
                name,
                hashed,
                administrator,
                self._now_s(),
            )
        except sqlite3.IntegrityError as error:
            raise _taken(name) from error

    def set_password(self, name: str, password: str) -> None:
        """Give somebody another password; sessions and tokens that there are end.

        Raises:
            InputError: there is nobody of that name, or the password is too short.
        """
        hashed = self._hash(password)
        with self._database.together():
            user = self._user(name)
            self._database("UPDATE users SET hash = ? WHERE id = ?", hashed, user)
            self._database("DELETE FROM sessions WHERE user = ?", user)
            self._database("DELETE FROM tokens WHERE user = ?", user)
        self.badges.end(user=user)
        self.badges.load()

    def remove(self, name: str) -> None:
        """Remove somebody, and with the account its sessions and tokens.

        Raises:
            InputError: there is nobody of that name.
        """
        self._database("DELETE FROM users WHERE id = ?", self._user(name))
        self.badges.load()

    def everybody(self) -> list[Account]:
        """All accounts, by name."""
        rows = self._database.read("SELECT name, administrator FROM users ORDER BY name COLLATE NOCASE")
        return [Account(row["name"], bool(row["administrator"])) for row in rows]

    def sign_in(self, name: str, password: str, address: str, browser: str = "") -> str:
        """A new session, for a name and its password; it never continues an earlier one.

        Args:
            name: of the account.
            password: its.
            address: from which it is tried.
            browser: what `know_browser` gave it; wrong tries elsewhere do not count for such a one.

        Raises:
            Refusal: they are not right, or there were too many tries.
        """
        name, password = name[:LONGEST_PASSWORD], password[: LONGEST_PASSWORD + 1]
        known = self._known(name, browser)
        self._throttle.admit(name, address, known)
        rows = self._database.read("SELECT * FROM users WHERE name = ?", name)
        with self._hashing:
            try:
                right = self._hasher.verify(rows[0]["hash"] if rows else self._nobody, password)
            except (VerificationError, InvalidHashError):
                right = False
        if not rows or not right:
            raise Refusal(SIGN_IN, "name or password is wrong")
        self._throttle.forgive(name, address, known)
        token, row = secrets.token_urlsafe(32), rows[0]
        csrf = secrets.token_urlsafe(32)
        visitor = Visitor(row["id"], row["name"], bool(row["administrator"]), seat(digest(token)), csrf)
        self.badges.begin(token, visitor)
        try:
            self._keep_session(token, visitor)
            self.badges.kept(token)
        except sqlite3.Error as error:
            _LOG.warning("a session of %s cannot be kept (%s): it ends with the server", visitor.name, error)
        return token

    def _keep_session(self, token: str, visitor: Visitor) -> None:
        now_s = self._now_s()
        with self._database.together():
            self._database("DELETE FROM sessions WHERE seen_s < ? OR created_s < ?", now_s - IDLE_S, now_s - LONGEST_S)
            self._database(
                "INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", digest(token), visitor.user, visitor.csrf, now_s, now_s
            )
            oldest = self._database(
                "DELETE FROM sessions WHERE user = ? AND digest NOT IN "
                "(SELECT digest FROM sessions WHERE user = ? ORDER BY created_s DESC, rowid DESC LIMIT ?) RETURNING 1",
                visitor.user,
                visitor.user,
                _MOST_SESSIONS,
            )
        if oldest:
            self.badges.load()

    def know_browser(self, name: str) -> str:
        """What a browser brings back to show that this account has signed in with it; a new password ends it."""
        mark = secrets.token_urlsafe(16)
        return f"{mark}.{self._sign(name, mark)}"

    def _known(self, name: str, browser: str) -> str:
        """Which known browser this is; "" for any other."""
        mark, _, signed = browser.partition(".")
        right = self._sign(name, mark) if mark and signed else ""
        return mark if right and hmac.compare_digest(signed.encode("utf-8", "replace"), right.encode()) else ""

    def _sign(self, name: str, mark: str) -> str:
        rows = self._database.read("SELECT hash FROM users WHERE name = ?", name)
        key = rows[0]["hash"] if rows else secrets.token_hex()
        return hmac.new(key.encode(), b"browser " + mark.encode("utf-8", "replace"), "sha256").hexdigest()

    def of_session(self, token: str) -> Visitor | None:
        """Whose session this is, if it is one that has not ended."""
        return self.badges.of_session(token)

    def sign_out(self, token: str) -> None:
        """End a session."""
        self.badges.end(token)
        try:
            self._database("DELETE FROM sessions WHERE digest = ?", digest(token))
        except sqlite3.Error as error:
            _LOG.warning("a session that has ended cannot be removed from the database (%s)", error)

    def make_token(self, user: int, name: str) -> str:
        """A new token for a program; this is the only time that it is seen."""
        token = secrets.token_urlsafe(32)
        self._database(
            "INSERT INTO tokens (digest, user, name, created_s) VALUES (?, ?, ?, ?)",
            digest(token),
            user,
            name,
            self._now_s(),
        )
        self.badges.load()
        return token

    def make_token_for(self, name: str) -> str:
        """The same, for a name.

        Raises:
            InputError: there is nobody of that name.
        """
        return self.make_token(self._user(name), "scanner user token")

    def of_token(self, token: str) -> Visitor | None:
        """Whose token this is; one that another process has just made is looked for."""
        if (found := self.badges.of_token(token)) is not None:
            return found
        if self._database.read("SELECT 1 FROM tokens WHERE digest = ?", digest(token)):
            self.badges.load()
        return self.badges.of_token(token)

    def tokens(self, user: int) -> list[Token]:
        """The tokens of somebody, oldest first."""
        rows = self._database.read("SELECT id, name, created_s FROM tokens WHERE user = ? ORDER BY id", user)
        return [Token(*row) for row in rows]

    def drop_token(self, user: int, token: int) -> None:
        """End one.

        Raises:
            Refusal: there is none of that number, or it is somebody else's.
        """
        with self._database.together():
            if not self._database("SELECT 1 FROM tokens WHERE id = ? AND user = ?", token, user):
                raise Refusal(NOT_THERE, f"you have no token {token}")
            self._database("DELETE FROM tokens WHERE id = ?", token)
        self.badges.load()

    def _user(self, name: str) -> int:
        rows = self._database("SELECT id FROM users WHERE name = ?", name)
        if not rows:
            raise InputError(f"{name}: nobody of that name is registered: scanner user list shows who is")
        return rows[0]["id"]

    def _hash(self, password: str) -> str:
        if not SHORTEST_PASSWORD <= len(password) <= LONGEST_PASSWORD:
            raise InputError(f"a password has {SHORTEST_PASSWORD} to {LONGEST_PASSWORD} characters")
        with self._hashing:
            return self._hasher.hash(password)


def _taken(name: str) -> InputError:
    return InputError(f"{name}: is registered already: scanner user password {name} sets another one")
