"""A guided calibration session in the lab; through a browser, on the simulated scanner, it is in `test_pages`."""

import io
import zipfile
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from serving import ADMINISTRATOR, OPERATOR, VIEWER, Served, job_of, until

from jaxscan.files.session import read_session

SQUARE = 40


def board(left: int) -> np.ndarray:
    """A checkerboard of 10 by 7 squares, so far from the left edge."""
    squares = np.indices((7, 10)).sum(axis=0) % 2
    image = np.full((400, 640, 3), 230, np.uint8)
    image[60 : 60 + 7 * SQUARE, left : left + 10 * SQUARE] = 230 - 200 * np.kron(squares, np.ones((SQUARE, SQUARE)))[
        ..., None
    ].astype(np.uint8)
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def order(name: str = "first", **how: int | float) -> dict:
    """An order for a short session."""
    return {"kind": "calibrate", "session": name, "views": 3, "stage_frames": 2, "stage_apart": 1000, **how}


def operator(served: Served) -> httpx.Client:
    """Who operates."""
    client = served.program(OPERATOR)
    assert client.post("/api/lock", json={}).status_code == 200
    return client


def begin(client: httpx.Client, **how: int | float) -> int:
    """Begin a session; its number, once it asks for something."""
    number = client.post("/api/jobs", json=order(**how)).raise_for_status().json()["id"]
    until(lambda: asks(client))
    return number


def asks(client: httpx.Client) -> dict:
    """What is asked for now, if anything is."""
    guide = client.get("/api/state").json()["guide"]
    return guide if guide and guide["wish"] else {}


def test_a_session_from_the_first_view_to_the_folder(served: Served, tmp_path: Path):
    client, watcher = operator(served), served.program(VIEWER)
    served.camera.held = board(60)
    number = begin(client)
    # The first time JAX compiles what refines the corners.
    guide = until(lambda: (guide := asks(watcher)) and guide["board_seen"] and guide, 200)
    assert "fills the middle" in guide["wish"]
    # Live: the laser shows where the stripe falls, and the corners are drawn over the picture.
    assert served.camera.laser.lit
    live = until(lambda: (answer := watcher.get("/api/picture")).status_code == 200 and answer.content)
    picture = cv2.imdecode(np.frombuffer(live, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (400, 640, 3)
    assert np.ptp(picture[60 + SQUARE, 60 + SQUARE].astype(int)) > 100
    assert watcher.post(f"/api/jobs/{number}/take").status_code == 403
    for view in range(3):
        assert client.post(f"/api/jobs/{number}/take").status_code == 202
        until(lambda view=view: (guide := asks(watcher)) and guide["views"] == view + 1)
    guide = asks(watcher)
    assert guide["on_axis"] == "stage"
    assert "fix the board on the stage" in guide["wish"]
    assert [any(row) for row in guide["covered"]] == [True, True, True]
    assert guide["tilted"] == {"upper": False, "lower": False, "left": False, "right": False}
    assert not served.moving
    assert client.post(f"/api/jobs/{number}/take").status_code == 202
    job = until(lambda: (job := job_of(client, number))["ended_s"] and job)
    assert (job["state"], job["taken"], job["total"], job["message"]) == ("done", 5, 5, "")
    assert not served.camera.laser.lit
    assert client.get("/api/state").json()["guide"] is None
    (listed,) = watcher.get("/api/calibrations").json()
    assert (listed["name"], listed["views"], listed["stage_images"], listed["problem"]) == ("first", 3, 2, "")
    archive = zipfile.ZipFile(io.BytesIO(watcher.get("/api/calibrations/first/session.zip").content))
    assert archive.testzip() is None
    archive.extractall(tmp_path / "fetched")
    session = read_session(tmp_path / "fetched" / "first")
    assert session.board.counts == (9, 6)
    assert len(session.views.boards) == len((session.views.stripes or {})[""]) == 3
    assert session.stage is not None
    assert session.stage.steps == (0, 1000)
    assert "is a calibration session first already" in client.post("/api/jobs", json=order()).json()["detail"]
    assert client.delete("/api/calibrations/first").status_code == 403
    administrator = served.program(ADMINISTRATOR)
    assert administrator.delete("/api/calibrations/first").status_code == 204
    assert administrator.delete("/api/calibrations/first").status_code == 404
    assert administrator.get("/api/calibrations/first/session.zip").status_code == 404


def test_a_board_that_is_not_in_view_is_said_and_too_few_poses_are_no_session(served: Served):
    client = operator(served)
    number = begin(client)
    assert not asks(client)["board_seen"]
    client.post(f"/api/jobs/{number}/take")
    until(lambda: "the board was not found" in job_of(client, number)["message"])
    until(lambda: asks(client))
    client.post(f"/api/jobs/{number}/enough")
    job = until(lambda: (job := job_of(client, number))["ended_s"] and job)
    assert (job["state"], job["message"]) == ("failed", "calibrations/first: ended after 0 poses, and 3 are the least")
    assert client.post(f"/api/jobs/{number}/take").status_code == 409
    assert client.get("/api/calibrations").json() == []
    # Nothing was kept, so the name is free.
    number = begin(client)
    assert client.post(f"/api/jobs/{number}/pause").status_code == 409
    client.post(f"/api/jobs/{number}/abort")
    assert until(lambda: (job := job_of(client, number))["ended_s"] and job)["state"] == "aborted"
    assert not served.camera.laser.lit


def test_without_its_operator_it_ends(brief: Served):
    client, watcher = brief.program(OPERATOR), brief.program(VIEWER)
    client.post("/api/lock", json={})
    brief.camera.held = board(60)
    number = client.post("/api/jobs", json=order()).raise_for_status().json()["id"]
    until(lambda: watcher.get("/api/state").json()["operator"] is None)
    job = until(lambda: (job := job_of(watcher, number))["ended_s"] and job)
    assert (job["state"], job["message"]) == ("aborted", "stopped: its operator is gone")
    assert not brief.camera.laser.lit
    assert brief.stage.true_position() == 0


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"views": 2}, "greater than or equal to 3"),
        ({"stage_frames": 1}, "1 stage photographs: give 2 or more"),
        ({"stage_apart": 0}, "at places of their own"),
        ({"stage_frames": 30}, "steps 0 to 29000: the stage goes from 0 to 20000"),
        ({"stage_apart": -1}, "steps -1 to 0: the stage goes from 0 to 20000"),
        ({"columns": 2}, "greater than or equal to 3"),
        ({"square_mm": 0}, "greater than or equal to 0.01"),
        ({"name": "../first"}, "pattern"),
    ],
)
def test_what_is_no_session_is_refused(lasting: Served, how: dict, says: str):
    client = operator(lasting)
    answer = client.post("/api/jobs", json=order(**how))
    assert answer.status_code == 422
    assert says in answer.text
    client.delete("/api/lock")
