"""Many scans: each by itself, on this machine or on a cluster, its points in a file of its own.

A result that is younger than its scan.toml, the rig and the options is kept, as `make` would, so that what was
interrupted continues with what is missing. A scan that fails is reported, and the others continue.

A cluster runs a task again whose worker is lost before its answer was fetched. Such a task asks the same question once
more: a result that is done, and is not the one that stood there when the batch began, is this batch's own.
"""

import copy
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from threading import Event
from typing import Final

from jaxscan.atomic import make_folder, replacing
from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError, JaxscanError
from jaxscan.exclusive import exclusive
from jaxscan.extras import extra
from jaxscan.files.cloud import read_ply
from jaxscan.files.listing import natural_key
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import SCAN_FILE, read_scan
from jaxscan.reconstruction.range_image import read_range_image
from jaxscan.reconstruction.reconstruct import write_stream
from jaxscan.reconstruction.stream import Scanner

# How long a scheduler may take to answer, and how many workers may die of one scan before it is given up.
_ANSWER_S: Final = 15
_DEATHS: Final = 3
# How many scans are measured at once on a machine at most: while one waits for its photographs, others are measured.
# Each has its own ring of photographs in memory.
_SCANS_AT_ONCE: Final = 4
# What the results in a folder were made with, and the lock of the batch that is at work there.
_OPTIONS_FILE: Final = ".batch.json"
_LOCK: Final = ".batch.lock"


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

    def is_done(self, *made_from: Path) -> bool:
        """Whether its points are there and younger than what they come from.

        Args:
            made_from: files beside its scan.toml: the rig, and what `held` gives.
        """
        try:
            done = self.output.stat().st_mtime_ns
            return all(done > path.stat().st_mtime_ns for path in (self.scan, *made_from))
        except FileNotFoundError:
            return False

    def made_at(self) -> int | None:
        """When its points were written, ns, by the clock of their disk; None if they are not there."""
        try:
            return self.output.stat().st_mtime_ns
        except FileNotFoundError:
            return None


@dataclass(frozen=True)
class Outcome:
    """What came of a scan.

    Attributes:
        task: which.
        points: how many were written; None where it failed.
        reason: why it failed, or "".
        notes: what its photographs have shown to be wrong in its settings.
    """

    task: Task
    points: int | None
    reason: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Made:
    """What a worker says of a scan.

    Attributes:
        points: how many were written.
        notes: as `Outcome` has them.
    """

    points: int
    notes: tuple[str, ...] = ()


def find_tasks(scans: Path, out: Path, ending: str = ".ply") -> list[Task]:
    """Every scan of a tree, in natural order, with the file its points belong to: OUT/FOLDER.ply.

    Raises:
        InputError: the tree is no folder, holds no scan, or two of its scans would be written to one file.
    """
    if not scans.is_dir():
        raise InputError(f"{scans}: is no folder: name the folder that the scans lie in")
    # A result's folder may lie in the tree of the scans, and is not searched.
    found = [folder for folder, files in _folders(scans, os.path.realpath(out)) if SCAN_FILE in files]
    if not found:
        raise InputError(f"{scans}: holds no scan, no {SCAN_FILE} in it or in a folder below: check the path")
    tasks: list[Task] = []
    taken: dict[str, Task] = {}
    for folder in sorted(found, key=lambda path: natural_key(str(path))):
        relative = folder.relative_to(scans)
        name = relative.as_posix() if relative.parts else Path(os.path.realpath(folder)).name
        task = Task(name, folder / SCAN_FILE, out / f"{name}{ending}")
        # Many disks take names for the same that differ in capitals alone.
        other = taken.setdefault(str(task.output).casefold(), task)
        if other is not task:
            raise InputError(
                f"{task.scan.parent} and {other.scan.parent} would both be written to {task.output}: rename one folder"
            )
        tasks.append(task)
    return tasks


def _folders(top: Path, skipped: str) -> Iterator[tuple[Path, list[str]]]:
    """The folders of a tree with their files, links followed; each once, by its own name rather than by a link's."""
    seen, to_see = {skipped}, [str(top)]
    while to_see:
        for folder, inner, files in os.walk(to_see.pop(0)):
            place = os.path.realpath(folder)
            if place in seen:
                inner.clear()
                continue
            seen.add(place)
            to_see += [link for name in inner if os.path.islink(link := os.path.join(folder, name))]
            yield Path(folder), files


