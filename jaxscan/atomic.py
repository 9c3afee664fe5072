"""Writing a file so that it is there whole or not at all: written beside its place, made durable, then renamed."""

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Literal

from jaxscan.errors import InputError

# What writing to a full or failing disk reports; any other error inside the block is the caller's own.
_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str], mode: Literal["w", "wb"] = "wb") -> Iterator[IO[Any]]:
    """A file to write to, which takes the place of `path` when the block ends without an error.

    Until then it stands in the same folder under a hidden name of its own; after an error it is gone and whatever stood
    at `path` is untouched. Text is UTF-8 with plain newlines.

    Raises:
        InputError: the folder is missing or closed to writing, `path` is a folder, or the disk is full.
    """
    check_writable(path)
    target = Path(path)
    beside = target.parent / f".{target.name}.{secrets.token_hex(4)}.part"
    try:
        file = beside.open("xb") if mode == "wb" else beside.open("x", encoding="utf-8", newline="\n")
    except OSError as error:
        raise _refusal(target, error) from error
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        _rename(beside, target)
    except OSError as error:
        if error.errno in _DISK_ERRORS:
            raise _refusal(target, error) from error
        raise
    finally:
        beside.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse a place that `replacing` could not write to, before the work that leads to it.

    Raises:
        InputError: the folder is missing or closed to writing, or `path` is a folder.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: cannot be written, it is a folder: name a file in it")
    if not target.parent.is_dir():
        raise InputError(f"{target}: cannot be written, there is no folder {target.parent}: create it first")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{target}: cannot be written: choose a folder that you may write to")


def _rename(beside: Path, target: Path) -> None:
    """Put the finished file in its place, and make the renaming itself survive a loss of power where that can be."""
    try:
        os.replace(beside, target)
    except OSError as error:
        raise _refusal(target, error) from error
    with contextlib.suppress(OSError):
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _refusal(target: Path, error: OSError) -> InputError:
    mend = {
        errno.EACCES: "choose a folder that you may write to",
        errno.EPERM: "choose a folder that you may write to",
        errno.EROFS: "choose a folder that you may write to",
        errno.ENAMETOOLONG: "choose a shorter name",
    }.get(error.errno or 0, "make room, or choose another disk")
    return InputError(f"{target}: cannot be written ({error.strerror or error}): {mend}")
