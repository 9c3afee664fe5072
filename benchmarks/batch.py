"""Many scans: a batch that is killed half-way and run again, and one on a cluster of which a worker is killed."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.metric import Metric
from benchmarks.throughput import rig
from jaxscan.files.axes import STAGE
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import Scan, write_scan
from jaxscan.images import StripeSettings, write_image

_ROWS, _COLUMNS, _FRAMES = 96, 128, 3


def measure(quick: bool) -> list[Metric]:
    """A thousand small scans, three of them broken; in the short form sixty, and no cluster."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        metrics = killed_and_resumed(folder, 60 if quick else 1000)
        return metrics if quick else metrics + worker_killed(folder)


def killed_and_resumed(folder: Path, count: int) -> list[Metric]:
    """Kill a batch when half of its results are there, run it again, and compare with one that was not disturbed."""
    broken = make_scans(folder / "scans", count)
    write_rig(folder / "rig.json", RigFile(rig(_COLUMNS, _ROWS)))
    begin = time.perf_counter()
    whole = batch_command(folder, "whole")
    if subprocess.run(whole, capture_output=True).returncode != 1:
        raise RuntimeError("a batch with broken scans must end with status 1")
    seconds = time.perf_counter() - begin
    child = subprocess.Popen(batch_command(folder, "killed"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(list((folder / "killed").glob("*.ply"))) < count // 2 and child.poll() is None:
        time.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    child.wait()
    before = {path.name: path.stat().st_mtime_ns for path in (folder / "killed").glob("*.ply")}
    again = subprocess.run(batch_command(folder, "killed"), capture_output=True, text=True)
    reasons = sum(again.stderr.count(f"{name}/1.png") > 0 for name in broken)
    results = sorted((folder / "killed").glob("*.ply"))
    twice = sum(path.stat().st_mtime_ns != before[path.name] for path in results if path.name in before)
    same = sum(path.read_bytes() == (folder / "whole" / path.name).read_bytes() for path in results)
    print(
        f"  {count} scans of {_FRAMES} frames of {_COLUMNS} x {_ROWS} in {seconds:.1f} s; killed after {len(before)}, "
        f"then {len(results)} results and {reasons} reasons",
        flush=True,
    )
    return [
        Metric("batch.results_missing", count - len(broken) - len(results), "", "lower", 0),
        Metric("batch.reasons_missing", len(broken) - reasons, "", "lower", 0),
        Metric("batch.done_twice", twice, "", "lower", 0),
        Metric("batch.unlike_uninterrupted", len(results) - same, "", "lower", 0),
        Metric("batch.scans_per_s", count / seconds, "1/s"),
    ]


def worker_killed(folder: Path) -> list[Metric]:
    """Two workers of one thread each, of which one is killed when a tenth of the results are there."""
    from distributed import LocalCluster

    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    cluster: Any
    with LocalCluster(**settings) as cluster:
        command = [*batch_command(folder, "cluster"), "--scheduler", cluster.scheduler_address]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        expected = len(list((folder / "whole").glob("*.ply")))
        while len(list((folder / "cluster").glob("*.ply"))) < expected // 10 and child.poll() is None:
            time.sleep(0.02)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        child.wait()
    results = list((folder / "cluster").glob("*.ply"))
    same = sum(path.read_bytes() == (folder / "whole" / path.name).read_bytes() for path in results)
    print(f"  cluster: {len(results)} results of {expected} with one of two workers killed", flush=True)
    return [
        Metric("batch.cluster.results_missing", expected - len(results), "", "lower", 0),
        Metric("batch.cluster.unlike_this_machine", len(results) - same, "", "lower", 0),
    ]


def batch_command(folder: Path, out: str) -> list[str]:
    """The batch of a folder's scans."""
    program = [sys.executable, "-m", "jaxscan"]
    return [*program, "batch", str(folder / "scans"), "--rig", str(folder / "rig.json"), "-o", str(folder / out)]


def make_scans(folder: Path, count: int) -> list[str]:
    """Write `count` scans, of which three have a photograph that was cut short; their names."""
    random = np.random.default_rng(0)
    row = np.arange(_ROWS)[:, None]
    for i in range(count):
        own = folder / f"{i:04d}"
        own.mkdir(parents=True)
        paths = tuple(own / f"{k}.png" for k in range(_FRAMES))
        for k, path in enumerate(paths):
            centre = 0.55 * _ROWS + 4 * np.sin(np.arange(_COLUMNS) / 20 + i + k)
            image = (
                20 + 180 * np.exp(-0.5 * ((row - centre) / 1.5) ** 2) + 2 * random.standard_normal((_ROWS, _COLUMNS))
            )
            write_image(path, np.rint(image).clip(0, 255).astype(np.uint8))
        write_scan(Scan(own / "scan.toml", StripeSettings("grey"), paths, axes={STAGE: (0, 500, 1000)}))
    broken = [f"{i:04d}" for i in random.choice(count, 3, replace=False)]
    for name in broken:
        path = folder / name / "1.png"
        path.write_bytes(path.read_bytes()[:400])
    return broken
