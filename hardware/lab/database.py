"""The lab's one SQLite database: accounts, sessions, tokens, failed sign-ins, and the logbook of jobs."""

import os
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from jaxscan.errors import InputError

DATABASE: Final = "lab.sqlite3"
_VERSION: Final = 1
# How long a writer waits for another process's.
_WAIT_S: Final = 2.0
_SCHEMA: Final = """
CREATE TABLE users (
  id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE COLLATE NOCASE, hash TEXT NOT NULL,
  administrator INTEGER NOT NULL, created_s REAL NOT NULL);
CREATE TABLE sessions (
  digest BLOB PRIMARY KEY, user INTEGER NOT NULL REFERENCES users ON DELETE CASCADE, csrf TEXT NOT NULL,
  created_s REAL NOT NULL, seen_s REAL NOT NULL);
CREATE TABLE tokens (
  id INTEGER PRIMARY KEY AUTOINCREMENT, digest BLOB NOT NULL UNIQUE,
  user INTEGER NOT NULL REFERENCES users ON DELETE CASCADE, name TEXT NOT NULL, created_s REAL NOT NULL);
CREATE TABLE attempts (key TEXT NOT NULL, time_s REAL NOT NULL);
CREATE INDEX attempts_by_key ON attempts (key, time_s);
CREATE TABLE jobs (
  id INTEGER PRIMARY KEY AUTOINCREMENT, user TEXT NOT NULL, work TEXT NOT NULL, state TEXT NOT NULL,
  taken INTEGER NOT NULL, total INTEGER NOT NULL, message TEXT NOT NULL, began_s REAL NOT NULL, ended_s REAL);
"""


class Database:
    """A connection to write and one to read, which all threads share.

    Each statement is a transaction of its own unless `together` is used. A writer may have to wait for another
    process's; readers wait for none.

    Raises:
        InputError: the file cannot be opened, or is not the lab's.
    """

    def __init__(self, path: Path):
        self._mutex, self._reading = threading.RLock(), threading.Lock()
        try:
            # Hashes of passwords: for the eyes of the lab's own user alone.
            os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
            self._connection = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False)
            self._connection.row_factory = sqlite3.Row
            self("PRAGMA journal_mode = WAL")
            self("PRAGMA synchronous = NORMAL")
            self("PRAGMA foreign_keys = ON")
            with self.together():
                version = self("PRAGMA user_version")[0][0]
                if version == 0:
                    for statement in _SCHEMA.split(";\n"):
                        self(statement)
                    self(f"PRAGMA user_version = {_VERSION}")
            self._reader = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False)
            self._reader.row_factory = sqlite3.Row
        except (OSError, sqlite3.Error) as error:
            raise InputError(f"{path}: cannot be opened as the lab's database ({error}): choose another --data") from (
                error
            )
        if version not in (0, _VERSION):
            raise InputError(f"{path}: is of version {version}, and this program knows {_VERSION}: use the newer one")

    def __call__(self, sql: str, *values: Any) -> list[sqlite3.Row]:
        """Run one statement; its rows."""
        with self._mutex:
            return self._connection.execute(sql, values).fetchall()

    def read(self, sql: str, *values: Any) -> list[sqlite3.Row]:
        """The rows of a statement that changes nothing, without waiting for writers."""
        with self._reading:
            return self._reader.execute(sql, values).fetchall()

    @contextmanager
    def together(self) -> Iterator[None]:
        """Statements that are done all or none, and between which no other writer comes."""
        with self._mutex:
            self("BEGIN IMMEDIATE")
            try:
                yield
                self("COMMIT")
            except BaseException:
                # A full disk ends the transaction by itself.
                if self._connection.in_transaction:
                    self("ROLLBACK")
                raise

    def close(self) -> None:
        """Disconnect."""
        with self._mutex:
            self._connection.close()
        with self._reading:
            self._reader.close()


class OnlyServer:
    """One server to a data folder: two would be two operators. Held until it is closed, or its process is gone.

    Raises:
        InputError: another one runs.
    """

    def __init__(self, path: Path):
        self._connection = sqlite3.connect(path, timeout=0, isolation_level=None, check_same_thread=False)
        try:
            self._connection.execute("BEGIN EXCLUSIVE")
        except sqlite3.Error as error:
            self._connection.close()
            raise InputError(
                f"{path.parent}: another lab server runs on this folder ({error}): end it, or choose another --data"
            ) from error

    def close(self) -> None:
        """Let another one run."""
        self._connection.close()


def make_folder(folder: Path) -> None:
    """Make the lab's folder, for the eyes of its user alone.

    Raises:
        InputError: it cannot be made.
    """
    try:
        make_private(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}): choose another --data") from error


def make_private(folder: Path) -> None:
    """Make a folder for the eyes of its user alone; one that is there already keeps the mode that it has.

    Raises:
        OSError: it cannot be made.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
