"""Many scans: each by itself, on this machine or on a cluster, its points in a file of its own.

A result is kept as long as its record says that scan, rig and options are what it was made from, so that what was
interrupted continues with what is missing. A scan that fails is reported, and the others continue.

A cluster runs a task again whose worker is lost before its answer was fetched. The record then says that this very
batch has made the result.
"""

import copy
import os
import secrets
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from typing import Any, Final

from jaxscan.atomic import clear_unfinished, make_folder
from jaxscan.deadline import patience_s
from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError, JaxscanError
from jaxscan.exclusive import exclusive
from jaxscan.extras import extra
from jaxscan.files.cloud import read_ply
from jaxscan.files.digest import short_digest
from jaxscan.files.listing import natural_key
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import SCAN_FILE, read_listed, read_scan
from jaxscan.reconstruction.range_image import read_range_image
from jaxscan.reconstruction.reconstruct import write_stream
from jaxscan.reconstruction.records import Record, digest_of, read_record, record_path
from jaxscan.reconstruction.stream import Scanner

# How long a scheduler may take to answer, and how many workers may die of one scan before it is given up.
_ANSWER_S: Final = 15
_DEATHS: Final = 3
# How many scans are measured at once on a machine at most: while one waits for its photographs, others are measured.
# Each has its own ring of photographs in memory.
_SCANS_AT_ONCE: Final = 4
# The lock of the batch that is at work in a folder.
_LOCK: Final = ".batch.lock"
# How often it is looked whether a cluster still has workers, s.
_LOOK_S: Final = 2.0


@dataclass(frozen=True)
class Options:
    """How the scans of a batch are reconstructed.

    Attributes:
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.
        depths_mm: nearest and farthest depth at which there can be a stripe, as `Scanner` has it.
    """

    detector: Detector = DEFAULT
    choice: Choice = DEFAULT_CHOICE
    depths_mm: tuple[float, float] | None = None

    def in_json(self) -> dict[str, Any]:
        """As a record has them."""
        return asdict(self) | {"depths_mm": None if self.depths_mm is None else list(self.depths_mm)}


@dataclass(frozen=True)
class Task:
    """One scan of many.

    Attributes:
        name: its folder, as seen from the tree's top.
        scan: its scan.toml.
        output: where its points belong.
    """

    name: str
    scan: Path
    output: Path

    def done(self, rig: str, options: "Options") -> Record | None:
        """The record of its result, where that was made from what there is now; None where it must be made.

        Args:
            rig: digest of the rig's file.
            options: how.
        """
        record = read_record(self.output)
        if record is None or (record.rig, record.options) != (rig, options.in_json()) or not record.is_of(self.output):
            return None
        try:
            return record if record.made_from == digest_of(read_listed(self.scan)) else None
        except (InputError, OSError):
            return None


@dataclass(frozen=True)
class Outcome:
    """What came of a scan.

    Attributes:
        task: which.
        record: of its result; None where it failed.
        reason: why it failed, or "".
    """

    task: Task
    record: Record | None
    reason: str = ""


@dataclass(frozen=True)
class Tree:
    """The scans of a tree.

    Attributes:
        tasks: in natural order.
        refused: names of folders that may hold scans and cannot be read, and why.
    """

    tasks: tuple[Task, ...]
    refused: tuple[tuple[str, str], ...]


def find_tasks(scans: Path, out: Path, ending: str = ".ply") -> Tree:
    """Every scan of a tree, with the file its points belong to: OUT/FOLDER.ply.

    Raises:
        InputError: the tree is no folder, holds no scan, or two of its scans would be written to one file.
    """
    if not scans.is_dir():
        raise InputError(f"{scans}: is not a folder: name the folder with the scans")
    refused: list[tuple[str, str]] = []

    def unreadable(error: OSError) -> None:
        place = str(error.filename)
        refused.append((in_text(os.path.relpath(place, scans)), f"{in_text(place)}: cannot be read ({error.strerror})"))

    # A result's folder may lie in the tree of the scans, and is not searched.
    found = [folder for folder, files in _folders(scans, os.path.realpath(out), unreadable) if SCAN_FILE in files]
    if not found and not refused:
        raise InputError(f"{scans}: holds no scan, no {SCAN_FILE} in it or in a folder below: check the path")
    tasks: list[Task] = []
    taken: dict[str, Task] = {}
    for folder in sorted(found, key=lambda path: natural_key(str(path))):
        relative = folder.relative_to(scans)
        name = relative.as_posix() if relative.parts else Path(os.path.realpath(folder)).name
        if in_text(name) != name:
            refused.append((in_text(name), f"{in_text(str(folder))}: its name is no text (UTF-8): rename the folder"))
            continue
        task = Task(name, folder / SCAN_FILE, out / f"{name}{ending}")
        if not task.scan.is_file():
            refused.append((name, f"{task.scan}: is no plain file, or a link to none: copy it there again"))
            continue
        # Many disks take names for the same that differ in capitals alone.
        other = taken.setdefault(str(task.output).casefold(), task)
        if other is not task:
            raise InputError(
                f"{task.scan.parent} and {other.scan.parent} would both be written to {task.output}: rename one folder"
            )
        tasks.append(task)
    return Tree(tuple(tasks), tuple(refused))


