"""Who may use the lab: people with passwords, their sessions in browsers, their tokens for programs.

Of session and token only a digest is kept, so the database opens no door to whoever reads it. They are random, of 256
bits, so a plain hash is enough; passwords are argon2id's.
"""

import hashlib
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

from hardware.lab.database import Database
from hardware.lab.refusal import NOT_THERE, SIGN_IN, Refusal
from hardware.lab.throttle import Throttle
from jaxscan.errors import InputError

NAME: Final = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$"
SHORTEST_PASSWORD, LONGEST_PASSWORD = 10, 1000
# A session ends so long after its last use, and at the latest so long after its beginning.
IDLE_S, LONGEST_S = 12 * 3600.0, 7 * 86400.0
# Last use is noted no more often than this.
_NOTED_S: Final = 60.0
# Each takes 64 MiB for as long as it takes.
_HASHES_AT_A_TIME: Final = 2


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
        self._hashing = threading.BoundedSemaphore(_HASHES_AT_A_TIME)

    @cached_property
    def _nobody(self) -> str:
        """What the password of somebody who is not there is compared with: it takes as long."""
        return self._hasher.hash(secrets.token_hex())

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
            raise InputError(f"{name}: is registered already: scanner user password {name} sets another one") from error

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

    def remove(self, name: str) -> None:
        """Remove somebody, and with the account its sessions and tokens.

        Raises:
            InputError: there is nobody of that name.
        """
        self._database("DELETE FROM users WHERE id = ?", self._user(name))

    def everybody(self) -> list[Account]:
        """All accounts, by name."""
        rows = self._database("SELECT name, administrator FROM users ORDER BY name COLLATE NOCASE")
        return [Account(row["name"], bool(row["administrator"])) for row in rows]

    def sign_in(self, name: str, password: str, address: str) -> str:
        """A new session, for a name and its password; it never goes on with one that was there before.

        Raises:
            Refusal: they are not right, or there were too many tries.
        """
        name, password = name[:LONGEST_PASSWORD], password[: LONGEST_PASSWORD + 1]
        self._throttle.admit(name, address)
        rows = self._database("SELECT id, hash FROM users WHERE name = ?", name)
        with self._hashing:
            try:
                right = self._hasher.verify(rows[0]["hash"] if rows else self._nobody, password)
            except (VerificationError, InvalidHashError):
                right = False
        if not rows or not right:
            raise Refusal(SIGN_IN, "name or password is wrong")
        self._throttle.forgive(name, address)
        token, now_s = secrets.token_urlsafe(32), self._now_s()
        with self._database.together():
            self._database("DELETE FROM sessions WHERE seen_s < ? OR created_s < ?", now_s - IDLE_S, now_s - LONGEST_S)
            self._database(
                "INSERT INTO sessions VALUES (?, ?, ?, ?, ?)",
                _digest(token),
                rows[0]["id"],
                secrets.token_urlsafe(32),
                now_s,
                now_s,
            )
        return token

    def of_session(self, token: str) -> Visitor | None:
        """Whose session this is, if it is one that has not ended."""
        rows = self._database(
            "SELECT users.*, digest, csrf, seen_s, sessions.created_s AS begun_s FROM sessions JOIN users "
            "ON users.id = sessions.user WHERE digest = ?",
            _digest(token),
        )
        if not rows:
            return None
        row, now_s = rows[0], self._now_s()
        if now_s - row["seen_s"] > IDLE_S or now_s - row["begun_s"] > LONGEST_S:
            return None
        if now_s - row["seen_s"] > _NOTED_S:
            self._database("UPDATE sessions SET seen_s = ? WHERE digest = ?", now_s, row["digest"])
        return Visitor(row["id"], row["name"], bool(row["administrator"]), _seat(row["digest"]), row["csrf"])

    def sign_out(self, token: str) -> None:
        """End a session."""
        self._database("DELETE FROM sessions WHERE digest = ?", _digest(token))

    def make_token(self, user: int, name: str) -> str:
        """A new token for a program; this is the only time that it is seen."""
        token = secrets.token_urlsafe(32)
        self._database(
            "INSERT INTO tokens (digest, user, name, created_s) VALUES (?, ?, ?, ?)",
            _digest(token),
            user,
            name,
            self._now_s(),
        )
        return token

    def make_token_for(self, name: str) -> str:
        """The same, for a name.

        Raises:
            InputError: there is nobody of that name.
        """
        return self.make_token(self._user(name), "scanner user token")

    def of_token(self, token: str) -> Visitor | None:
        """Whose token this is."""
        rows = self._database(
            "SELECT users.*, digest FROM tokens JOIN users ON users.id = tokens.user WHERE digest = ?", _digest(token)
        )
        if not rows:
            return None
        row = rows[0]
        return Visitor(row["id"], row["name"], bool(row["administrator"]), _seat(row["digest"]), None)

    def tokens(self, user: int) -> list[Token]:
        """The tokens of somebody, oldest first."""
        rows = self._database("SELECT id, name, created_s FROM tokens WHERE user = ? ORDER BY id", user)
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


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode("utf-8", "replace")).digest()


def _seat(digest: bytes) -> str:
    return hashlib.sha256(b"seat" + digest).hexdigest()[:16]
