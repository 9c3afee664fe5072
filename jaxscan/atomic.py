"""Writing a file so that it is there whole or not at all: written beside its place, made durable, then renamed."""

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any, Literal

from jaxscan.errors import InputError

# What writing to a full or failing disk reports; any other error inside the block is the caller's own.
_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}

# How the names of files and folders end that are being written.
_UNFINISHED = ".part"


@contextlib.contextmanager
def replacing(
    path: str | os.PathLike[str], mode: Literal["w", "wb"] = "wb", *, durable: bool = True
) -> Iterator[IO[Any]]:
    """A file to write to, which takes the place of `path` when the block ends without an error.

    Until then it stands in the same folder under a hidden name of its own; after an error it is gone and whatever stood
    at `path` is untouched. A link stays, and what it leads to is replaced. Text is UTF-8 with plain newlines.

    Args:
        path: the file.
        mode: text or bytes.
        durable: whether it must survive a loss of power; a note that is made again need not, and costs less.

    Raises:
        InputError: as `check_writable`, or the disk is full.
    """
    target, file = _opened_beside(path, mode)
    beside = Path(file.name)
    try:
        with file:
            yield file
            file.flush()
            if durable:
                os.fsync(file.fileno())
        try:
            os.replace(beside, target)
        except OSError as error:
            raise _refusal(path, error) from error
        if durable:
            _sync(target.parent)
    except OSError as error:
        if error.errno in _DISK_ERRORS:
            raise _refusal(path, error) from error
        raise
    finally:
        beside.unlink(missing_ok=True)


def clear_unfinished(paths: Iterable[Path]) -> None:
    """Delete what `replacing` has left beside files whose process was killed; nobody may be writing them now."""
    names: dict[Path, set[str]] = {}
    for path in paths:
        names.setdefault(path.parent, set()).add(path.name)
    for folder, own in names.items():
        for left in folder.glob(f".*{_UNFINISHED}"):
            if left.name.removeprefix(".").removesuffix(_UNFINISHED).rpartition(".")[0] in own:
                with contextlib.suppress(OSError):
                    left.unlink()


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, where they are missing.

    Raises:
        InputError: the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}): choose another folder") from error


@contextlib.contextmanager
def replacing_folders(folder: Path) -> Iterator[Path]:
    """An empty folder, of which each inner folder takes the place of that of its name in `folder` when the block ends.

    Until then it is a hidden one inside `folder`; after an error it is gone, and so is `folder` where it was not there.

    Raises:
        InputError: the folder cannot be made.
    """
    made = not folder.exists()
    beside = folder / f".{secrets.token_hex(4)}{_UNFINISHED}"
    try:
        beside.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}): choose another folder") from error
    try:
        yield beside
        for inner in list(beside.iterdir()):
            if (folder / inner.name).exists():
                os.replace(folder / inner.name, beside / f"old-{inner.name}")
            os.replace(inner, folder / inner.name)
        made = False
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse a place that `replacing` could not write to, before the work that leads to it.

    It is tried, with an empty file beside the place: what the system says of permissions does not hold for root, nor
    for a disk that is mounted read-only or full. What stands at `path` is not touched.

    Raises:
        InputError: the folder is missing or closed to writing, the name is too long, or `path` is a folder, a device or
            anything else that is no plain file.
    """
    _, file = _opened_beside(path, "wb")
    file.close()
    os.unlink(file.name)


def _opened_beside(path: str | os.PathLike[str], mode: Literal["w", "wb"]) -> tuple[Path, IO[Any]]:
    """Where `path` leads, and an empty file in the same folder, under a hidden name of its own."""
    target = Path(os.path.realpath(path))
    beside = target.parent / f".{target.name}.{secrets.token_hex(4)}{_UNFINISHED}"
    try:
        if target.is_dir():
            raise InputError(f"{path}: cannot be written, it is a folder: name a file in it")
        if os.path.lexists(target) and not target.is_file():
            raise InputError(f"{path}: cannot be written, it is a device, a pipe or a broken link: name a plain file")
        if not target.parent.exists():
            raise InputError(f"{path}: cannot be written, there is no folder {Path(path).parent}: create it first")
        if not target.parent.is_dir():
            raise InputError(f"{path}: cannot be written, {Path(path).parent} is no folder: name a file in a folder")
        return target, beside.open("xb") if mode == "wb" else beside.open("x", encoding="utf-8", newline="\n")
    except OSError as error:
        raise _refusal(path, error) from error


def _sync(folder: Path) -> None:
    """Make the renaming itself survive a loss of power, where that can be."""
    with contextlib.suppress(OSError):
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def _refusal(path: str | os.PathLike[str], error: OSError) -> InputError:
    full = "make room, or choose another disk"
    fix = {
        errno.ENOSPC: full,
        errno.EDQUOT: full,
        errno.EFBIG: full,
        errno.EIO: "choose another disk",
        errno.ENAMETOOLONG: "choose a shorter name",
        errno.ENOENT: "nothing can be made in that folder: choose another",
    }.get(error.errno or 0, "choose a folder that you may write to")
    return InputError(f"{path}: cannot be written ({error.strerror or error}): {fix}")
