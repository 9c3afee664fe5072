"""One operator at all times, free again within the lease, and no move without a holder."""

import threading
import time
from pathlib import Path

import pytest
from serving import ADMINISTRATOR, LEASE_S, OPERATOR, VIEWER, Served, Witness, ended, job_of, scan, serve, until

from hardware.lab.lab import Lab
from jaxscan.errors import InputError

# The lease is looked after in twentieths of itself; the rest is for a machine with much to do.
FREE_S = LEASE_S + 2.0


def free_since(served: Served, watcher) -> float:
    """Wait until the scanner is free; how long that took."""
    begin_s = time.monotonic()
    until(lambda: watcher.get("/api/state").json()["operator"] is None)
    return time.monotonic() - begin_s


def test_one_of_many_gets_it(served: Served):
    clients = [served.program(name) for name in (OPERATOR, VIEWER) * 8]
    go, answers = threading.Barrier(len(clients)), []

    def take(client) -> None:
        go.wait()
        answers.append(client.post("/api/lock", json={}).status_code)

    threads = [threading.Thread(target=take, args=(client,)) for client in clients]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [200] + [409] * (len(clients) - 1)


def test_a_holder_that_is_heard_of_keeps_it(brief: Served):
    client, other = brief.program(OPERATOR), brief.program(VIEWER)
    client.post("/api/lock", json={})
    end_s = time.monotonic() + 2 * LEASE_S
    while time.monotonic() < end_s:
        assert client.put("/api/lock").status_code == 204
        assert other.post("/api/lock", json={}).status_code == 409
        assert other.put("/api/lock").status_code == 403
        time.sleep(LEASE_S / 5)
    assert client.delete("/api/lock").status_code == 204
    assert other.post("/api/lock", json={}).status_code == 200


def test_a_holder_that_is_cut_off_loses_it_and_its_move_is_stopped(brief: Served):
    """The network is cut: nothing more comes, and no connection is closed."""
    client, watcher = brief.program(OPERATOR), brief.program(VIEWER)
    with Witness(brief) as witness:
        client.post("/api/lock", json={})
        number = client.post("/api/jobs", json={"kind": "move", "step": 20000}).json()["id"]
        until(lambda: brief.moving)
        assert free_since(brief, watcher) < FREE_S
        job = until(lambda: (job := job_of(watcher, number))["ended_s"] and job)
    assert (job["state"], job["message"]) == ("aborted", "stopped: its operator is gone")
    assert not brief.moving
    assert brief.stage.true_position() < 20000
    # The order to stand goes out as the lock is given up.
    assert witness.orphaned_s < 0.5


def test_a_scan_keeps_it_without_its_holder_and_then_it_is_free(brief: Served):
    client, watcher = brief.program(OPERATOR), brief.program(VIEWER)
    with Witness(brief) as witness:
        client.post("/api/lock", json={})
        number = client.post("/api/jobs", json=scan("cup", 9)).json()["id"]
        client.close()
        begin_s = time.monotonic()
        while (job := job_of(watcher, number))["ended_s"] is None:
            assert watcher.post("/api/lock", json={}).status_code == 409
            time.sleep(0.05)
        assert job["state"] == "done"
        assert time.monotonic() - begin_s > LEASE_S
        assert free_since(brief, watcher) < FREE_S
    assert witness.orphaned_s == 0


def test_a_paused_scan_does_not_keep_it_and_another_goes_on_with_it(brief: Served):
    client, other = brief.program(OPERATOR), brief.program(VIEWER)
    with Witness(brief) as witness:
        client.post("/api/lock", json={})
        number = client.post("/api/jobs", json=scan("cup", 4)).json()["id"]
        until(lambda: job_of(client, number)["taken"] == 1)
        client.post(f"/api/jobs/{number}/pause")
        until(lambda: job_of(other, number)["state"] == "paused")
        assert free_since(brief, other) < FREE_S
        assert other.post("/api/lock", json={}).status_code == 200
        job = ended(other, other.post(f"/api/jobs/{number}/resume"))
    assert (job["state"], job["taken"], job["user"]) == ("done", 4, VIEWER)
    assert witness.orphaned_s == 0


