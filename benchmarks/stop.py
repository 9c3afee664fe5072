"""Stop under load: how long POST /api/stop takes while others do what they can, and what becomes of a scan meanwhile.

The server is a process of its own, on a loopback port, with the simulated scanner; the load is another process. Each
Stop comes on a connection of its own, for every answer ends one. In turn with it an idle server is told to stop, which
shows how much of the time is the machine's and the client's. While a scan runs under the load nobody stops it; its
photographs are compared with those of one that was not disturbed.
"""

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np

from benchmarks.full_disk import full
from benchmarks.lab_processes import bearer, end
from benchmarks.lab_tls import certificate
from benchmarks.metric import Metric
from benchmarks.stop_loads import LOADS, PROJECTS

# Stops under each load, and photographs of the scan.
_STOPS, _QUICK_STOPS = 200, 12
_FRAMES, _QUICK_FRAMES = 5, 3
# Watchers, cloud requests at a time, sign-ins a second, sockets that say half a request.
_SIZES = {"watchers": 200, "clouds": 50, "sign-ins": 100, "half-open": 2000}
_QUICK_SIZES = {"watchers": 20, "clouds": 10, "sign-ins": 20, "half-open": 200}
_GOAL_S = 0.5
# Another address of this machine than that of most of the crowd.
_ELSEWHERE = "127.0.0.9"


def measure(quick: bool) -> list[Metric]:
    """One Stop after the other under each load by itself and under all of them."""
    return under_loads(quick, "stop", tls=False)


def under_loads(quick: bool, prefix: str, tls: bool) -> list[Metric]:
    """The figures of `measure`, with names that begin with `prefix`, of a server with TLS of its own or without."""
    stops, frames = (_QUICK_STOPS, _QUICK_FRAMES) if quick else (_STOPS, _FRAMES)
    sizes = _QUICK_SIZES if quick else _SIZES
    metrics, scans, errors, everything = [], {}, 0, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "idle").mkdir()
        files = certificate(folder) if tls else ()
        with _server(folder, *files) as (pid, url, tokens), _server(folder / "idle", *files) as (_, beside, other):
            # A scan connects its devices, which Stop then has to stop there too.
            _scan(beside, other, folder / "idle", "first", frames)
            for load in ("nothing", *LOADS, "all"):
                with contextlib.ExitStack() as under:
                    if load != "nothing":
                        under.enter_context(_loaded(url, tokens, [*LOADS] if load == "all" else [load], sizes))
                    if not quick or load in ("nothing", "clouds", "all"):
                        scans[load] = _scan(url, tokens, folder, load, frames)
                    if load in ("all", "full disk"):
                        under.enter_context(full(pid))
                    # Addresses take turns only where there is TLS.
                    for address in (None, _ELSEWHERE) if load == "all" and tls else (None,):
                        times, idle, failed = _stops((url, tokens[1]), (beside, other[1]), stops, address)
                        errors += failed
                        everything += times if load != "nothing" else []
                        p50, p99, p999 = np.percentile(times, (50, 99, 99.9))
                        key = load.replace(" ", "_").replace("-", "_") + ("_from_elsewhere" if address else "")
                        metrics += [
                            Metric(f"{prefix}.{key}.p50", p50, "s"),
                            Metric(f"{prefix}.{key}.p99", p99, "s"),
                            Metric(f"{prefix}.{key}.p99.9", p999, "s", "shown", _GOAL_S),
                            # What the machine and this client take of it: a server that nobody else asks for anything.
                            Metric(f"{prefix}.{key}.idle_server.slowest", max(idle), "s"),
                        ]
    same = [scans[load] == scans["nothing"] for load in scans if load != "nothing"]
    return [
        Metric(f"{prefix}.errors", errors, "", "lower", 0),
        # A machine with other work says how loaded it is, not how quick Stop is.
        Metric(f"{prefix}.slowest", max(everything), "s", "lower", _GOAL_S, slack=4.0, floor=1.0, target_suffices=True),
        Metric(f"{prefix}.scans_that_differ", same.count(False), "", "lower", 0),
        Metric(f"{prefix}.scans_compared", len(same)),
        Metric(f"{prefix}.load_average", os.getloadavg()[0]),
        *metrics,
    ]


