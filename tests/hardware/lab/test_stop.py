"""Nothing that anybody asks for, and nothing that breaks, keeps Stop, the operator's renewal and its lease waiting."""

import contextlib
import gc
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from argon2 import PasswordHasher
from serving import ADMINISTRATOR, LEASE_S, OPERATOR, VIEWER, Served, ended, job_of, scan, serve, sign_in, until

import jaxscan
from hardware.lab.database import DATABASE
from hardware.lab.reconstructor import Reconstructor

# A machine with other work is slow; whatever is held up here stays so until the test lets it go, and so fails.
SOON_S = 10.0
# More than the threads that a request may wait for.
CROWD = 60


class Dam:
    """Holds up whoever comes, until it is opened."""

    def __init__(self) -> None:
        self.come, self._opened = 0, threading.Event()

    def hold(self, *_: object, **__: object) -> bool:
        self.come += 1
        self._opened.wait(120)
        return True

    def open(self) -> None:
        self._opened.set()


@contextlib.contextmanager
def crowd(asks: Callable[[], object], count: int = CROWD) -> Iterator[None]:
    """Many who ask for the same, and wait for their answer."""
    with ThreadPoolExecutor(count) as pool:
        futures = [pool.submit(asks) for _ in range(count)]
        yield
        for future in futures:
            future.exception(120)


def moving(served: Served, client: httpx.Client) -> int:
    """The number of a move that is under way."""
    client.post("/api/lock", json={}).raise_for_status()
    number = client.post("/api/jobs", json={"kind": "move", "step": 20000}).json()["id"]
    until(lambda: served.moving)
    return number


def stops(served: Served, operator: httpx.Client, administrator: httpx.Client) -> None:
    """The operator says that it is there, an administrator stops, and the motor stands."""
    assert operator.put("/api/lock", timeout=SOON_S).status_code == 204
    answer = administrator.post("/api/stop", timeout=SOON_S)
    assert (answer.status_code, answer.json()) == (200, {"left_on": ""})
    until(lambda: not served.moving, SOON_S)


@pytest.mark.timeout(300)
def test_clouds_that_viewers_ask_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    dam = Dam()
    monkeypatch.setattr(Reconstructor, "make", dam.hold)
    camera = jaxscan.Camera.create((80, 64), (60.0, 60.0), (39.5, 31.5))
    rig = jaxscan.Rig(
        camera, (jaxscan.LightPlane.create((0.0, -0.004, 0.003)),), jaxscan.Linear.create((0.0, 0.0009, -0.0004))
    )
    served = serve(tmp_path / "lab", speed=10, rig=jaxscan.RigFile(rig))
    served.stage.home()
    operator, administrator, viewer = (served.program(name) for name in (OPERATOR, ADMINISTRATOR, VIEWER))
    operator.post("/api/lock", json={})
    for project in ("cup", "owl"):
        assert ended(operator, operator.post("/api/jobs", json=scan(project, 1)))["state"] == "done"
    statuses: list[int] = []

    def ask() -> None:
        answer = viewer.get("/api/projects/cup/cloud.ply", timeout=120)
        statuses.append(answer.status_code)
        if answer.status_code in (429, 503):
            assert int(answer.headers["Retry-After"]) > 0

    moving(served, operator)
    with crowd(ask):
        until(lambda: dam.come)
        stops(served, operator, administrator)
        # Whoever asks for something short is answered too. Clouds are looked up where lists are, of which one account
        # has a share: when all of its crowd but the two that may wait have had their answer, it is free again.
        until(lambda: len(statuses) >= CROWD - 2)
        assert viewer.get("/api/projects", timeout=SOON_S).status_code == 200
        dam.open()
    assert set(statuses) <= {200, 409, 429, 500, 503}
    assert {429, 503} & set(statuses)
    served.end()


