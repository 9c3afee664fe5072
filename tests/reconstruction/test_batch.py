"""Many scans: all that can be done is done, once; what cannot says why."""

import csv
import json
import os
import shutil
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxscan.atomic import make_folder
from jaxscan.cli import batch_measured
from jaxscan.cli.main import main
from jaxscan.deadline import Workers
from jaxscan.errors import InputError
from jaxscan.files.cloud import read_ply
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import Scan, write_scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.reconstruction import batch, frames
from jaxscan.reconstruction.batch import Options, find_tasks, held, reconstruct_one, run_batch
from jaxscan.reconstruction.records import read_record, record_path
from jaxscan.rig import Linear
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


def names(tree: Path, out: Path) -> list[str]:
    return [task.name for task in find_tasks(tree / "scans", out).tasks]


def counts(tree: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, int]:
    """How many scans a batch makes, and how many were there already."""
    capsys.readouterr()
    command(tree, "--json", *more)
    result = json.loads(capsys.readouterr().out)
    return len(result["done"]), result["kept"]


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


def test_the_order_is_natural_and_results_in_the_tree_are_no_scans(tree):
    assert names(tree, tree / "scans" / "cups") == ["dish"]
    assert names(tree, tree / "out") == list(NAMES)


def test_two_scans_of_one_name_are_refused(tree):
    (tree / "scans" / "Dish").mkdir()
    (tree / "scans" / "Dish" / "scan.toml").write_text("")
    with pytest.raises(InputError, match=r"Dish.*dish.*rename|dish.*Dish.*rename"):
        find_tasks(tree / "scans", tree / "out")


def test_no_scans(tree):
    (tree / "empty").mkdir()
    with pytest.raises(InputError, match=r"no scan\.toml"):
        find_tasks(tree / "empty", tree / "out")
    with pytest.raises(InputError, match="is not a folder"):
        find_tasks(tree / "rig.json", tree / "out")


def test_a_scheduler_that_does_not_answer(tree, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(batch, "_ANSWER_S", 1)
    tasks = find_tasks(tree / "scans", tree / "out").tasks
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        list(run_batch(tasks, tree / "rig.json", scheduler="tcp://127.0.0.1:9"))


def test_on_a_cluster(tree):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        tasks = find_tasks(tree / "scans", tree / "out").tasks
        outcomes = list(run_batch(tasks, tree / "rig.json", Options("gravity"), scheduler=cluster.scheduler_address))
    assert sorted(o.task.name for o in outcomes if o.record) == sorted(set(NAMES) - {"cups/2"})
    assert next(o.reason for o in outcomes if not o.record).count("cut off") == 1


@pytest.mark.parametrize("ending", [".ply", ".npz"])
def test_a_cluster_that_runs_a_task_again_does_not_do_its_work_again(tree, ending):
    """The worker that holds an answer is closed before it was fetched; the other is given the task once more."""
    distributed = pytest.importorskip("distributed")
    task = find_tasks(tree / "scans", tree, ending).tasks[-1]
    argument = (task, tree / "rig.json", "this batch", Options("gravity", "strongest"))
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster, set_as_default=False) as client:
        first, second = client.scheduler_info()["workers"]
        future = client.submit(reconstruct_one, *argument, pure=False, workers=[first], allow_other_workers=True)
        with client.as_current():
            distributed.wait(future, timeout=60)
        made = task.output.stat().st_mtime_ns
        assert [len(keys) for keys in client.has_what([first, second]).values()] == [1, 0]
        (worker,) = (w for w in cluster.workers.values() if w.address == first)
        cluster.sync(worker.close)
        record = future.result(timeout=60)
        assert [tuple(on) for on in client.who_has([future]).values()] == [(second,)]
    assert record.points > 100
    assert task.output.stat().st_mtime_ns == made
    assert read_record(task.output) == record

    # What another batch has made, by whatever options, is made again.
    again = reconstruct_one(*argument[:2], "another", argument[3])
    assert (again.points, again.run) == (record.points, "another")
    assert task.output.stat().st_mtime_ns != made


def test_other_options_make_it_anew(tree, capsys):
    """Whether a scan was done was asked without a look at how: results of the old options were kept."""
    command(tree)
    assert counts(tree, capsys, "--depths", "1,1000") == (3, 0)
    assert counts(tree, capsys, "--depths", "1,1000") == (0, 3)


def test_options_that_were_mistaken_cost_what_they_made_alone(tree, capsys):
    command(tree)
    task = find_tasks(tree / "scans", tree / "out").tasks[-1]
    next(run_batch([task], tree / "rig.json", Options("derivative")))
    assert counts(tree, capsys) == (1, 2)


