"""Programs that are killed, cables that are pulled, disks that fill: what is lost or there twice, and what goes on.

Scans and the disk go through the command line, the lab through a server that is a process of its own, the batch through
`jaxscan batch`; a cable is pulled from an emulated controller of each kind.
"""

import contextlib
import io
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import numpy as np

from benchmarks.batch import batch_command, make_scans
from benchmarks.killed_scans import Killed, fill_disk, kill_and_resume, prepare
from benchmarks.lab_processes import bearer, end
from benchmarks.lost_steps import KINDS, TRAVEL, stage_of
from benchmarks.metric import Metric
from benchmarks.stop_processes import photograph
from benchmarks.throughput import rig
from hardware.errors import HardwareError
from hardware.frame import Frame
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.laser import SimulatedLaser
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import read_scan
from jaxscan.images import read_image

# Moments: kills of scans, of the server in a lab's job, of a batch; pulled cables; full disks.
_MOMENTS = {"scan": 40, "lab": 30, "batch": 30, "cable": 20, "disk": 20}
_QUICK = {"scan": 1, "lab": 1, "batch": 1, "cable": 6, "disk": 1}
_LAB_FRAMES, _LAB_APART = 6, 200
_CABLE_PLACES = (0, 4000, 2000, 9000, 12000)
_BATCH_SIZE = (96, 128)


class Struck(NamedTuple):
    """What became of one moment.

    Attributes:
        met: whether the work was under way.
        lost: results that were reported and are not there, or not whole.
        doubled: those that are there twice, or were made again.
        failed: whether the next order did not end as one that nothing had happened to.
    """

    met: bool
    lost: int
    doubled: int
    failed: bool


def measure(quick: bool) -> list[Metric]:
    """All of them."""
    moments = _QUICK if quick else _MOMENTS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for own in ("scan", "lab", "batch", "cable"):
            (folder / own).mkdir()
        quiet = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
        with quiet[0], quiet[1], warnings.catch_warnings():
            warnings.simplefilter("ignore")
            prepare(folder / "scan")
            found = {
                "scan": [_of(kill_and_resume(folder / "scan", seed)) for seed in range(moments["scan"])],
                "disk": [
                    _of(kill_and_resume(folder / "scan", 1000 + seed, fill_disk)) for seed in range(moments["disk"])
                ],
            }
        found["cable"] = [pull(folder / "cable", seed) for seed in range(moments["cable"])]
        found["lab"] = kill_server(folder / "lab", moments["lab"])
        found["batch"] = kill_batch(folder / "batch", moments["batch"])
    return [
        metric
        for kind, struck in found.items()
        for metric in (
            Metric(f"crashes.{kind}.moments", len(struck)),
            Metric(f"crashes.{kind}.under_way", sum(one.met for one in struck)),
            Metric(f"crashes.{kind}.lost_or_torn", sum(one.lost for one in struck), "", "lower", 0),
            Metric(f"crashes.{kind}.doubled", sum(one.doubled for one in struck), "", "lower", 0),
            Metric(f"crashes.{kind}.next_order_failed", sum(one.failed for one in struck), "", "lower", 0),
        )
    ]


def _of(killed: Killed) -> Struck:
    # A scan that equals an undisturbed one has no frame twice.
    return Struck(killed.running, not killed.whole, 0, not killed.same)