@contextlib.contextmanager
def _server(folder: Path, *files: Path) -> Iterator[tuple[int, str, list[str]]]:
    """The server's process, its address, and tokens: operator, administrator, viewer.

    Args:
        folder: its data.
        files: certificate and key, where it speaks TLS.
    """
    argv = [sys.executable, "-m", "benchmarks.stop_processes", str(folder), str(PROJECTS), *map(str, files)]
    child = subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    try:
        url, tokens = json.loads(child.stdout.readline())
        yield child.pid, url, tokens
    finally:
        end(child)


@contextlib.contextmanager
def _loaded(url: str, tokens: list[str], loads: list[str], sizes: dict[str, int]) -> Iterator[None]:
    """These loads, in a process of their own."""
    argv = [sys.executable, "-m", "benchmarks.stop_loads", url, json.dumps([tokens, loads, sizes])]
    child = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    try:
        if child.stdout.readline() != "loading\n":
            raise RuntimeError("the load did not begin")
        yield
    finally:
        end(child)


def _stops(
    server: tuple[str, str], idle: tuple[str, str], count: int, address: str | None
) -> tuple[list[float], list[float], int]:
    """How long each took, s, of a server and, in turn, of an idle one; and how many failed.

    Args:
        server: its address, and the token of an administrator.
        idle: the same of the idle one.
        count: of orders to each.
        address: of this machine, from which they come.
    """
    times: tuple[list[float], list[float]] = ([], [])
    failed = 0
    with contextlib.ExitStack() as opened:
        clients = [
            opened.enter_context(
                httpx.Client(
                    base_url=url,
                    headers=bearer(token),
                    timeout=30,
                    trust_env=False,
                    transport=httpx.HTTPTransport(verify=False, local_address=address),
                )
            )
            for url, token in (server, idle)
        ]
        for _ in range(count):
            for client, own in zip(clients, times, strict=True):
                begin_s = time.monotonic()
                try:
                    failed += client.post("/api/stop").status_code != 200
                except httpx.HTTPError as error:
                    print(f"stop: {type(error).__name__}: {error}", file=sys.stderr)
                    failed += 1
                own.append(time.monotonic() - begin_s)
            time.sleep(0.01)
    return *times, failed


def _scan(url: str, tokens: list[str], folder: Path, project: str, frames: int) -> list[str]:
    """A scan while its operator renews: digests of its photographs and of what lists them."""
    project = "".join(letter for letter in project if letter.isalnum())
    with httpx.Client(base_url=url, headers=bearer(tokens[0]), timeout=60, trust_env=False, verify=False) as operator:
        operator.post("/api/lock", json={}).raise_for_status()
        order = {"kind": "scan", "project": project, "frames": frames, "apart": 200, "settle_s": 0}
        answer = operator.post("/api/jobs", json=order)
        answer.raise_for_status()
        job = answer.json()
        while job["ended_s"] is None:
            time.sleep(0.1)
            try:
                operator.put("/api/lock").raise_for_status()
                job = operator.get(f"/api/jobs/{job['id']}").raise_for_status().json()
            except httpx.HTTPError as error:
                print(f"stop: the operator of {project}: {type(error).__name__}: {error}", file=sys.stderr)
        operator.delete("/api/lock")
    if job["state"] != "done":
        print(f"stop: the scan {project} ended as {job['state']}: {job['message']}", file=sys.stderr)
        return []
    listed = folder / "lab" / "projects" / project
    files = sorted((listed / "frames").iterdir())
    text = (listed / "scan.toml").read_text().replace(project, "")
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in files] + [text]
