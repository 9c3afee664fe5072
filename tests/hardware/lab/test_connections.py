"""Connections that say nothing, requests that never end, answers that nobody reads, and more than there is room for."""

import contextlib
import json
import os
import resource
import socket
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from serving import ADMINISTRATOR, OPERATOR, VIEWER, Served, ended, scan, serve, tls_files, until
from test_disk import SERVE

from benchmarks.lab_tls import unverified
from hardware.lab import front
from hardware.lab.door import Door, _Caller
from hardware.lab.gate import Gate, Listening
from hardware.lab.handing import can_be
from hardware.lab.limits import Limit, Limits
from hardware.lab.refusal import Refusal
from jaxscan.images import write_image

ROOM, SILENT = 40, 200
HALF = b"GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "


both = pytest.mark.parametrize("tls", [False, True], ids=["plain", "tls"])


@contextlib.contextmanager
def silent(
    address: tuple[str, int], count: int, said: bytes = HALF, tls: bool = False
) -> Iterator[list[socket.socket]]:
    """Connections that begin a request and say no more."""
    with contextlib.ExitStack() as lines:
        found = []
        for _ in range(count):
            line = lines.enter_context(socket.create_connection(address, timeout=20))
            with contextlib.suppress(OSError):
                line = lines.enter_context(unverified().wrap_socket(line)) if tls else line
                line.sendall(said)
            found.append(line)
        yield found


def answers(client: httpx.Client) -> bool:
    """Whether the server answers."""
    try:
        return client.get("/api/me").status_code == 200
    except httpx.TransportError:
        return False


def other_than(pid: int, child: Any) -> bool:
    """Whether another process has begun in its place."""
    return child.process.pid != pid


@both
def test_sockets_that_say_half_a_request_keep_nobody_out(tmp_path: Path, tls: bool):
    served = serve(tmp_path / "lab", server={"connections": ROOM}, **(tls_files(tmp_path) if tls else {}))
    operator, administrator = served.program(OPERATOR), served.program(ADMINISTRATOR)
    operator.post("/api/lock", json={})
    # With TLS those that do not finish its first words, and those that do.
    with silent(served.address, SILENT), silent(served.address, SILENT if tls else 0, tls=True):
        for _ in range(10):
            assert operator.put("/api/lock").status_code == 204
            assert administrator.post("/api/stop").status_code == 200
            # A browser that comes now, too.
            with served.client(Authorization=administrator.headers["Authorization"]) as newcomer:
                assert newcomer.post("/api/stop").status_code == 200
        assert ended(operator, operator.post("/api/jobs", json=scan("cup", 3)))["state"] == "done"
    served.end()


def test_a_crowd_that_comes_at_once(tmp_path: Path):
    """Somebody in the midst of it is heard: all of them wait in the system's queue while the server is busy."""
    served = serve(tmp_path / "lab", server={"connections": 400})
    token = served.program(ADMINISTRATOR).headers["Authorization"]
    stop = f"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {token}\r\nContent-Length: 0\r\n\r\n"
    loop, busy, done = served.lab.hub._loop, threading.Event(), threading.Event()
    assert loop is not None

    def be_busy() -> None:
        busy.set()
        done.wait(60)

    loop.call_soon_threadsafe(be_busy)
    busy.wait(20)
    with silent(served.address, 340), silent(served.address, 1, stop.encode()) as (line,), silent(served.address, 400):
        done.set()
        line.settimeout(20)
        assert line.recv(100).startswith(b"HTTP/1.1 200")
    served.end()


@contextlib.contextmanager
def blocked(served: Served) -> Iterator[None]:
    """The loop that serves everybody does nothing at all."""
    loop, busy, done = served.lab.hub._loop, threading.Event(), threading.Event()
    assert loop is not None
    loop.call_soon_threadsafe(lambda: (busy.set(), done.wait(60)))
    busy.wait(20)
    try:
        yield
    finally:
        done.set()


@pytest.mark.skipif(not can_be(), reason="there is no door on this system")
@both
def test_stop_and_renewal_while_the_loop_of_everybody_stands(tmp_path: Path, tls: bool):
    served = serve(tmp_path / "lab", **(tls_files(tmp_path) if tls else {}))
    operator, administrator, viewer = (served.program(name) for name in (OPERATOR, ADMINISTRATOR, VIEWER))
    operator.post("/api/lock", json={}).raise_for_status()
    browser = served.browser(ADMINISTRATOR)
    with blocked(served):
        for _ in range(3):
            assert operator.put("/api/lock", timeout=10).status_code == 204
            assert administrator.post("/api/stop", timeout=10).status_code == 200
            assert browser.post("/api/stop", timeout=10).status_code == 200
        # Who may not is told so there too, and so is who is not known.
        assert viewer.post("/api/stop", timeout=10).status_code == 403
        assert viewer.put("/api/lock", timeout=10).status_code == 403
        with served.client(Authorization="Bearer made-up") as stranger:
            assert stranger.post("/api/stop", timeout=10).status_code == 401
        with served.client(Host="evil.example") as other:
            assert other.post("/api/stop", timeout=10).status_code == 421
        with pytest.raises(httpx.TimeoutException):
            viewer.get("/api/me", timeout=0.5)
    assert viewer.get("/api/me").status_code == 200
    served.end()


