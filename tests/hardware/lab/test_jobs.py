"""Jobs: what an operator orders, and what comes of it."""

import gc
import io
import threading
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from serving import COLUMNS, OPERATOR, ROWS, TURNTABLE, VIEWER, Served, ended, job_of, scan, serve, until

import jaxscan
from jaxscan.files.scan import read_scan

# A rig that sees the stripe of the test's camera some 300 mm away.
FOCAL, PRINCIPAL, OMEGA, PER_STEP = (60.0, 60.0), (39.5, 31.5), (0.0, -0.004, 0.003), (0.0, 0.0009, -0.0004)


def operator(served: Served):
    client = served.program(OPERATOR)
    assert client.post("/api/lock", json={}).status_code == 200
    return client


def test_home_move_shoot_and_batch_into_one_project(served: Served, tmp_path: Path):
    client = operator(served)
    assert ended(client, client.post("/api/jobs", json={"kind": "home"}))["state"] == "done"
    assert client.get("/api/state").json()["axes"]["stage"]["place"] == 0
    assert ended(client, client.post("/api/jobs", json={"kind": "move", "step": 1500}))["state"] == "done"
    assert client.get("/api/state").json()["axes"]["stage"]["place"] == 1500
    shot = ended(client, client.post("/api/jobs", json={"kind": "shoot", "project": "cup", "step": 300, "settle_s": 0}))
    assert (shot["state"], shot["taken"], shot["user"]) == ("done", 1, OPERATOR)
    done = ended(client, client.post("/api/jobs", json=scan("cup", first=1000)))
    assert (done["state"], done["taken"], done["total"]) == ("done", 3, 3)
    listed = client.get("/api/projects").json()
    assert [(one["name"], one["frames"]) for one in listed] == [("cup", 4)]
    archive = zipfile.ZipFile(io.BytesIO(client.get("/api/projects/cup/scan.zip").content))
    assert archive.testzip() is None
    archive.extractall(tmp_path / "fetched")
    assert read_scan(tmp_path / "fetched" / "cup").axes["stage"] == (300, 1000, 2000, 3000)
    assert client.get("/api/projects/cup/frames/3").content.startswith(b"\x89PNG")
    assert not served.camera.laser.lit
    assert [job["work"]["kind"] for job in client.get("/api/jobs").json()] == ["scan", "shoot", "move", "home"]