class _Camera:
    """A photograph says where it was taken."""

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Nothing to set."""

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """A stripe that depends on the place."""
        return Frame(photograph(positions["stage"]), positions, 0.0, 0.01)

    def close(self) -> None:
        """Nothing to do."""


def pull(folder: Path, seed: int) -> Struck:
    """Pull the cable of a controller in mid-scan, plug it in again, and go on."""
    random_ = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    faults = f"pull_s={random_.uniform(3, 60):.3f}&silent={random_.randrange(2)}&length={TRAVEL.span + 1000}"
    scan, reported = ScanFolder.create(folder / f"{seed}", Plan({"stage": _CABLE_PLACES}, settle_s=0.0)), 0

    def taken(path: Path, frame: Frame) -> None:
        nonlocal reported
        reported += 1

    pulled = True
    try:
        with contextlib.closing(stage_of(kind, faults)) as stage:
            take(scan, Devices(_Camera(), {"stage": stage}, SimulatedLaser()), taken=taken, verify=0)
        pulled = False
    except HardwareError:
        pass
    lost = max(0, reported - _right(folder / f"{seed}"))
    with contextlib.closing(stage_of(kind, f"length={TRAVEL.span + 1000}")) as stage:
        again = ScanFolder.resume(folder / f"{seed}")
        take(again, Devices(_Camera(), {"stage": stage}, SimulatedLaser()), verify=0)
    return Struck(pulled, lost, _doubled(folder / f"{seed}"), _right(folder / f"{seed}") != len(_CABLE_PLACES))


def _right(folder: Path) -> int:
    """How many photographs a scan lists that are whole and of their places."""
    scan = read_scan(folder)
    return sum(
        np.array_equal(read_image(path), photograph(step))
        for path, step in zip(scan.frames, scan.axes["stage"], strict=True)
    )


def _doubled(folder: Path) -> int:
    """How many photographs of a place, or files of photographs, there are beyond one."""
    scan = read_scan(folder)
    steps = list(scan.axes["stage"])
    return len(steps) - len(set(steps)) + len(list((folder / "frames").iterdir())) - len(scan.frames)


def kill_server(folder: Path, count: int) -> list[Struck]:
    """Kill a lab's server in the midst of a scan, start it again, and go on; it is the next one's victim."""
    found = []
    with contextlib.ExitStack() as servers:
        child, operator = servers.enter_context(_server(folder))
        for seed in range(count):
            random_ = random.Random(seed)
            project = f"scan{seed}"
            operator.post("/api/lock", json={}).raise_for_status()
            order = {"kind": "scan", "project": project, "frames": _LAB_FRAMES, "apart": _LAB_APART, "settle_s": 0}
            job = operator.post("/api/jobs", json={**order, "verify": None}).raise_for_status().json()
            wanted = random_.randrange(_LAB_FRAMES)
            while (now := operator.get(f"/api/jobs/{job['id']}").json())["taken"] < wanted and now["ended_s"] is None:
                time.sleep(0.01)
            time.sleep(random_.uniform(0, 0.3))
            child.kill()
            child.wait()
            own = folder / "lab" / "projects" / project
            lost = max(0, now["taken"] - _right(own))
            child, operator = servers.enter_context(_server(folder))
            again = operator.get(f"/api/jobs/{job['id']}").json()
            met = again["state"] == "interrupted"
            if met:
                operator.post("/api/lock", json={}).raise_for_status()
                again = operator.post(f"/api/jobs/{job['id']}/resume").raise_for_status().json()
                while again["ended_s"] is None:
                    time.sleep(0.05)
                    again = operator.get(f"/api/jobs/{job['id']}").json()
            whole = again["state"] == "done" and _right(own) == _LAB_FRAMES
            found.append(Struck(met, lost, _doubled(own), not whole))
    return found


@contextlib.contextmanager
def _server(folder: Path) -> Iterator[tuple["subprocess.Popen[str]", httpx.Client]]:
    argv = [sys.executable, "-m", "benchmarks.stop_processes", str(folder), "0"]
    child = subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    try:
        url, tokens = json.loads(child.stdout.readline())
        with httpx.Client(base_url=url, headers=bearer(tokens[0]), timeout=60, trust_env=False) as operator:
            yield child, operator
    finally:
        end(child)


def kill_batch(folder: Path, count: int) -> list[Struck]:
    """Kill a batch again and again, each time when it has made something more, and let the last run end."""
    rows, columns = _BATCH_SIZE
    names = 2 * count + 4
    broken = make_scans(folder / "scans", names)
    write_rig(folder / "rig.json", RigFile(rig(columns, rows)))
    quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run(batch_command(folder, "whole"), **quiet)
    whole = {path.name: path.read_bytes() for path in (folder / "whole").glob("*.ply")}
    made: dict[str, int] = {}
    found = []
    for seed in range(count):
        random_ = random.Random(seed)
        child = subprocess.Popen(batch_command(folder, "killed"), **quiet)
        while len(_made(folder)) <= len(made) and child.poll() is None:
            time.sleep(0.002)
        time.sleep(random_.uniform(0, 0.05))
        met = child.poll() is None
        child.send_signal(signal.SIGKILL)
        child.wait()
        now = _made(folder)
        half_written = sum((folder / "killed" / name).read_bytes() != whole[name] for name in now)
        gone, twice = sum(name not in now for name in made), sum(now.get(name) != at for name, at in made.items())
        found.append(Struck(met, half_written + gone, twice, False))
        made = now
    subprocess.run(batch_command(folder, "killed"), **quiet)
    now = _made(folder)
    same = {name: (folder / "killed" / name).read_bytes() for name in now} == whole
    same = same and len(whole) == names - len(broken)
    twice = sum(now.get(name) != at for name, at in made.items())
    return [*found[:-1], found[-1]._replace(doubled=found[-1].doubled + twice, failed=not same)]


def _made(folder: Path) -> dict[str, int]:
    """The results that are there, and when each was made."""
    return {path.name: path.stat().st_mtime_ns for path in (folder / "killed").glob("*.ply")}
