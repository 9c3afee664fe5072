"""Scans that are killed, through the command line, and continued."""

import warnings
from pathlib import Path

from benchmarks.killed_scans import kill_and_resume, prepare


def test_killed_at_random_moments(tmp_path: Path):
    folder = prepare(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcomes = [kill_and_resume(folder, seed) for seed in range(8)]
    assert all(outcome.whole for outcome in outcomes)
    assert all(outcome.same for outcome in outcomes)
    assert sum(outcome.running and 0 < outcome.listed < 12 for outcome in outcomes) >= 4
