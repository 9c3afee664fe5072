"""Many scans: each by itself, on this machine or on a cluster, its points in a file of its own.

A result that is younger than its scan.toml and the rig is kept, as `make` would, so that what was interrupted goes on
with what is missing. A scan that fails is told of, and the others go on.

A cluster runs a task again whose worker is lost before its answer was fetched. Such a task asks the same question once
more: a result that is done, and is not the one that stood there when the batch began, is this batch's own.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError, JaxscanError
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

    def is_done(self, rig: Path) -> bool:
        """Whether its points are there and younger than what they come from."""
        try:
            done = self.output.stat().st_mtime_ns
            return done > max(self.scan.stat().st_mtime_ns, rig.stat().st_mtime_ns)
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
    """

    task: Task
    points: int | None
    reason: str = ""


def find_tasks(scans: Path, out: Path, ending: str = ".ply") -> list[Task]:
    """Every scan of a tree, in natural order, with the file its points belong to: OUT/FOLDER.ply.

    Raises:
        InputError: the tree is no folder, holds no scan, or two of its scans would be written to one file.
    """
    if not scans.is_dir():
        raise InputError(f"{scans}: is no folder: name the folder that the scans lie in")
    # A result's folder may lie in the tree of the scans, and is not searched.
    skipped = os.path.realpath(out)
    found = []
    for folder, inner, files in os.walk(scans, followlinks=True):
        inner[:] = [name for name in inner if os.path.realpath(os.path.join(folder, name)) != skipped]
        if SCAN_FILE in files:
            found.append(Path(folder))
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


def run_batch(
    tasks: Sequence[Task],
    rig: Path,
    detector: Detector = DEFAULT,
    choice: Choice = DEFAULT_CHOICE,
    scheduler: str | None = None,
    depths_mm: tuple[float, float] | None = None,
) -> Iterator[Outcome]:
    """Reconstruct many scans; each outcome as it is there.

    Args:
        tasks: as `find_tasks` gives them, without those that are done.
        rig: of all of them.
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.
        scheduler: address of a Dask scheduler whose workers see the same files; None for this machine.
        depths_mm: nearest and farthest depth at which there can be a stripe, as `Scanner` has it.

    Raises:
        InputError: the rig is refused, or the scheduler does not answer.
    """
    read_rig(rig)
    for folder in {task.output.parent for task in tasks}:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror}): choose another folder") from error
    with _executor(scheduler) as executor:
        futures: dict[Future[int | str], Task] = {}
        for task in tasks:
            here = replace(task, scan=task.scan.absolute(), output=task.output.absolute())
            future = executor.submit(reconstruct_one, here, rig.absolute(), here.made_at(), detector, choice, depths_mm)
            futures[future] = task
        try:
            for future in as_completed(futures):
                yield _outcome(futures[future], future)
        finally:
            for future in futures:
                future.cancel()


def reconstruct_one(
    task: Task,
    rig: Path,
    stood: int | None,
    detector: Detector,
    choice: Choice,
    depths_mm: tuple[float, float] | None = None,
) -> int | str:
    """One scan to one file, on whatever machine.

    Args:
        task: with absolute paths.
        rig: likewise.
        stood: when what stands in its place at the beginning of the batch was made. What is done and was made at
            another time is this batch's own, of these options, and is not made a second time.
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.
        depths_mm: nearest and farthest depth at which there can be a stripe.

    Returns:
        How many points its file has; or, in words, why there is none.
    """
    try:
        if task.made_at() != stood and task.is_done(rig):
            return _points_in(task.output)
        scanner = _scanner(rig, rig.stat().st_mtime_ns, detector, choice, depths_mm)
        return write_stream([task.output], scanner.scan(read_scan(task.scan))).points
    except JaxscanError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - what is wrong with one scan must not stop the others
        return f"{task.scan}: unexpected error: {type(error).__name__}: {error}"


def _points_in(path: Path) -> int:
    return len(read_ply(path).points) if path.suffix == ".ply" else int(read_range_image(path).valid.sum())


@lru_cache(maxsize=4)
def _scanner(
    rig: Path, modified: int, detector: Detector, choice: Choice, depths_mm: tuple[float, float] | None
) -> Scanner:
    """Made ready once in each process, and again when the rig's file has changed."""
    return Scanner(read_rig(rig), detector, choice, depths_mm=depths_mm)


def _outcome(task: Task, future: "Future[int | str]") -> Outcome:
    if (error := future.exception()) is not None:
        return Outcome(task, None, f"{task.scan}: {type(error).__name__}: {error}")
    result = future.result()
    return Outcome(task, None, result) if isinstance(result, str) else Outcome(task, result)


@contextmanager
def _executor(scheduler: str | None) -> Iterator[Executor]:
    if scheduler is None:
        # While one scan waits for its photographs, another is measured.
        with ThreadPoolExecutor(os.cpu_count()) as pool:
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