def test_two_sign_ins_of_one_person_are_two(slow: Served):
    here, there = slow.browser(OPERATOR), slow.browser(OPERATOR)
    assert here.post("/api/lock", json={}).status_code == 200
    refused = there.post("/api/lock", json={})
    assert refused.status_code == 409
    assert "in another browser" in refused.json()["detail"]
    number = here.post("/api/jobs", json=scan("cup", 3)).json()["id"]
    assert there.post(f"/api/jobs/{number}/abort").status_code == 403
    # One's own scan can be taken along, and is not disturbed.
    assert there.post("/api/lock", json={"take_over": True}).json()["operator"]["name"] == OPERATOR
    assert here.put("/api/lock").status_code == 403
    assert here.post("/api/jobs", json={"kind": "home"}).status_code == 403
    assert until(lambda: (job := job_of(there, number))["ended_s"] and job)["state"] == "done"


def test_an_administrator_takes_over(slow: Served):
    client, viewer, administrator = slow.program(OPERATOR), slow.program(VIEWER), slow.program(ADMINISTRATOR)
    client.post("/api/lock", json={})
    assert viewer.post("/api/lock", json={"take_over": True}).status_code == 403
    number = client.post("/api/jobs", json={"kind": "move", "step": 20000}).json()["id"]
    until(lambda: slow.moving)
    with Witness(slow) as witness:
        assert administrator.post("/api/lock", json={"take_over": True}).status_code == 200
        assert client.post("/api/jobs", json={"kind": "home"}).status_code == 403
        job = until(lambda: (job := job_of(viewer, number))["ended_s"] and job)
        assert (job["state"], job["message"]) == ("aborted", "taken over")
        number = administrator.post("/api/jobs", json=scan("cup", 4)).json()["id"]
        until(lambda: job_of(viewer, number)["taken"] == 1)
    assert witness.orphaned_s == 0


def test_an_administrator_who_takes_a_scan_over_finds_it_paused(slow: Served):
    client, administrator = slow.program(OPERATOR), slow.program(ADMINISTRATOR)
    client.post("/api/lock", json={})
    number = client.post("/api/jobs", json=scan("cup", 4)).json()["id"]
    until(lambda: job_of(client, number)["taken"] == 1)
    administrator.post("/api/lock", json={"take_over": True})
    until(lambda: job_of(client, number)["state"] == "paused")
    assert client.post(f"/api/jobs/{number}/resume").status_code == 403
    job = ended(administrator, administrator.post(f"/api/jobs/{number}/resume"))
    assert (job["state"], job["user"]) == ("done", ADMINISTRATOR)


def test_nobody_leaves_a_running_scan(slow: Served):
    client = slow.program(OPERATOR)
    client.post("/api/lock", json={})
    client.post("/api/jobs", json=scan("cup", 3))
    refused = client.delete("/api/lock")
    assert refused.status_code == 409
    assert "pause or abort" in refused.json()["detail"]


def test_a_restart_in_mid_scan_frees_it_and_moves_nothing(tmp_path: Path):
    first = serve(tmp_path / "lab", speed=10)
    first.stage.home()
    client = first.program(OPERATOR)
    client.post("/api/lock", json={})
    number = client.post("/api/jobs", json=scan("cup", 6)).json()["id"]
    until(lambda: job_of(client, number)["taken"] == 1)
    first.end()
    assert not first.moving
    second = serve(tmp_path / "lab", speed=10)
    client = second.program(OPERATOR)
    assert client.get("/api/state").json()["operator"] is None
    assert job_of(client, number)["state"] == "interrupted"
    place = second.stage.true_position()
    time.sleep(0.2)
    assert second.stage.true_position() == place
    second.end()


def test_a_second_server_on_the_same_folder_is_refused(lasting: Served, tmp_path: Path):
    folder = lasting.lab.projects.path("x").parents[1]
    with pytest.raises(InputError, match="another lab server runs"):
        Lab(folder, lambda: None)  # type: ignore[arg-type]
