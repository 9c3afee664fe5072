"""Rigs of a lab: calibrated from its sessions, taken into use, and in use again after a restart.

The solve itself, in a process of its own and from a browser, is in `test_pages`.
"""

from pathlib import Path

import numpy as np
import pytest
from serving import OPERATOR, VIEWER, Served, serve

import jaxscan
from hardware.lab.reconstructor import Reconstructor
from jaxscan.errors import InputError
from jaxscan.images import write_image

SAID = ["good", "what limits it: the stage", "photograph next: nothing"]


def rig_of(distance: float, *warnings: str) -> jaxscan.RigFile:
    camera = jaxscan.Camera.create((80, 64), (60.0, 60.0), (39.5, 31.5))
    plane = jaxscan.LightPlane.create((0.0, -1 / distance, 0.003))
    rig = jaxscan.Rig(camera, (plane,), jaxscan.Linear.create((0.0, 0.0009, -0.0004)))
    return jaxscan.RigFile(rig, None, {"warnings": list(warnings)} if warnings else {})


def add_session(lab: Path, name: str) -> None:
    """A session folder that can be read."""
    folder = lab / "calibrations" / name
    folder.mkdir(parents=True)
    for i in range(3):
        write_image(folder / f"{i}.png", np.zeros((64, 80, 3), np.uint8))
    (folder / "session.toml").write_text(
        '[board]\ninner_corners = [9, 6]\nsquare_mm = 10.0\n[views]\nboards = "*.png"\n'
    )


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The sessions that were solved; that called `bad` cannot be."""
    done: list[str] = []

    def calibrate(made_by: Reconstructor, session: Path, to: Path) -> list[str]:
        if session.name == "bad":
            raise InputError(f"{session}: has three views of nothing: photograph the board")
        done.append(session.name)
        jaxscan.write_rig(to, rig_of(250.0 + len(done), f"solve {len(done)}"))
        return SAID

    monkeypatch.setattr(Reconstructor, "calibrate", calibrate)
    return done


def test_from_a_session_to_the_rig_in_use(tmp_path: Path, solved: list[str]) -> None:
    served = serve(tmp_path / "lab")
    for name in ("one", "two", "bad"):
        add_session(tmp_path / "lab", name)
    client, watcher = served.program(OPERATOR), served.program(VIEWER)
    try:
        assert client.get("/api/rigs").json() == []
        # Whoever does not operate looks on.
        assert client.post("/api/calibrations/one/rig").status_code == 403
        assert client.put("/api/rig", json={"name": ""}).status_code == 403
        assert client.post("/api/lock", json={}).status_code == 200
        made = client.post("/api/calibrations/one/rig").raise_for_status().json()
        assert (made["name"], made["in_use"], made["verdict"]) == ("one", False, SAID)
        assert client.get("/api/state").json()["rig"] is False
        refused = client.post("/api/calibrations/bad/rig")
        assert refused.status_code == 409
        assert refused.json()["detail"] == "bad: has three views of nothing: photograph the board"
        assert client.post("/api/calibrations/none/rig").status_code == 404
        assert client.put("/api/rig", json={"name": "two"}).status_code == 404
        for way_out in ("../one", "a/b", "in use"):
            assert client.put("/api/rig", json={"name": way_out}).status_code == 404
        state = client.put("/api/rig", json={"name": "one"}).raise_for_status().json()
        assert (state["rig"], state["rig_name"], state["rig_warnings"]) == (True, "one", ["solve 1"])
        client.post("/api/calibrations/two/rig").raise_for_status()
        assert [(rig["name"], rig["in_use"]) for rig in watcher.get("/api/rigs").json()] in (
            [("two", False), ("one", True)],
            [("one", True), ("two", False)],
        )
        # Calibrated once more, what is in use is the new one.
        client.post("/api/calibrations/one/rig").raise_for_status()
        assert watcher.get("/api/state").json()["rig_warnings"] == ["solve 3"]
        # None.
        assert client.put("/api/rig", json={"name": ""}).json()["rig"] is False
        client.put("/api/rig", json={"name": "two"}).raise_for_status()
    finally:
        served.end()
    # The next server goes on with it; one that is given another uses that, and has both.
    served = serve(tmp_path / "lab")
    try:
        state = served.program(VIEWER).get("/api/state").json()
        assert (state["rig_name"], state["rig_warnings"]) == ("two", ["solve 2"])
    finally:
        served.end()
    served = serve(tmp_path / "lab", rig=rig_of(300.0, "given"))
    client = served.program(OPERATOR)
    try:
        assert client.get("/api/state").json()["rig_warnings"] == ["given"]
        assert [rig["in_use"] for rig in client.get("/api/rigs").json()] == [False, False, True]
        client.post("/api/lock", json={}).raise_for_status()
        assert client.put("/api/rig", json={"name": "one"}).json()["rig_warnings"] == ["solve 3"]
        assert client.put("/api/rig", json={"name": ""}).json()["rig_warnings"] == ["given"]
    finally:
        served.end()
    assert solved == ["one", "two", "one"]


def test_a_rig_that_cannot_be_read_is_in_use_nowhere(tmp_path: Path, solved: list[str]) -> None:
    served = serve(tmp_path / "lab")
    add_session(tmp_path / "lab", "one")
    client = served.program(OPERATOR)
    client.post("/api/lock", json={}).raise_for_status()
    client.post("/api/calibrations/one/rig").raise_for_status()
    client.put("/api/rig", json={"name": "one"}).raise_for_status()
    served.end()
    (tmp_path / "lab" / "rigs" / "one.json").write_text("{")
    served = serve(tmp_path / "lab")
    client = served.program(OPERATOR)
    try:
        state = client.get("/api/state").json()
        assert (state["rig"], state["rig_name"]) == (False, "")
        client.post("/api/lock", json={}).raise_for_status()
        refused = client.put("/api/rig", json={"name": "one"})
        assert refused.status_code == 409
        assert "one.json" in refused.json()["detail"]
        assert str(tmp_path) not in refused.json()["detail"]
    finally:
        served.end()


def test_no_rig_is_changed_under_a_job(served: Served, solved: list[str]) -> None:
    client = served.program(OPERATOR)
    client.post("/api/lock", json={}).raise_for_status()
    served.camera.exposure_s = 0.5
    job = client.post("/api/jobs", json={"kind": "scan", "project": "cup", "frames": 20, "apart": 100, "settle_s": 0})
    assert job.status_code == 202
    refused = client.put("/api/rig", json={"name": ""})
    assert refused.status_code == 409
    assert "a job is under way" in refused.json()["detail"]
    served.camera.exposure_s = 0.0
    client.post(f"/api/jobs/{job.json()['id']}/abort")