@pytest.mark.skipif(not can_be(), reason="there is no door on this system")
@both
def test_a_process_that_is_killed_at_the_door_is_begun_again(tmp_path: Path, tls: bool):
    served = serve(tmp_path / "lab", **(tls_files(tmp_path) if tls else {}))
    viewer = served.program(VIEWER)
    doorway = served.server._doorway
    assert doorway is not None
    for child in doorway.children:
        first = child.process.pid
        child.process.kill()
        until(partial(other_than, first, child))
        assert until(lambda: answers(viewer))
    served.end()
    assert len(doorway.children) == 1 + tls
    assert [child.process.wait(10) is not None for child in doorway.children]


@pytest.mark.skipif(not can_be(), reason="there is no door on this system")
def test_an_address_that_asks_for_stop_all_the_time_takes_the_way_of_everybody():
    public, behind = ("198.51.100.7", 1), ("127.0.0.1", 1)
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    here, ends = zip(*(socket.socketpair() for _ in range(2)), strict=True)
    with contextlib.ExitStack() as opened:
        for one in (*here, *ends):
            opened.enter_context(contextlib.closing(one))
        gate = Gate(("127.0.0.1",))
        opened.callback(gate.close)
        door = Door(opened.enter_context(Listening(listening, gate, tls=False)), *ends, 10.0, ("127.0.0.1",))

        def urgent(peer: tuple[str, int], said: bytes = b"POST /api/stop HTTP/1.1\r\n\r\n") -> bool:
            line = socket.socket()
            handed = door._urgently(_Caller(line, peer, 0.0), said)
            line.close()
            if handed:
                said, numbers, _, _ = socket.recv_fds(here[1], 128, 1)
                assert tuple(json.loads(said)) == peer
                for number in numbers:
                    os.close(number)
            return handed

        told = [urgent(public) for _ in range(300)]
        assert told[:200] == [True] * 200
        assert not all(told)
        # Another one, and whoever else comes by the same proxy, does not wait for it.
        assert urgent(("198.51.100.8", 1))
        said = b"POST /api/stop HTTP/1.1\r\nX-Forwarded-For: 203.0.113.9, 198.51.100.7, 127.0.0.1\r\n\r\n"
        # A few more are due while the machine stands still: not as many as another address has.
        assert not all([urgent(behind, said) for _ in range(100)])
        assert urgent(behind, said.replace(b"198.51.100.7", b"198.51.100.9"))


def ended_by_the_server(line: socket.socket, within_s: float = 30.0) -> bytes:
    """What came on a connection until the server ended it, with a byte now and then from this side."""
    line.settimeout(0.2)
    answer, end_s = b"", time.monotonic() + within_s
    while time.monotonic() < end_s:
        with contextlib.suppress(TimeoutError):
            try:
                if not (part := line.recv(65536)):
                    return answer
            except ConnectionResetError:
                return answer
            answer += part
        with contextlib.suppress(OSError):
            line.sendall(b"x")
    raise AssertionError("the connection stays open")


@pytest.mark.parametrize(
    "said",
    [
        b"",
        HALF,
        b"POST /sign-in HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 50000\r\n\r\nname=",
        b"POST /api/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\nffff\r\n",
    ],
)
@both
def test_a_request_that_drips(tmp_path: Path, said: bytes, tls: bool):
    files = tls_files(tmp_path) if tls else {}
    served = serve(tmp_path / "lab", server={"head_s": 1.0, "body_s": 1.0}, **files)
    with silent(served.address, 1, said, tls) as (line,):
        answer = ended_by_the_server(line)
        assert not answer or answer.startswith(b"HTTP/1.1 4")
    served.end()


def large_scan(served: Served, viewer: httpx.Client) -> tuple[Path, bytes]:
    """A photograph larger than all that waits on a connection, and what asks for its scan's archive."""
    folder = served.lab.projects.path("cup")
    (folder / "frames").mkdir(parents=True)
    noise = np.random.default_rng(0).integers(0, 256, (2500, 2500, 3), np.uint8)
    write_image(folder / "frames" / "0.png", noise)
    (folder / "scan.toml").write_text('[scan]\nframes = ["frames/0.png"]\nsteps = [0]\n')
    token = viewer.headers["Authorization"]
    ask = f"GET /api/projects/cup/scan.zip HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {token}\r\n\r\n"
    return folder / "frames" / "0.png", ask.encode()