def test_photographs_are_shown_with_profile_and_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # The quick detector, at the size at which it has been compiled for the profile.
    monkeypatch.setattr(jaxscan, "reconstruct", partial(jaxscan.reconstruct, detector="derivative"), raising=False)
    camera = jaxscan.Camera.create((COLUMNS, ROWS), FOCAL, PRINCIPAL)
    rig = jaxscan.Rig(camera, (jaxscan.LightPlane.create(OMEGA),), jaxscan.Linear.create(PER_STEP))
    served = serve(tmp_path / "lab", profiles=True, rig=jaxscan.RigFile(rig))
    client = operator(served)
    kept = gc.get_freeze_count()
    assert client.get("/api/picture").status_code == 404
    ended(client, client.post("/api/jobs", json=scan("cup", 2)))
    picture = until(lambda: (answer := client.get("/api/picture")).status_code == 200 and answer)
    assert picture.content.startswith(b"\xff\xd8\xff")
    again = client.get("/api/picture", headers={"If-None-Match": picture.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    profile = until(lambda: (answer := client.get("/api/profile")).status_code == 200 and answer, 200).json()
    profile = until(lambda: (found := client.get("/api/profile").json())["number"] == 1 and found)
    # What JAX has compiled for the first one is not looked at by collections of garbage, which hold up Stop.
    assert gc.get_freeze_count() > kept + 1000
    expected = 20 + 20 * 1000 / 20000 + 3 * np.sin(np.array(profile["line"]) / 12)
    assert len(profile["line"]) > 70
    assert np.abs(np.array(profile["position"]) - expected).max() < 0.2
    # X = x / (ω · x) − n · per_step.
    pixels = np.stack([profile["line"], profile["position"]], axis=1)
    rays = np.concatenate([(pixels - PRINCIPAL) / FOCAL, np.ones((len(pixels), 1))], axis=1)
    points = rays / (rays @ OMEGA)[:, None] - 1000 * np.array(PER_STEP)
    assert np.abs(np.array(profile["points"]) - points).max() < 0.05
    cloud = np.frombuffer(client.get("/api/cloud").content, "<f4").reshape(-1, 3)
    assert len(cloud) == profile["cloud_points"] == 2 * COLUMNS
    assert np.abs(cloud[COLUMNS:] - points).max() < 0.05
    client.post("/api/lock", json={})
    ended(client, client.post("/api/jobs", json={"kind": "shoot", "project": "one", "step": 1000, "settle_s": 0}))
    (tmp_path / "one.ply").write_bytes(
        client.get("/api/projects/one/cloud.ply", timeout=200).raise_for_status().content
    )
    # Made by another process, with the default detector: held against the stripe that was drawn.
    pixels[:, 1] = expected
    rays = np.concatenate([(pixels - PRINCIPAL) / FOCAL, np.ones((len(pixels), 1))], axis=1)
    drawn = rays / (rays @ OMEGA)[:, None] - 1000 * np.array(PER_STEP)
    assert np.abs(jaxscan.read_ply(tmp_path / "one.ply").points - drawn).max() < 0.05
    served.end()


def test_pause_resume_abort_and_go_on(slow: Served):
    client = operator(slow)
    number = client.post("/api/jobs", json=scan("cup", 5)).json()["id"]
    until(lambda: job_of(client, number)["taken"] == 1)
    assert client.post(f"/api/jobs/{number}/pause").json()["state"] == "pausing"
    until(lambda: job_of(client, number)["state"] == "paused")
    taken = job_of(client, number)["taken"]
    assert not slow.moving
    assert not slow.camera.laser.lit
    assert client.post("/api/jobs", json={"kind": "move", "step": 0}).status_code == 409
    assert client.post(f"/api/jobs/{number}/resume").json()["state"] == "running"
    until(lambda: job_of(client, number)["taken"] > taken)
    assert client.post(f"/api/jobs/{number}/abort").status_code == 202
    job = until(lambda: (job := job_of(client, number))["ended_s"] and job)
    assert (job["state"], job["message"]) == ("aborted", f"aborted by {OPERATOR}")
    assert 1 < job["taken"] < 5
    resumed = ended(client, client.post(f"/api/jobs/{number}/resume"))
    assert (resumed["state"], resumed["taken"]) == ("done", 5)
    assert slow.lab.projects.scan("cup").axes["stage"] == (0, 1000, 2000, 3000, 4000)


def test_stop_is_at_once(slow: Served):
    client = operator(slow)
    number = client.post("/api/jobs", json={"kind": "move", "step": 20000}).json()["id"]
    until(lambda: slow.moving)
    assert client.post("/api/stop").json() == {"left_on": ""}
    job = until(lambda: (job := job_of(client, number))["ended_s"] and job)
    assert (job["state"], job["message"]) == ("aborted", f"stopped by {OPERATOR}")
    assert not slow.moving
    assert client.get("/api/state").json()["axes"]["stage"]["place"] is None


def test_a_job_that_ends_as_it_is_stopped(slow: Served, monkeypatch: pytest.MonkeyPatch):
    """The job's thread has done with the devices before the one that stops them has begun."""

    class Late(threading.Thread):
        def start(self) -> None:
            if self.name.startswith("stop job"):
                slow.stage.stop()
                time.sleep(0.3)
            super().start()

    monkeypatch.setattr(threading, "Thread", Late)
    client = operator(slow)
    number = client.post("/api/jobs", json={"kind": "move", "step": 20000}).json()["id"]
    until(lambda: slow.moving)
    assert client.post(f"/api/jobs/{number}/abort").status_code == 202
    assert until(lambda: (job := job_of(client, number))["ended_s"] and job, 10)["state"] == "aborted"
    assert ended(client, client.post("/api/jobs", json={"kind": "home"}))["state"] == "done"


def test_what_does_not_answer_is_said_before_anything_moves(served: Served):
    client = operator(served)
    served.camera.broken = True
    before = served.stage.true_position()
    job = ended(client, client.post("/api/jobs", json=scan("cup")))
    assert (job["state"], job["taken"]) == ("failed", 0)
    assert "check the camera's cable" in job["message"]
    assert served.stage.true_position() == before
    served.camera.broken = False
    assert ended(client, client.post("/api/jobs", json={"kind": "check"}))["state"] == "done"
    resumed = ended(client, client.post(f"/api/jobs/{job['id']}/resume"))
    assert (resumed["state"], resumed["message"]) == ("done", "")


@pytest.mark.parametrize(
    ("work", "status", "says"),
    [
        ({"kind": "move", "step": 20001}, 422, "the stage goes from 0 to 20000"),
        (scan("cup", 30), 422, "the stage goes from 0 to 20000"),
        (scan("cup", 3, apart=0), 409, "place of its own"),
        (scan("../cup"), 422, "pattern"),
        (scan("cup", 0), 422, "greater than or equal to 1"),
        ({"kind": "move", "step": "1"}, 422, "valid integer"),
        ({"kind": "move", "step": True}, 422, "valid integer"),
        (scan("cup", dark="yes"), 422, "valid boolean"),
        ({"kind": "jump"}, 422, "does not match any of the expected tags"),
        ({"kind": "home", "fast": True}, 422, "Extra inputs"),
    ],
)
def test_what_cannot_be_is_refused(lasting: Served, work: dict, status: int, says: str):
    client = operator(lasting)
    answer = client.post("/api/jobs", json=work)
    assert answer.status_code == status
    assert says in answer.text
    client.delete("/api/lock")
    assert client.get("/api/projects").json() == []


def test_a_place_is_photographed_once(served: Served):
    client = operator(served)
    ended(client, client.post("/api/jobs", json=scan("cup")))
    answer = client.post("/api/jobs", json={"kind": "shoot", "project": "cup", "step": 1000})
    assert answer.status_code == 409
    assert "has a photograph of step 1000 already" in answer.json()["detail"]
    assert "begun without dark" in client.post("/api/jobs", json=scan("cup", first=9000, dark=True)).text


def test_an_interrupted_scan_reports_itself_and_goes_on(tmp_path: Path):
    first = serve(tmp_path / "lab", speed=10)
    first.stage.home()
    client = operator(first)
    number = client.post("/api/jobs", json=scan("cup", 6)).json()["id"]
    until(lambda: job_of(client, number)["taken"] == 2)
    first.end()
    assert not first.moving
    second = serve(tmp_path / "lab")
    client = second.program(OPERATOR)
    job = client.get("/api/state").json()["job"]
    assert (job["id"], job["state"]) == (number, "interrupted")
    assert "the server ended" in job["message"]
    assert client.get("/api/state").json()["operator"] is None
    assert client.post(f"/api/jobs/{number}/resume").status_code == 403
    client.post("/api/lock", json={})
    assert ended(client, client.post(f"/api/jobs/{number}/resume"))["state"] == "done"
    assert len(second.lab.projects.scan("cup").frames) == 6
    second.end()


def test_the_live_picture_goes_off_with_its_operator(served: Served):
    client = operator(served)
    assert client.put("/api/live", json={"on": True, "laser": True}).status_code == 204
    until(lambda: served.camera.taken > 3)
    assert client.get("/api/picture").status_code == 200
    client.delete("/api/lock")
    until(lambda: not served.lab.preview.on)
    taken = served.camera.taken
    watcher = served.program(VIEWER)
    assert watcher.get("/api/state").json()["live"] is False
    assert served.camera.taken <= taken + 1
    assert not served.camera.laser.lit


def test_an_administrator_removes_a_project(served: Served):
    client, administrator = operator(served), served.program("maria")
    ended(client, client.post("/api/jobs", json=scan("cup", 1)))
    assert client.delete("/api/projects/cup").status_code == 403
    assert administrator.delete("/api/projects/cup").status_code == 204
    assert administrator.delete("/api/projects/cup").status_code == 404
    assert client.get("/api/projects/cup").status_code == 404


@pytest.fixture
def turning(tmp_path: Path) -> Iterator[Served]:
    """A lab with a turntable, whose motors take time."""
    served = serve(tmp_path / "lab", speed=10, turntable=True)
    yield served
    served.end()


def around(project: str, frames: int = 4, **how: object) -> dict[str, object]:
    """An order for a scan around the turntable."""
    return {"kind": "scan", "project": project, "axis": "turntable", "frames": frames, "settle_s": 0, **how}


def test_jobs_on_two_axes(turning: Served):
    client = operator(turning)
    assert ended(client, client.post("/api/jobs", json={"kind": "home", "axis": "turntable"}))["state"] == "done"
    axes = client.get("/api/state").json()["axes"]
    assert axes == {
        "stage": {"place": None, "first": 0, "last": 20000, "steps_per_turn": None},
        "turntable": {"place": 0, "first": 0, "last": 3200, "steps_per_turn": 3200},
    }
    assert ended(client, client.post("/api/jobs", json={"kind": "home"}))["state"] == "done"
    moved = client.post("/api/jobs", json={"kind": "move", "axis": "turntable", "step": 800})
    assert ended(client, moved)["state"] == "done"
    places = {name: axis["place"] for name, axis in client.get("/api/state").json()["axes"].items()}
    assert places == {"stage": 0, "turntable": 800}
    shot = {"kind": "shoot", "project": "owl", "axis": "turntable", "step": 100, "at": {"stage": 3000}, "settle_s": 0}
    assert ended(client, client.post("/api/jobs", json=shot))["state"] == "done"
    number = client.post("/api/jobs", json=around("owl", at={"stage": 3000})).json()["id"]
    until(lambda: job_of(client, number)["taken"] == 1)
    assert client.post("/api/stop").json() == {"left_on": ""}
    until(lambda: job_of(client, number)["ended_s"])
    assert {axis["place"] for axis in client.get("/api/state").json()["axes"].values()} == {None}
    resumed = ended(client, client.post(f"/api/jobs/{number}/resume"))
    assert (resumed["state"], resumed["taken"]) == ("done", 4)
    scan = turning.lab.projects.scan("owl")
    assert scan.axes == {"turntable": (100, 0, 800, 1600, 2400), "stage": (3000,) * 5}
    again = client.post("/api/jobs", json=around("owl", at={"stage": 3000}))
    assert "has a photograph of turntable 0, stage 3000 already" in again.json()["detail"]
    other = client.post("/api/jobs", json={"kind": "shoot", "project": "owl", "step": 5})
    assert (other.status_code, "for another" in other.json()["detail"]) == (409, True)


@pytest.mark.parametrize(
    ("work", "says"),
    [
        ({"kind": "home", "axis": "lift"}, "no axis lift, but stage, turntable"),
        ({"kind": "move", "axis": "lift", "step": 1}, "no axis lift, but stage, turntable"),
        ({"kind": "move", "axis": "turntable", "step": 3201}, "the turntable goes from 0 to 3200"),
        (around("owl"), "where the stage is to stand"),
        (around("owl", at={"stage": 20001}), "the stage goes from 0 to 20000"),
        (around("owl", 40, apart=100, at={"stage": 0}), "1.22 turns"),
        (around("owl", at={"stage": 0, "lift": 0}), "no axis lift"),
        ({**around("owl"), "axis": "stage"}, "a full turn of the stage"),
    ],
)
def test_axes_that_cannot_be_sent_there(turning: Served, work: dict[str, object], says: str):
    client = operator(turning)
    answer = client.post("/api/jobs", json=work)
    assert (answer.status_code, says in answer.json()["detail"]) == (422, True), answer.text
    assert client.get("/api/projects").json() == []


def test_no_axis_moves_once_nobody_operates(turning: Served):
    client = operator(turning)
    ended(client, client.post("/api/jobs", json={"kind": "home"}))
    number = client.post("/api/jobs", json={"kind": "move", "axis": "turntable", "step": 3200}).json()["id"]
    client.delete("/api/lock")
    job = until(lambda: (job := job_of(client, number))["ended_s"] and job)
    assert job["state"] == "aborted"


def test_a_scan_without_a_switch_goes_on_only_while_its_zero_is_known(tmp_path: Path):
    served = serve(tmp_path / "lab", turntable=True)
    served.lab.habits.travels["turntable"] = replace(TURNTABLE, reference="here")
    client = operator(served)
    done = ended(client, client.post("/api/jobs", json=around("owl", 2, at={"stage": 0})))
    assert done["state"] == "done"
    more = client.post("/api/jobs", json=around("owl", 2, at={"stage": 5000}))
    assert ended(client, more)["state"] == "done"
    client.post("/api/stop")
    refused = client.post("/api/jobs", json=around("owl", 2, at={"stage": 9000}))
    assert refused.status_code == 409
    assert "the turntable has no switch" in refused.json()["detail"]
    served.end()
