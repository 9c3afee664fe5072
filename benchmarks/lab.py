"""The lab server under watch: what 200 watchers see, and what they cost the scan.

The server is a process of its own, on a loopback port, and so are the watchers. The stage takes its time: its pace sets
that of the scan, two photographs a second and more. The scan is timed without and with watchers in turns, by what the
server itself says of it.
"""

import contextlib
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx

from benchmarks.lab_processes import bearer, end
from benchmarks.metric import Metric

_WATCHERS, _QUICK_WATCHERS = 200, 40
_SECONDS, _QUICK_SECONDS = 60.0, 5.0
_APART, _FRAMES = 640, 380
# Turns of a scan alone and one that is watched.
_TURNS = 3


def measure(quick: bool) -> list[Metric]:
    """One operator and many watchers."""
    watchers, seconds = (_QUICK_WATCHERS, _QUICK_SECONDS) if quick else (_WATCHERS, _SECONDS)
    with tempfile.TemporaryDirectory() as name, _server(Path(name), watchers) as (url, tokens):
        operator = httpx.Client(base_url=url, headers=bearer(tokens[0]), timeout=30, trust_env=False)
        operator.post("/api/lock", json={}).raise_for_status()
        turns = 1 if quick else _TURNS
        alone, watched, seen = [], [], []
        with contextlib.closing(operator), _present(url, tokens[0]):
            # What compiles does so before anything is timed.
            _pace(operator, "first", 0.0)
            while operator.get("/api/profile").status_code != 200:
                time.sleep(0.1)
            for turn in range(turns):
                alone.append(_pace(operator, f"alone-{turn}", seconds / turns))
                with _watching(url, tokens[1:], watchers) as found:
                    watched.append(_pace(operator, f"watched-{turn}", seconds / turns))
                seen.append(found())
    pictures = [count / duration for one in seen for count, duration in one["pictures"]]
    loss = 1 - statistics.mean(watched) / statistics.mean(alone)
    return [
        Metric("lab.watchers", watchers),
        Metric("lab.errors", sum(one["errors"] for one in seen), "", "lower", 0),
        Metric("lab.second_operators", sum(one["second_operators"] for one in seen), "", "lower", 0),
        Metric("lab.pace.alone", statistics.mean(alone), "1/s", "higher", 2.0, slack=4.0, target_suffices=True),
        Metric("lab.pace.watched", statistics.mean(watched), "1/s", "higher", 2.0, slack=4.0, target_suffices=True),
        # Five seconds of a machine with other work say nothing of a tenth.
        Metric("lab.pace.lost_by_watching", loss, "", "shown" if quick else "lower", 0.10, floor=0.2),
        Metric("lab.pictures.of_a_watcher", statistics.mean(pictures), "1/s"),
        Metric("lab.pictures.of_the_one_that_sees_least", min(pictures), "1/s"),
        Metric("lab.states.of_a_watcher", statistics.mean(one["states"] for one in seen)),
    ]


@contextlib.contextmanager
def _server(folder: Path, watchers: int) -> Iterator[tuple[str, list[str]]]:
    """The server's address, and tokens: the operator's first."""
    argv = [sys.executable, "-m", "benchmarks.lab_processes", "serve", str(folder / "lab"), str(watchers)]
    child = subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    try:
        yield json.loads(child.stdout.readline())
    finally:
        end(child)


@contextlib.contextmanager
def _present(url: str, token: str) -> Iterator[None]:
    """Say that the operator is there, as its page does."""
    ended = threading.Event()

    def renew() -> None:
        with httpx.Client(base_url=url, headers=bearer(token), timeout=30, trust_env=False) as client:
            while not ended.wait(2.0):
                client.put("/api/lock").raise_for_status()

    with ThreadPoolExecutor(1) as pool:
        renewing = pool.submit(renew)
        try:
            yield
        finally:
            ended.set()
            renewing.result()


def _pace(operator: httpx.Client, project: str, seconds: float) -> float:
    """Photographs a second of a scan, from its first photograph to its last."""
    answer = operator.post(
        "/api/jobs", json={"kind": "scan", "project": project, "frames": _FRAMES, "apart": _APART, "settle_s": 0}
    )
    answer.raise_for_status()
    number = answer.json()["id"]

    def taken() -> int:
        job = operator.get(f"/api/jobs/{number}").json()
        if job["ended_s"] is not None:
            raise RuntimeError(f"the scan ended early: {job['message']}")
        return job["taken"]

    while not (first := taken()):
        time.sleep(0.01)
    begin_s = time.monotonic()
    while time.monotonic() - begin_s < seconds:
        time.sleep(0.2)
    before = taken()
    while (last := taken()) == before:
        time.sleep(0.01)
    pace = (last - first) / (time.monotonic() - begin_s)
    operator.post(f"/api/jobs/{number}/abort").raise_for_status()
    while operator.get(f"/api/jobs/{number}").json()["ended_s"] is None:
        time.sleep(0.05)
    return pace


@contextlib.contextmanager
def _watching(url: str, tokens: list[str], watchers: int) -> Iterator[Any]:
    """Watchers, in a process of their own; what is yielded says afterwards what they saw."""
    argv = [sys.executable, "-m", "benchmarks.lab_processes", "watch", url, str(watchers)]
    child = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write(json.dumps(tokens) + "\n")
    child.stdin.flush()
    if child.stdout.readline() != "watching\n":
        raise RuntimeError("the watchers did not begin")
    said: list[str] = []
    try:
        yield lambda: json.loads(said[0])
    finally:
        said.append(child.communicate("end\n")[0])
