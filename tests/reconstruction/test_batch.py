"""Many scans: all that can be done is done, once; what cannot says why."""

import json
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.deadline import Workers
from jaxscan.errors import InputError
from jaxscan.files.cloud import read_ply
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import Scan, write_scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.reconstruction import batch, frames
from jaxscan.reconstruction.batch import Made, Options, find_tasks, held, reconstruct_one, run_batch
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
        path.relative_to(tree / "out").as_posix(): path.stat().st_mtime_ns for path in (tree / "out").rglob("*.ply")
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
        outcomes = list(run_batch(tasks, tree / "rig.json", Options("gravity"), scheduler=cluster.scheduler_address))
    assert sorted(o.task.name for o in outcomes if o.points) == sorted(set(NAMES) - {"cups/2"})
    assert next(o.reason for o in outcomes if not o.points).count("cut off") == 1


@pytest.mark.parametrize("ending", [".ply", ".npz"])
def test_a_cluster_that_runs_a_task_again_does_not_do_its_work_again(tree, ending):
    """The worker that holds an answer is closed before it was fetched; the other is given the task once more."""
    distributed = pytest.importorskip("distributed")
    task = find_tasks(tree / "scans", tree, ending)[-1]
    argument = (task, tree / "rig.json", None, Options("gravity", "strongest"))
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
        points = future.result(timeout=60).points
        assert [tuple(on) for on in client.who_has([future]).values()] == [(second,)]
    assert points > 100
    assert task.made_at() == made

    # What stood there when a batch began is of other options, or older than the rig: it is made again.
    assert reconstruct_one(*argument[:2], made, *argument[3:]) == Made(points)
    assert task.made_at() != made
    made = task.made_at()
    os.utime(tree / "rig.json")
    assert reconstruct_one(*argument) == Made(points)
    assert task.made_at() != made


def test_other_options_make_it_anew(tree, capsys):
    """Whether a scan was done was asked without a look at how: results of the old options were kept."""
    command(tree)
    capsys.readouterr()
    assert command(tree, "--depths", "1,1000", "--json") == 1
    result = json.loads(capsys.readouterr().out)
    assert (len(result["done"]), result["kept"]) == (3, 0)
    assert command(tree, "--depths", "1,1000", "--json") == 1
    result = json.loads(capsys.readouterr().out)
    assert (len(result["done"]), result["kept"]) == (0, 3)


def test_links_that_lead_back_are_followed_once(tree):
    """A link to a folder above it was followed for ever."""
    scans = tree / "scans"
    (scans / "cups" / "back").symlink_to(scans)
    (scans / "again").symlink_to(scans / "dish")
    elsewhere = tree / "elsewhere" / "bowl"
    elsewhere.mkdir(parents=True)
    (elsewhere / "scan.toml").write_text("")
    (elsewhere / "back").symlink_to(scans)
    (scans / "linked").symlink_to(tree / "elsewhere")
    assert [task.name for task in find_tasks(scans, tree / "out")] == [*NAMES, "linked/bowl"]


def test_two_batches_in_one_folder(tree, capsys):
    """Both did all scans."""
    with held(tree / "out", Options()):
        assert command(tree) == 2
        assert f"out: is in use by process {os.getpid()}" in capsys.readouterr().err
    assert not list((tree / "out").rglob("*.ply"))
    assert command(tree) == 1


def test_what_a_scan_shows_to_be_wrong_is_said_of_it_alone(tree, capsys):
    """One is overexposed; its note came with another's points, or not at all."""
    for k in range(2):
        image = np.rint(wavy_stripe(k)).astype(np.uint8)
        image[70:] = 255
        write_image(tree / "scans" / "dish" / f"{k}.png", image)
    assert command(tree, "--json") == 1
    notes = {one["scan"]: one["notes"] for one in json.loads(capsys.readouterr().out)["done"]}
    assert "overexposed" in " ".join(notes["dish"])
    assert notes["cups/1"] == notes["cups/10"] == []


@pytest.mark.parametrize("cores", [1, pytest.param(2, marks=pytest.mark.long), 64])
def test_threads_and_memory_are_bounded_on_any_machine(tree, cores, monkeypatch):
    """Each of 64 scans took a pool of 64 threads, and a ring of 384 MiB."""
    for i in range(70):
        folder = tree / "scans" / f"more{i}"
        folder.mkdir()
        for k in range(2):
            (folder / f"{k}.png").write_bytes((tree / "scans" / "dish" / "0.png").read_bytes())
        paths = tuple(folder / f"{k}.png" for k in range(2))
        write_scan(Scan(folder / "scan.toml", StripeSettings("grey"), paths, axes={"stage": (0, 1000)}))
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    batch._scanner.cache_clear()
    most, rings, at_once, own = [0], [0], [0], threading.Lock()

    class Counted(Workers):
        def __enter__(self):
            with own:
                rings[0] += 1
                most[0], at_once[0] = max(most[0], rings[0] * (len(self._threads) + 1)), max(at_once[0], rings[0])
            return super().__enter__()

        def __exit__(self, *of: Any):
            with own:
                rings[0] -= 1
            return super().__exit__(*of)

    monkeypatch.setattr(frames, "Workers", Counted)
    outcomes = list(run_batch(find_tasks(tree / "scans", tree / "out"), tree / "rig.json", Options("gravity")))
    batch._scanner.cache_clear()
    assert sum(outcome.points is not None for outcome in outcomes) == 73
    assert 2 <= most[0] <= 2 * cores or cores == 1
    assert at_once[0] * (frames._FILLED + 1) * frames._SLOT_BYTES <= 2 << 30


def test_what_is_at_work_is_broken_off_when_the_batch_stops(tree):
    folder = tree / "scans" / "long"
    folder.mkdir()
    frames_of_it = tuple(folder / f"{k}.png" for k in range(1500))
    for path in frames_of_it:
        os.link(tree / "scans" / "dish" / "0.png", path)
    axes = {"stage": tuple(range(len(frames_of_it)))}
    write_scan(Scan(folder / "scan.toml", StripeSettings("grey"), frames_of_it, axes=axes))
    tasks = [task for task in find_tasks(tree / "scans", tree / "out") if task.name in ("dish", "long")]
    outcomes = run_batch(tasks, tree / "rig.json", Options("gravity"))
    assert next(outcomes).task.name == "dish"
    outcomes.close()
    assert [path.name for path in (tree / "out").iterdir()] == ["dish.ply"]
