"""One process at a time: a lock on a file that says who holds it, and that ends with its process, however that ends."""

import contextlib
import errno
import json
import os
import socket
import sys
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Final

from jaxscan.errors import InputError

# What a file system without locks answers.
_NO_LOCKS: Final = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}
# Who holds it is written in less than this; on Windows, where locked bytes cannot be read, the byte behind is locked.
_LONGEST: Final = 4096
_LONGEST_COMMAND: Final = 200


class InUseError(InputError):
    """Another process has it; the text says which."""


@contextlib.contextmanager
def exclusive(file: Path, what: str) -> Iterator[None]:
    """Hold something for this block alone.

    The lock is the system's, on a file that stands there meanwhile: of a process that was killed, the next one takes it
    over. Where the file system has no locks, nothing is held.

    Args:
        file: where the lock is to stand, in a folder that exists.
        what: what is held, as errors begin: a folder or a port.

    Raises:
        InUseError: another process has it, or another thread of this one.
        InputError: the file cannot be made.
    """
    try:
        opened = _opened(file, what)
    except OSError as error:
        raise InputError(
            f"{what}: its lock {file} cannot be made ({error.strerror or error}): choose a place that you may write to"
        ) from error
    try:
        yield
    finally:
        # It goes while it is still locked: whoever opened it meanwhile finds that it is no longer the one in its place.
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
        os.close(opened)


def _opened(file: Path, what: str) -> int:
    """The file, locked."""
    while True:
        opened = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            if not _locked(opened):
                raise InUseError(f"{what}: is in use by {_holder(opened)}: wait until that has ended, or end it")
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(opened), os.stat(file)):
                    _sign(opened)
                    return opened
        except BaseException:
            os.close(opened)
            raise
        os.close(opened)


def _locked(opened: int) -> bool:
    """Lock a file; whether nobody else had."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(opened, _LONGEST, os.SEEK_SET)
            msvcrt.locking(opened, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        if error.errno not in _NO_LOCKS:
            raise
    return True


def _sign(opened: int) -> None:
    """Write down who holds it."""
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:_LONGEST_COMMAND]
    holder = {
        "process": os.getpid(),
        "machine": socket.gethostname(),
        "command": command,
        "since": datetime.now().astimezone().isoformat(" ", "seconds"),
    }
    os.ftruncate(opened, 0)
    os.lseek(opened, 0, os.SEEK_SET)
    os.write(opened, json.dumps(holder).encode())


def _holder(opened: int) -> str:
    """Who holds it, in words."""
    os.lseek(opened, 0, os.SEEK_SET)
    try:
        holder = json.loads(os.read(opened, _LONGEST))
        return "process {process} on {machine} ({command}), since {since}".format(**holder)
    except (ValueError, KeyError, TypeError, OSError):
        # It was locked this moment, and is not signed yet.
        return "another process"
