"""Many scans: all that can be done is done, once; what cannot says why."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.cloud import read_ply
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import Scan, write_scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.reconstruction import batch
from jaxscan.reconstruction.batch import find_tasks, reconstruct_one, run_batch
from tests.reconstruction.small import small_rig, wavy_stripe

NAMES = ("cups/1", "cups/2", "cups/10", "dish")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Four scans of two frames and their rig; the second's last frame is cut short."""
    for i, name in enumerate(NAMES):
        folder = tmp_path / "scans" / name
        folder.mkdir(parents=True)
        paths = []
        for k in range(2):
            paths.append(folder / f"{k}.png")
            write_image(paths[-1], np.rint(wavy_stripe(i + k)).astype(np.uint8))
        write_scan(Scan(folder / "scan.toml", StripeSettings("grey"), tuple(paths), axes={"stage": (0, 1000)}))
    broken = tmp_path / "scans" / NAMES[1] / "1.png"
    broken.write_bytes(broken.read_bytes()[:300])
    write_rig(tmp_path / "rig.json", RigFile(small_rig()))
    return tmp_path


def command(tree: Path, *more: str) -> int:
    out = ["--rig", str(tree / "rig.json"), "-o", str(tree / "out"), "--detector", "gravity"]
    return main(["batch", str(tree / "scans"), *out, *more])


def test_what_fails_does_not_stop_the_rest_and_is_tried_again(tree, capsys):
    assert command(tree, "--json") == 1
    heard = capsys.readouterr()
    result = json.loads(heard.out)
    assert {one["scan"] for one in result["done"]} == {"cups/1", "cups/10", "dish"}
    (failed,) = result["failed"]
    assert failed["scan"] == "cups/2"
    assert "1.png" in failed["reason"]
    assert "cut off" in heard.err
    outputs = {
        path.relative_to(tree / "out").as_posix(): path.stat().st_mtime_ns for path in (tree / "out").rglob("*.*")
    }
    assert set(outputs) == {"cups/1.ply", "cups/10.ply", "dish.ply"}
    first = read_ply(tree / "out" / "dish.ply").points
    assert len(first) > 100

    (tree / "scans" / NAMES[1] / "1.png").write_bytes((tree / "scans" / NAMES[1] / "0.png").read_bytes())
    (tree / "out" / "dish.ply").unlink()
    assert command(tree) == 0
    assert "2 of 4 scans reconstructed" in capsys.readouterr().out
    np.testing.assert_array_equal(read_ply(tree / "out" / "dish.ply").points, first)
    for name in ("cups/1.ply", "cups/10.ply"):
        assert (tree / "out" / name).stat().st_mtime_ns == outputs[name]

    os.utime(tree / "rig.json")
    assert not any(task.is_done(tree / "rig.json") for task in find_tasks(tree / "scans", tree / "out"))


def test_the_order_is_natural_and_results_in_the_tree_are_no_scans(tree):
    assert [task.name for task in find_tasks(tree / "scans", tree / "scans" / "cups")] == ["dish"]
    assert [task.name for task in find_tasks(tree / "scans", tree / "out")] == list(NAMES)


def test_two_scans_of_one_name_are_refused(tree):
    (tree / "scans" / "Dish").mkdir()
    (tree / "scans" / "Dish" / "scan.toml").write_text("")
    with pytest.raises(InputError, match=r"Dish.*dish.*rename|dish.*Dish.*rename"):
        find_tasks(tree / "scans", tree / "out")


def test_no_scans(tree):
    (tree / "empty").mkdir()
    with pytest.raises(InputError, match=r"no scan\.toml"):
        find_tasks(tree / "empty", tree / "out")
    with pytest.raises(InputError, match="is no folder"):
        find_tasks(tree / "rig.json", tree / "out")


def test_a_scheduler_that_does_not_answer(tree, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(batch, "_ANSWER_S", 1)
    tasks = find_tasks(tree / "scans", tree / "out")
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        list(run_batch(tasks, tree / "rig.json", scheduler="tcp://127.0.0.1:9"))


def test_on_a_cluster(tree):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        tasks = find_tasks(tree / "scans", tree / "out")
        outcomes = list(run_batch(tasks, tree / "rig.json", "gravity", scheduler=cluster.scheduler_address))
    assert sorted(o.task.name for o in outcomes if o.points) == sorted(set(NAMES) - {"cups/2"})
    assert next(o.reason for o in outcomes if not o.points).count("cut off") == 1


@pytest.mark.parametrize("ending", [".ply", ".npz"])
def test_a_cluster_that_runs_a_task_again_does_not_do_its_work_again(tree, ending):
    """The worker that holds an answer is closed before it was fetched; the other is given the task once more."""
    distributed = pytest.importorskip("distributed")
    task = find_tasks(tree / "scans", tree, ending)[-1]
    argument = (task, tree / "rig.json", None, "gravity", "strongest")
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster, set_as_default=False) as client:
        first, second = client.scheduler_info()["workers"]
        future = client.submit(reconstruct_one, *argument, pure=False, workers=[first], allow_other_workers=True)
        with client.as_current():
            distributed.wait(future, timeout=60)
        made = task.made_at()
        assert [len(keys) for keys in client.has_what([first, second]).values()] == [1, 0]
        (worker,) = (w for w in cluster.workers.values() if w.address == first)
        cluster.sync(worker.close)
        points = future.result(timeout=60)
        assert [tuple(on) for on in client.who_has([future]).values()] == [(second,)]
    assert points > 100
    assert task.made_at() == made

    # What stood there when a batch began is of other options, or older than the rig: it is made anew.
    assert reconstruct_one(*argument[:2], made, *argument[3:]) == points
    assert task.made_at() != made
    made = task.made_at()
    os.utime(tree / "rig.json")
    assert reconstruct_one(*argument) == points
    assert task.made_at() != made