@both
def test_a_download_too_many_is_told_to_wait(tmp_path: Path, tls: bool):
    # Those that nobody reads go on for as long as the test: a machine under load may take its time.
    served = serve(tmp_path / "lab", server={"send_s": 300.0}, **(tls_files(tmp_path) if tls else {}))
    viewer = served.program(VIEWER)
    _, ask = large_scan(served, viewer)
    with silent(served.address, 4, ask, tls):
        until(lambda: served.lab.downloads.under_way == 4)
        refused = viewer.get("/api/projects/cup/scan.zip")
        assert refused.status_code == 429
        assert int(refused.headers["Retry-After"]) > 0
    # Whoever hangs up makes room.
    until(lambda: not served.lab.downloads.alive)
    assert viewer.get("/api/projects/cup/scan.zip").status_code == 200
    served.end()


@both
def test_an_answer_that_nobody_reads(tmp_path: Path, tls: bool):
    served = serve(tmp_path / "lab", server={"send_s": 3.0}, **(tls_files(tmp_path) if tls else {}))
    viewer = served.program(VIEWER)
    photograph, ask = large_scan(served, viewer)
    with silent(served.address, 4, ask, tls):
        until(lambda: served.lab.downloads.alive)
        until(lambda: not served.lab.downloads.alive)
        # Its photograph is closed now, not when the garbage is collected.
        assert until(lambda: str(photograph) not in map(os.path.realpath, Path("/proc/self/fd").iterdir()))
    whole = tmp_path / "cup.zip"
    whole.write_bytes(viewer.get("/api/projects/cup/scan.zip").content)
    assert zipfile.ZipFile(whole).testzip() is None
    served.end()


@contextlib.contextmanager
def process(folder: Path, descriptors: int) -> Iterator[tuple[subprocess.Popen, httpx.Client]]:
    """A lab in a process of its own with `descriptors` file descriptors, and its operator's program."""
    env = {"PYTHONPATH": f"{Path(__file__).parents[3]}:{Path(__file__).parent}"}
    argv = ["prlimit", f"--nofile={descriptors}:{descriptors}", sys.executable, "-c", SERVE, str(folder)]
    child = subprocess.Popen(
        argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env
    )
    assert child.stdout is not None
    url, token, _ = json.loads(child.stdout.readline())
    client = httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=30, trust_env=False)
    with client:
        yield child, client
    child.kill()
    child.communicate()


@pytest.mark.timeout(300)
def test_a_scan_with_few_descriptors(tmp_path: Path):
    with process(tmp_path / "lab", 320) as (child, operator):
        operator.post("/api/lock", json={}).raise_for_status()
        url = httpx.URL(operator.base_url)
        assert url.port
        with silent((url.host, url.port), 400):
            job = ended(operator, operator.post("/api/jobs", json=scan("cup", 4)))
            assert (job["state"], job["message"]) == ("done", "")
            # And with none left at all for connections.
            held = len(list(Path(f"/proc/{child.pid}/fd").iterdir()))
            resource.prlimit(child.pid, resource.RLIMIT_NOFILE, (held, 320))
            for _ in range(50):
                with contextlib.suppress(OSError), socket.create_connection((url.host, url.port), timeout=5) as line:
                    line.sendall(HALF)
            resource.prlimit(child.pid, resource.RLIMIT_NOFILE, (320, 320))
            assert until(lambda: operator.post("/api/stop").status_code == 200)
        assert child.stdin is not None
        _, said = child.communicate("\n", 60)
        assert len(said) < 20_000, said[:2000]


def test_so_many_requests_and_no_more():
    now_s = [0.0]
    limits, limit = Limits(lambda: now_s[0]), Limit(10.0, 20.0, 3)
    for _ in range(20):
        with limits.request("paul", limit):
            pass
    with pytest.raises(Refusal) as refused, limits.request("paul", limit):
        pass
    assert (refused.value.status, refused.value.retry_s) == (429, 1.0)
    with limits.request("olga", limit):
        pass
    now_s[0] += 1.0
    with contextlib.ExitStack() as held:
        for _ in range(3):
            held.enter_context(limits.request("paul", limit))
        with pytest.raises(Refusal, match="wait for their answers"), limits.request("paul", limit):
            pass
        with limits.request("olga", limit):
            pass
    with limits.request("paul", limit):
        pass


def test_a_stranger_who_asks_for_too_much(served: Served, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(front, "STRANGER", Limit(0.1, 20.0, 3))
    with served.client() as client:
        answers = [client.get("/static/icon.svg") for _ in range(30)]
    refused = [answer for answer in answers if answer.status_code == 429]
    assert refused
    assert all(int(answer.headers["Retry-After"]) > 0 for answer in refused)
    # Somebody who has signed in, at the same address, is not held up.
    assert served.program(VIEWER).get("/api/me").status_code == 200