def in_text(name: str) -> str:
    """A file's name as it can be printed: what is no text in it as numbers."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


def _folders(top: Path, skipped: str, unreadable: Callable[[OSError], None]) -> Iterator[tuple[Path, list[str]]]:
    """The folders of a tree with their files, links followed; each once, by its own name rather than by a link's."""
    seen, to_see = {skipped}, [str(top)]
    while to_see:
        for folder, inner, files in os.walk(to_see.pop(0), onerror=unreadable):
            place = os.path.realpath(folder)
            if place in seen:
                inner.clear()
                continue
            seen.add(place)
            to_see += [link for name in inner if os.path.islink(link := os.path.join(folder, name))]
            yield Path(folder), files


@contextmanager
def held(out: Path) -> Iterator[None]:
    """Hold the folder of a batch's results while it is at work; it is made where it is not there.

    Raises:
        InUseError: another batch is at work there.
        InputError: the folder cannot be made or written to.
    """
    make_folder(out)
    with exclusive(out / _LOCK, str(out)):
        yield


def run_batch(
    tasks: Sequence[Task],
    rig: Path,
    options: Options | None = None,
    scheduler: str | None = None,
    at_work: set[str] | None = None,
) -> Iterator[Outcome]:
    """Reconstruct many scans; each outcome as it is there.

    Args:
        tasks: as `find_tasks` gives them, without those that are done.
        rig: of all of them.
        options: how; the defaults where there are none.
        scheduler: address of a Dask scheduler whose workers see the same files; None for this machine.
        at_work: holds the names of the scans that are being read on this machine.

    Raises:
        InputError: the rig is refused, the scheduler does not answer, or it has no workers for too long.
    """
    options, run = options or Options(), secrets.token_hex(8)
    names = set[str]() if at_work is None else at_work
    read_rig(rig)
    for folder in {task.output.parent for task in tasks}:
        make_folder(folder)
    stop = Event()

    def here(task: Task) -> Record | str:
        names.add(task.name)
        try:
            return reconstruct_one(task, rig.absolute(), run, options, heed)
        finally:
            names.discard(task.name)

    def heed(by: int) -> None:
        """Break off a scan of a batch that was stopped; what it has written so far is deleted."""
        if stop.is_set():
            raise InterruptedError("the batch was stopped")

    with _executor(scheduler) as (executor, has_workers):
        if scheduler is None:
            clear_unfinished(path for task in tasks for path in (task.output, record_path(task.output)))
        futures: dict[Future[Record | str], Task] = {}
        for task in tasks:
            absolute = replace(task, scan=task.scan.absolute(), output=task.output.absolute())
            # A worker on another machine hears of nothing until its scan is done.
            if scheduler is None:
                future = executor.submit(here, absolute)
            else:
                future = executor.submit(reconstruct_one, absolute, rig.absolute(), run, options)
            futures[future] = task
        # To wait for whichever of all is next would cost with each as much as there are.
        done: SimpleQueue[Future[Record | str]] = SimpleQueue()
        for future in futures:
            future.add_done_callback(done.put)
        try:
            left, seen = len(futures), time.monotonic()
            while left:
                try:
                    future = done.get(timeout=_LOOK_S)
                except Empty:
                    if has_workers():
                        seen = time.monotonic()
                    elif time.monotonic() - seen > patience_s():
                        raise InputError(
                            f"{scheduler}: has had no worker for {patience_s():g} s, and {left} scans wait: start one "
                            f"with dask worker {scheduler}, then run the same command again"
                        ) from None
                else:
                    yield _outcome(futures[future], future)
                    left, seen = left - 1, time.monotonic()
        finally:
            stop.set()
            for future in futures:
                future.cancel()