def test_what_a_result_was_made_from_decides(tree, capsys):
    """Times alone did: an older rig, and a photograph that was replaced, left the results as they were."""
    command(tree)
    assert counts(tree, capsys) == (0, 3)
    os.utime(tree / "rig.json")
    assert counts(tree, capsys) == (0, 3)
    write_rig(tree / "rig.json", RigFile(replace(small_rig(), motion=Linear.create([0.0, 1.01e-3, 0.0]))))
    os.utime(tree / "rig.json", (1e9, 1e9))
    assert counts(tree, capsys) == (3, 0)
    photograph = tree / "scans" / "dish" / "1.png"
    write_image(photograph, np.rint(wavy_stripe(7)).astype(np.uint8))
    assert counts(tree, capsys) == (1, 2)
    (tree / "out" / "dish.ply").write_bytes(b"")
    assert counts(tree, capsys) == (1, 2)
    record_path(tree / "out" / "dish.ply").write_text("{")
    assert counts(tree, capsys) == (1, 2)


def test_a_scan_that_grows_while_it_is_read_is_made_again(tree, capsys):
    (task,) = (task for task in find_tasks(tree / "scans", tree / "out").tasks if task.name == "dish")
    make_folder(tree / "out")
    paths = (*(tree / "scans" / "dish" / f"{k}.png" for k in range(2)), tree / "scans" / "dish" / "2.png")

    def grow(by: int) -> None:
        if not paths[-1].exists():
            paths[-1].write_bytes(paths[0].read_bytes())
            write_scan(Scan(task.scan, StripeSettings("grey"), paths, axes={"stage": (0, 1000, 2000)}))

    first = reconstruct_one(task, tree / "rig.json", "first", Options("gravity"), grow)
    assert first.frames == 2
    assert counts(tree, capsys) == (3, 0)
    assert read_record(task.output).frames == 3


def test_a_process_that_is_killed_before_it_notes_its_result(tree, capsys):
    """The result is younger than the note that work on it began."""
    command(tree)
    result = tree / "out" / "dish.ply"
    begun = replace(read_record(result), size=None, points=None)
    made = result.stat().st_mtime
    begun.write(result)
    os.utime(record_path(result), (made - 1, made - 1))
    assert counts(tree, capsys) == (0, 3)
    os.utime(record_path(result), (made + 1, made + 1))
    assert counts(tree, capsys) == (1, 2)


def test_results_may_be_moved_and_copied(tree, capsys):
    """Lots that were done one by one, and copies, are kept by a batch of all."""
    main(["batch", str(tree / "scans" / "cups"), "--rig", str(tree / "rig.json"), "-o", str(tree / "out" / "cups"),
          "--detector", "gravity"])  # fmt: skip
    assert counts(tree, capsys) == (1, 2)
    shutil.copytree(tree / "out", tree / "copy", copy_function=shutil.copyfile)
    shutil.rmtree(tree / "out")
    (tree / "copy").rename(tree / "out")
    assert counts(tree, capsys) == (0, 3)


def test_what_is_known_of_each_scan_stands_in_a_table(tree, capsys):
    """Notes of scans that were done before a batch was interrupted were gone."""
    image = np.rint(wavy_stripe(0)).astype(np.uint8)
    image[70:] = 255
    write_image(tree / "scans" / "dish" / "0.png", image)
    write_image(tree / "scans" / "cups" / "1" / "1.png", np.zeros_like(image))
    command(tree)
    said = capsys.readouterr().out
    assert "note: dish: " in said
    assert "photographs without a point: cups/1 1 of 2" in said
    command(tree)
    assert "note: dish: " in capsys.readouterr().out
    lines = list(csv.DictReader((tree / "out" / "batch.csv").read_text(encoding="utf-8").splitlines()))
    assert [line["scan"] for line in lines] == list(NAMES)
    assert [line["state"] for line in lines] == ["kept", "failed", "kept", "kept"]
    assert "overexposed" in lines[3]["notes"]
    assert "cut off" in lines[1]["reason"]
    assert [lines[0][name] for name in ("frames", "empty")] == ["2", "1"]


def test_folders_that_cannot_be_read_are_failures(tree, capsys, monkeypatch):
    whole = os.scandir

    def scandir(path: Any = ".") -> Any:
        if str(path).endswith("cups"):
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path)

    monkeypatch.setattr(os, "scandir", scandir)
    assert command(tree, "--json") == 1
    result = json.loads(capsys.readouterr().out)
    assert [one["scan"] for one in result["done"]] == ["dish"]
    (failed,) = result["failed"]
    assert failed["scan"] == "cups"
    assert "cups: cannot be read (Permission denied)" in failed["reason"]
    assert result["scans"] == 2


@pytest.mark.skipif(sys.platform != "linux", reason="names that are no text are Linux's")
def test_a_name_that_is_no_text_fails_alone(tree, capsys):
    """Nothing could be printed of any scan, and no table written."""
    os.rename(tree / "scans" / "dish", os.fsencode(tree / "scans") + b"/di\xffsh")
    assert command(tree, "--json") == 1
    result = json.loads(capsys.readouterr().out)
    assert len(result["done"]) == 2
    assert {one["scan"] for one in result["failed"]} == {"cups/2", "di\\xffsh"}
    assert "its name is no text (UTF-8): rename the folder" in result["failed"][0]["reason"]


