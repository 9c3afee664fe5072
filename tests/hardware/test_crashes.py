"""Kills, pulled cables and full disks: a small form of `python -m benchmarks --only crashes`."""

import warnings
from pathlib import Path

import pytest

from benchmarks.crashes import kill_batch, kill_server, pull
from benchmarks.killed_scans import fill_disk, kill_and_resume, prepare


def test_cables_that_are_pulled(tmp_path: Path):
    struck = [pull(tmp_path, seed) for seed in range(9)]
    assert sum(one.met for one in struck) >= 6
    assert [one for one in struck if one.lost or one.doubled or one.failed] == []


def test_a_disk_that_fills(tmp_path: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        prepare(tmp_path)
        found = [kill_and_resume(tmp_path, seed, fill_disk) for seed in range(3)]
    assert any(one.running for one in found)
    assert all(one.whole and one.same for one in found)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_server_and_a_batch_that_are_killed(tmp_path: Path):
    for name in ("lab", "batch"):
        (tmp_path / name).mkdir()
    struck = [*kill_server(tmp_path / "lab", 3), *kill_batch(tmp_path / "batch", 3)]
    assert sum(one.met for one in struck) >= 4
    assert [one for one in struck if one.lost or one.doubled or one.failed] == []
