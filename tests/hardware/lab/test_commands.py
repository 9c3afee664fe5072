"""`scanner user` and `scanner serve`, as a user types them."""

import io
import json
import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from serving import PASSWORD, ended, job_of, scan, sign_in, until

from hardware.cli.main import main

FRAMES = 80
SCANNER = """
[camera]
kind = "folder"
source = "recorded"
[stage]
kind = "simulated"
last = 20000
[laser]
kind = "simulated"
"""


def user(monkeypatch: pytest.MonkeyPatch, *argv: str, typed: str = PASSWORD) -> int:
    monkeypatch.setattr(sys, "stdin", io.StringIO(typed + "\n"))
    return main(["user", *argv])


def test_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    data = ["--data", str(tmp_path / "lab"), "--password-stdin"]
    assert main(["user", "list", "--data", str(tmp_path / "lab")]) == 2
    assert "makes one" in capsys.readouterr().err
    assert user(monkeypatch, "add", "maria", "--admin", *data) == 0
    assert user(monkeypatch, "add", "paul", *data) == 0
    assert user(monkeypatch, "add", "Paul", *data) == 2
    assert "registered already" in capsys.readouterr().err
    assert user(monkeypatch, "add", "olga", *data, typed="short") == 2
    assert "10 to 1000 characters" in capsys.readouterr().err
    # Before a password is asked for: nobody types one.
    assert main(["user", "add", "paul", *data[:2]]) == 2
    assert "registered already" in capsys.readouterr().err
    assert main(["user", "password", "nobody", *data[:2]]) == 2
    assert "nobody of that name" in capsys.readouterr().err
    assert user(monkeypatch, "add", "../olga", *data) == 2
    assert "letters, digits" in capsys.readouterr().err
    assert user(monkeypatch, "add", *data) == 2
    assert "give a NAME" in capsys.readouterr().err
    assert main(["user", "list", *data, "--json"]) == 0
    everybody = [{"name": "maria", "administrator": True}, {"name": "paul", "administrator": False}]
    assert json.loads(capsys.readouterr().out)["users"] == everybody
    assert user(monkeypatch, "password", "paul", *data, typed="another password") == 0
    assert main(["user", "token", "paul", *data]) == 0
    assert len(capsys.readouterr().out.splitlines()[-1]) > 40
    assert main(["user", "remove", "paul", *data]) == 0
    assert main(["user", "remove", "paul", *data]) == 2
    assert "nobody of that name" in capsys.readouterr().err


def test_a_password_is_asked_for_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    typed = iter([PASSWORD, "something else"])
    monkeypatch.setattr("getpass.getpass", lambda words: next(typed))
    assert main(["user", "add", "maria", "--data", str(tmp_path)]) == 2
    assert "the two passwords differ" in capsys.readouterr().err


def test_a_password_cannot_be_asked_for_without_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    def closed(words: str) -> str:
        raise EOFError

    monkeypatch.setattr("getpass.getpass", closed)
    assert main(["user", "add", "maria", "--data", str(tmp_path)]) == 2
    assert "--password-stdin" in capsys.readouterr().err


STUCK = """
import sys, time
from hardware.cli.main import main
from hardware.lab.gallery import Gallery

begin = Gallery.__init__

def busy(self, *args):
    begin(self, *args)
    self._profiles.do(lambda: time.sleep(600))

Gallery.__init__ = busy
sys.exit(main(["serve", "--port", "0"]))
"""


def test_a_server_ends_while_a_profile_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The first one compiles, for minutes on a busy machine: a server that was told to end waited for it."""
    monkeypatch.chdir(tmp_path)
    assert user(monkeypatch, "add", "maria", "--password-stdin") == 0
    root = str(Path(__file__).parents[3])
    child = subprocess.Popen([sys.executable, "-c", STUCK], stderr=subprocess.PIPE, text=True, env={"PYTHONPATH": root})
    assert child.stderr is not None
    assert any("serving at" in line for line in child.stderr)
    child.terminate()
    try:
        _, err = child.communicate(timeout=120)
    finally:
        child.kill()
    assert (child.returncode, err) == (130, "scanner: interrupted\n")


def test_a_server_that_is_killed_in_mid_scan_and_started_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """`scanner serve` as a process of its own: kill -9, start, what it says of the scan, and on."""
    import cv2
    import numpy as np

    monkeypatch.chdir(tmp_path)
    Path("recorded").mkdir()
    for i in range(100):
        cv2.imwrite(f"recorded/{i}.png", np.full((40, 50, 3), i, np.uint8))
    Path("scanner.toml").write_text(SCANNER)
    assert user(monkeypatch, "add", "maria", "--password-stdin") == 0

    def start() -> tuple[subprocess.Popen, httpx.Client]:
        argv = [sys.executable, "-m", "hardware", "serve", "--port", "0"]
        root = str(Path(__file__).parents[3])
        child = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True, env={"PYTHONPATH": root})
        assert child.stderr is not None
        url = next(found for line in child.stderr if (found := re.search(r"serving at (\S+)", line)))
        client = httpx.Client(base_url=url[1], trust_env=False, timeout=20)
        assert sign_in(client, "maria").status_code == 303
        found = re.search(r'name="csrf" content="([^"]+)"', client.get("/").text)
        assert found
        client.headers["X-CSRF-Token"] = found[1]
        return child, client

    child, client = start()
    client.post("/api/lock", json={}).raise_for_status()
    number = client.post("/api/jobs", json=scan("cup", FRAMES, apart=100)).json()["id"]
    taken = until(lambda: job_of(client, number)["taken"])
    child.kill()
    child.communicate()
    client.close()
    child, client = start()
    job = job_of(client, number)
    assert job["state"] == "interrupted"
    assert client.get("/api/state").json()["operator"] is None
    client.post("/api/lock", json={}).raise_for_status()
    job = ended(client, client.post(f"/api/jobs/{number}/resume"))
    assert (job["state"], job["taken"], job["message"]) == ("done", FRAMES, "")
    assert 0 < taken < FRAMES
    client.close()
    child.terminate()
    _, err = child.communicate(timeout=120)
    assert (child.returncode, err) == (130, "scanner: interrupted\n")