@pytest.mark.timeout(300)
def test_sign_ins(slow: Served, monkeypatch: pytest.MonkeyPatch):
    operator, administrator = slow.program(OPERATOR), slow.program(ADMINISTRATOR)
    moving(slow, operator)
    dam = Dam()
    monkeypatch.setattr(PasswordHasher, "verify", dam.hold)
    clients = [slow.client() for _ in range(CROWD)]
    numbers = iter(range(CROWD))
    with crowd(lambda: sign_in(clients[(i := next(numbers))], f"name{i}", "wrong")):
        until(lambda: dam.come)
        # Until the rest of them have come too, or there is no thread left.
        with contextlib.suppress(httpx.TimeoutException):
            for _ in range(20):
                operator.get("/api/me", timeout=1)
        stops(slow, operator, administrator)
        dam.open()


@pytest.mark.timeout(300)
def test_a_database_that_is_locked(slow: Served):
    operator, administrator, viewer = (slow.program(name) for name in (OPERATOR, ADMINISTRATOR, VIEWER))
    number = moving(slow, operator)
    other = sqlite3.connect(slow.lab.projects.path("x").parents[1] / DATABASE, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with crowd(lambda: viewer.get("/api/jobs"), 20):
        stops(slow, operator, administrator)
        # The job ends, and the next one begins, though neither can be written down.
        job = until(lambda: (job := slow.lab.worker.latest) and job.ended_s and job)
        assert (job.id, job.message) == (number, f"stopped by {ADMINISTRATOR}")
    assert ended(operator, operator.post("/api/jobs", json={"kind": "home"}))["state"] == "done"
    other.execute("ROLLBACK")
    other.close()
    # And then they are.
    stored = slow.lab.projects.path("x").parents[1] / DATABASE
    with contextlib.closing(sqlite3.connect(stored)) as reader:
        states = "SELECT state FROM jobs ORDER BY id"
        until(lambda: reader.execute(states).fetchall() == [("aborted",), ("done",)])


@pytest.mark.timeout(300)
def test_an_order_whose_disk_is_slow(slow: Served, monkeypatch: pytest.MonkeyPatch):
    """A job that has not begun when Stop is pressed does not begin afterwards."""
    operator, administrator = slow.program(OPERATOR), slow.program(ADMINISTRATOR)
    operator.post("/api/lock", json={})
    dam, folder = Dam(), slow.lab.worker._folder
    monkeypatch.setattr(slow.lab.worker, "_folder", lambda work: dam.hold() and folder(work))
    with ThreadPoolExecutor(1) as pool:
        ordered = pool.submit(operator.post, "/api/jobs", json=scan("cup", 3))
        until(lambda: dam.come)
        stops(slow, slow.client(**operator.headers), administrator)
        dam.open()
        answer = ordered.result()
    assert (answer.status_code, "stopped" in answer.json()["detail"]) == (409, True)
    assert not slow.lab.worker.busy
    assert ended(operator, operator.post("/api/jobs", json=scan("cup", 3)))["state"] == "done"


@pytest.mark.timeout(300)
def test_the_lease_ends_while_an_order_hangs(brief: Served, monkeypatch: pytest.MonkeyPatch):
    operator = brief.program(OPERATOR)
    number = moving(brief, operator)
    dam = Dam()
    monkeypatch.setattr(brief.lab.worker, "_must_be_idle", dam.hold)
    with ThreadPoolExecutor(1) as pool:
        ordered = pool.submit(operator.post, "/api/jobs", json={"kind": "home"})
        until(lambda: dam.come)
        begin_s = time.monotonic()
        until(lambda: brief.lab.lock.holder is None)
        until(lambda: not brief.moving, SOON_S)
        assert brief.stage.true_position() < 20000
        assert time.monotonic() - begin_s < LEASE_S + SOON_S
        dam.open()
        ordered.result()
    watcher = brief.program(VIEWER)
    assert until(lambda: (job := job_of(watcher, number))["ended_s"] and job)["state"] == "aborted"


def test_what_stays_is_left_alone_by_collections(served: Served):
    """A full collection holds every thread up: it must not look at JAX and the web framework each time."""
    kept = gc.get_freeze_count()
    assert kept > 10 * len(gc.get_objects())
    assert served.program(VIEWER).get("/api/me").status_code == 200