def reconstruct_one(
    task: Task, rig: Path, run: str, options: Options, advance: Callable[[int], object] = lambda by: None
) -> Record | str:
    """One scan to one file, on whatever machine.

    Args:
        task: with absolute paths.
        rig: likewise.
        run: which batch this is. What it has made already is not made a second time.
        options: how.
        advance: called with the number of photographs read, some at a time; what it raises ends the scan.

    Returns:
        The record of its file; or, in words, why there is none.
    """
    try:
        before = read_record(task.output)
        if before is not None and before.run == run and before.is_of(task.output):
            return before if before.points is not None else replace(before, points=_points_in(task.output))
        begin, scan, digest = time.monotonic(), read_scan(task.scan), short_digest(rig)
        record = Record(
            scan=task.name,
            made_from=digest_of(scan),
            rig=digest,
            options=options.in_json(),
            version=_version(),
            run=run,
            began=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        record.write(task.output)
        # What it says of its scan is not said of another that is measured beside it.
        scanner = copy.copy(_scanner(rig, digest, options))
        written = write_stream([task.output], scanner.scan(scan, advance), lambda: scanner.notes)
        record = replace(
            record,
            size=task.output.stat().st_size,
            points=written.points,
            frames=written.frames,
            empty=written.empty,
            seconds=round(time.monotonic() - begin, 2),
            notes=tuple(scanner.notes),
        )
        record.write(task.output)
        return record
    except JaxscanError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - what is wrong with one scan must not stop the others
        return f"{task.scan}: unexpected error: {type(error).__name__}: {error}"


@cache
def _version() -> str:
    return version("jaxscan")


def _points_in(path: Path) -> int:
    return len(read_ply(path).points) if path.suffix == ".ply" else int(read_range_image(path).valid.sum())


@lru_cache(maxsize=4)
def _scanner(rig: Path, digest: str, options: Options) -> Scanner:
    """Made ready once in each process, and again when the rig's file has another digest."""
    return Scanner(
        read_rig(rig),
        options.detector,
        options.choice,
        depths_mm=options.depths_mm,
        decoders=_decoders(),
        at_once=1,  # several scans are measured together already
    )


def _scans_at_once() -> int:
    return min(os.cpu_count() or 1, _SCANS_AT_ONCE)


def _decoders() -> int:
    """How many threads decode for each scan, so that a machine has no more than two threads for each of its cores."""
    at_once = _scans_at_once()
    if (distributed := sys.modules.get("distributed")) is not None:
        # No worker of Dask's, no answer.
        with suppress(ValueError):
            at_once = distributed.get_worker().state.nthreads
    return max(1, 2 * (os.cpu_count() or 1) // at_once - 1)


def _outcome(task: Task, future: "Future[Record | str]") -> Outcome:
    try:
        result = future.result()
    except CancelledError:
        return Outcome(task, None, f"{task.scan}: the scheduler went away before it was done")
    except Exception as error:  # noqa: BLE001 - what a cluster says of a worker
        return Outcome(task, None, f"{task.scan}: {type(error).__name__}: {error}")
    return Outcome(task, None, result) if isinstance(result, str) else Outcome(task, result)


@contextmanager
def _executor(scheduler: str | None) -> Iterator[tuple[Executor, Callable[[], bool]]]:
    """Where the scans are reconstructed, and what says whether there is anybody who does."""
    if scheduler is None:
        with ThreadPoolExecutor(_scans_at_once()) as pool:
            yield pool, lambda: True
        return
    distributed = extra("cluster")
    from dask.config import set as dask_settings

    with dask_settings({"distributed.comm.timeouts.connect": _ANSWER_S}):
        try:
            client: Any = distributed.Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"{scheduler}: no Dask scheduler answers within {_ANSWER_S} s ({error}): start one with dask "
                "scheduler, and give the address that it prints"
            ) from error
    with client, client.get_executor(pure=False, retries=_DEATHS) as executor:
        yield executor, lambda: bool(client.scheduler_info(n_workers=-1)["workers"])