def test_a_pipe_in_place_of_a_scan_is_not_waited_for(tree, capsys):
    """It stood in the way of all others until the program gave up."""
    for name, make in (("pipe", os.mkfifo), ("link", lambda path: path.symlink_to("nowhere"))):
        (tree / "scans" / name).mkdir()
        make(tree / "scans" / name / "scan.toml")
    assert command(tree, "--json") == 1
    reasons = {one["scan"]: one["reason"] for one in json.loads(capsys.readouterr().out)["failed"]}
    assert set(reasons) == {"cups/2", "pipe", "link"}
    assert reasons["pipe"].endswith("pipe/scan.toml: is no plain file, or a link to none: copy it there again")


def test_what_a_killed_batch_left_unfinished_is_deleted(tree):
    (tree / "out" / "cups").mkdir(parents=True)
    left = [tree / "out" / "cups" / ".1.ply.0123abcd.part", tree / "out" / "..dish.ply.json.0123abcd.part"]
    other = tree / "out" / ".somebody.else.part"
    for path in (*left, other):
        path.touch()
    command(tree)
    assert not any(path.exists() for path in left)
    assert other.exists()


def test_a_cluster_without_workers_is_not_waited_for_without_end(tree, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("JAXSCAN_PATIENCE_S", "1")
    monkeypatch.setattr(batch, "_LOOK_S", 0.2)
    options = {"n_workers": 0, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        tasks = find_tasks(tree / "scans", tree / "out").tasks
        with pytest.raises(InputError, match="has had no worker for 1 s, and 4 scans wait: start one with dask worker"):
            list(run_batch(tasks, tree / "rig.json", scheduler=cluster.scheduler_address))


PART = """
[part]
name = "wave"

[[feature]]
name = "all"
kind = "plane"
box = [[-1e3, -1e3, -1e3], [1e3, 1e3, 1e4]]

[[dimension]]
name = "height"
kind = "flatness"
of = "all"
"""


def measured(tree: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, dict[str, Any]]:
    (tree / "part.toml").write_text(PART)
    capsys.readouterr()
    status = command(tree, "--ending", ".npz", "--measure", str(tree / "part.toml"), "--json", *more)
    return status, json.loads(capsys.readouterr().out)


def test_each_scan_is_measured_once(tree, capsys, monkeypatch):
    """All were measured again in each run, those too that had failed now."""
    status, first = measured(tree, capsys)
    assert status == 1
    assert [one["scan"] for one in first["measured"]] == ["cups/1", "cups/10", "dish"]
    assert all(one["dimensions"][0]["value"] > 0 for one in first["measured"])
    again: list[str] = []
    whole = batch_measured._measured
    monkeypatch.setattr(batch_measured, "_measured", lambda *of: again.append(of[0].name) or whole(*of))
    assert measured(tree, capsys)[1]["measured"] == first["measured"]
    assert again == []
    write_image(tree / "scans" / "dish" / "1.png", np.rint(wavy_stripe(7)).astype(np.uint8))
    (tree / "scans" / "cups" / "10" / "1.png").unlink()
    status, second = measured(tree, capsys)
    assert again == ["dish.npz"]
    assert [one["scan"] for one in second["measured"]] == ["cups/1", "dish"]
    table = (tree / "out" / "measured.csv").read_text(encoding="utf-8").splitlines()
    lines = {line["scan"]: line for line in csv.DictReader(table)}
    assert set(lines) == set(NAMES)
    assert float(lines["dish"]["height"]) == second["measured"][1]["dimensions"][0]["value"]
    assert "1.png" in lines["cups/10"]["problem"]
    assert not lines["cups/10"]["height"]


def test_what_cannot_be_measured_is_a_failure(tree, capsys):
    """It was said on the screen alone, and the status was 0."""
    (tree / "scans" / NAMES[1] / "1.png").write_bytes((tree / "scans" / NAMES[1] / "0.png").read_bytes())
    assert measured(tree, capsys)[0] == 0
    path = tree / "out" / "dish.npz"
    record = read_record(path)
    path.write_bytes(bytes(record.size))
    replace(record, measured=None).write(path)
    status, result = measured(tree, capsys)
    assert status == 1
    (failed,) = result["failed"]
    assert failed["scan"] == "dish"
    assert failed["reason"].startswith("not measured: ")


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
    assert names(tree, tree / "out") == [*NAMES, "linked/bowl"]


def test_two_batches_in_one_folder(tree, capsys):
    """Both did all scans."""
    with held(tree / "out"):
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
    outcomes = list(run_batch(find_tasks(tree / "scans", tree / "out").tasks, tree / "rig.json", Options("gravity")))
    batch._scanner.cache_clear()
    assert sum(outcome.record is not None for outcome in outcomes) == 73
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
    tasks = [task for task in find_tasks(tree / "scans", tree / "out").tasks if task.name in ("dish", "long")]
    outcomes = run_batch(tasks, tree / "rig.json", Options("gravity"))
    assert next(outcomes).task.name == "dish"
    outcomes.close()
    assert {path.name for path in (tree / "out").iterdir()} == {"dish.ply", ".dish.ply.json", ".long.ply.json"}
