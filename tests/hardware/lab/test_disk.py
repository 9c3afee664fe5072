"""A disk that is full or can only be read ends a job with a reason; nothing is lost, and the next order works."""

import json
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from serving import ADMINISTRATOR, OPERATOR, csrf_of, ended, job_of, scan, sign_in, until

from benchmarks.full_disk import full
from jaxscan.files.scan import read_scan
from jaxscan.images import read_image

FRAMES = 6
SERVE = """
import json, sys
from pathlib import Path
from serving import ADMINISTRATOR, OPERATOR, serve

served = serve(Path(sys.argv[1]), speed=10)
served.stage.home()
tokens = [served.lab.accounts.make_token_for(name) for name in (OPERATOR, ADMINISTRATOR)]
print(json.dumps([served.url, *tokens]), flush=True)
sys.stdin.readline()
served.end()
"""


@contextmanager
def server(folder: Path) -> Iterator[tuple[int, httpx.Client, httpx.Client]]:
    """A lab in a process of its own: its number, and the programs of operator and administrator."""
    env = {"PYTHONPATH": f"{Path(__file__).parents[3]}:{Path(__file__).parent}"}
    argv = [sys.executable, "-c", SERVE, str(folder)]
    child = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)
    assert child.stdin is not None
    assert child.stdout is not None
    url, *tokens = json.loads(child.stdout.readline())
    clients = [
        httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=30, trust_env=False)
        for token in tokens
    ]
    try:
        yield child.pid, clients[0], clients[1]
    finally:
        for client in clients:
            client.close()
        child.communicate("\n", 60)


@contextmanager
def read_only(pid: int, folder: Path) -> Iterator[None]:
    """The projects lie on a disk that can only be read."""
    projects = str(folder / "projects")

    def mount(*how: str) -> bool:
        return subprocess.run(["mount", *how], capture_output=True).returncode == 0

    if not mount("--bind", projects, projects):
        pytest.skip("mounting is not allowed here")
    try:
        until(lambda: mount("-o", "remount,bind,ro", projects), 10)
        yield
    finally:
        until(lambda: subprocess.run(["umount", projects], capture_output=True).returncode == 0, 20)


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="only Linux limits another process")
@pytest.mark.timeout(300)
@pytest.mark.parametrize("broken", [lambda pid, folder: full(pid), read_only], ids=["full", "read_only"])
def test_a_disk_that_fails_in_mid_scan(tmp_path: Path, broken):
    folder = tmp_path / "lab"
    with server(folder) as (pid, operator, administrator):
        operator.post("/api/lock", json={}).raise_for_status()
        number = operator.post("/api/jobs", json=scan("cup", FRAMES)).json()["id"]
        until(lambda: job_of(operator, number)["taken"] >= 1)
        with broken(pid, folder):
            job = until(lambda: (job := job_of(operator, number))["ended_s"] and job)
            assert job["state"] == "failed"
            assert "cannot be written" in job["message"]
            taken = job["taken"]
            assert 1 <= taken < FRAMES
            # Nothing is wedged: each order is answered, by what it does or by why it cannot.
            assert administrator.post("/api/stop").json() == {"left_on": ""}
            assert operator.post(f"/api/jobs/{number}/abort").status_code == 409
            for answer in (
                operator.post(f"/api/jobs/{number}/resume"),
                operator.post("/api/jobs", json=scan("owl", 2)),
            ):
                assert answer.status_code == 409, answer.text
                assert "owl" in answer.text or "cup" in answer.text or "disk" in answer.text
            assert ended(operator, operator.post("/api/jobs", json={"kind": "home"}))["state"] == "done"
            assert operator.get("/api/jobs").status_code == 200
        whole = read_scan(folder / "projects" / "cup")
        assert len(whole.frames) == taken
        for frame in whole.frames:
            read_image(frame)
        resumed = ended(operator, operator.post(f"/api/jobs/{number}/resume"))
        assert (resumed["state"], resumed["taken"], resumed["message"]) == ("done", FRAMES, "")
        assert ended(operator, operator.post("/api/jobs", json=scan("owl", 2)))["state"] == "done"
    with server(folder) as (_, operator, _):
        states = [(job["work"]["kind"], job["state"]) for job in operator.get("/api/jobs").json()]
        assert states == [("scan", "done"), ("home", "done"), ("scan", "done")]


@pytest.mark.timeout(300)
def test_nobody_is_shut_out_by_a_full_disk(tmp_path: Path):
    with server(tmp_path / "lab") as (pid, operator, administrator), full(pid):
        for client in (operator, administrator):
            assert client.get("/api/me").status_code == 200
        with httpx.Client(base_url=operator.base_url, timeout=30, trust_env=False) as browser:
            assert sign_in(browser, ADMINISTRATOR).status_code == 303
            assert browser.post("/api/stop", headers={"X-CSRF-Token": csrf_of(browser)}).status_code == 200
        assert operator.post("/api/lock", json={}).json()["operator"]["name"] == OPERATOR
        assert operator.post("/api/tokens", json={"name": "x"}).status_code in (403, 503)