@contextmanager
def held(out: Path, options: Options) -> Iterator[Path]:
    """Hold the folder of a batch's results while it is at work.

    Args:
        out: the folder; it is made where it is not there.
        options: of the batch. What was made there with others is older than the file that is given back.

    Returns:
        A file from which all results there are made, as they are from the rig.

    Raises:
        InUseError: another batch is at work there.
        InputError: the folder cannot be made or written to.
    """
    make_folder(out)
    with exclusive(out / _LOCK, str(out)):
        path, text = out / _OPTIONS_FILE, json.dumps(asdict(options), indent=2)
        if not path.is_file() or path.read_text(errors="replace") != text:
            with replacing(path, "w") as file:
                file.write(text)
        yield path


def run_batch(
    tasks: Sequence[Task],
    rig: Path,
    options: Options | None = None,
    scheduler: str | None = None,
) -> Iterator[Outcome]:
    """Reconstruct many scans; each outcome as it is there.

    Args:
        tasks: as `find_tasks` gives them, without those that are done.
        rig: of all of them.
        options: how; the defaults where there are none.
        scheduler: address of a Dask scheduler whose workers see the same files; None for this machine.

    Raises:
        InputError: the rig is refused, or the scheduler does not answer.
    """
    options = options or Options()
    read_rig(rig)
    for folder in {task.output.parent for task in tasks}:
        make_folder(folder)
    stop = Event()
    # A worker on another machine hears of nothing until its scan is done.
    heed = {} if scheduler else {"advance": partial(_heed, stop)}
    with _executor(scheduler) as executor:
        futures: dict[Future[Made | str], Task] = {}
        for task in tasks:
            here = replace(task, scan=task.scan.absolute(), output=task.output.absolute())
            future = executor.submit(reconstruct_one, here, rig.absolute(), here.made_at(), options, **heed)
            futures[future] = task
        try:
            for future in as_completed(futures):
                yield _outcome(futures[future], future)
        finally:
            stop.set()
            for future in futures:
                future.cancel()


def _heed(stop: Event, by: int) -> None:
    """Break off a scan of a batch that was stopped; what it has written so far is deleted."""
    if stop.is_set():
        raise InterruptedError("the batch was stopped")


def reconstruct_one(
    task: Task, rig: Path, stood: int | None, options: Options, advance: Callable[[int], object] = lambda by: None
) -> Made | str:
    """One scan to one file, on whatever machine.

    Args:
        task: with absolute paths.
        rig: likewise.
        stood: when what stands in its place at the beginning of the batch was made. What is done and was made at
            another time is this batch's own, of these options, and is not made a second time.
        options: how.
        advance: called with the number of photographs read, some at a time; what it raises ends the scan.

    Returns:
        How many points its file has; or, in words, why there is none.
    """
    try:
        if task.made_at() != stood and task.is_done(rig):
            return Made(_points_in(task.output))
        # What it says of its scan is not said of another that is measured beside it.
        scanner = copy.copy(_scanner(rig, rig.stat().st_mtime_ns, options))
        written = write_stream([task.output], scanner.scan(read_scan(task.scan), advance))
        return Made(written.points, tuple(scanner.notes))
    except JaxscanError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - what is wrong with one scan must not stop the others
        return f"{task.scan}: unexpected error: {type(error).__name__}: {error}"


def _points_in(path: Path) -> int:
    return len(read_ply(path).points) if path.suffix == ".ply" else int(read_range_image(path).valid.sum())


@lru_cache(maxsize=4)
def _scanner(rig: Path, modified: int, options: Options) -> Scanner:
    """Made ready once in each process, and again when the rig's file has changed."""
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


def _outcome(task: Task, future: "Future[Made | str]") -> Outcome:
    if (error := future.exception()) is not None:
        return Outcome(task, None, f"{task.scan}: {type(error).__name__}: {error}")
    result = future.result()
    return Outcome(task, None, result) if isinstance(result, str) else Outcome(task, result.points, notes=result.notes)


@contextmanager
def _executor(scheduler: str | None) -> Iterator[Executor]:
    if scheduler is None:
        with ThreadPoolExecutor(_scans_at_once()) as pool:
            yield pool
        return
    distributed = extra("cluster")
    from dask.config import set as dask_settings

    with dask_settings({"distributed.comm.timeouts.connect": _ANSWER_S}):
        try:
            client = distributed.Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"{scheduler}: no Dask scheduler answers within {_ANSWER_S} s ({error}): start one with dask "
                "scheduler, and give the address that it prints"
            ) from error
    with client, client.get_executor(pure=False, retries=_DEATHS) as executor:
        yield executor
