"""Scans that are killed, through the command line, and continued."""

import warnings
from pathlib import Path

from benchmarks.killed_scans import kill_and_resume, prepare


def test_killed_at_random_moments(tmp_path: Path):
    folder = prepare(tmp_path)
    # How many moments are in mid-scan depends on how quick the machine is.
    in_mid_scan, seed = 0, 0
    while seed < 8 or (in_mid_scan < 4 and seed < 32):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            outcome = kill_and_resume(folder, seed)
        assert outcome.whole
        assert outcome.same
        in_mid_scan += outcome.running and 0 < outcome.listed < 12
        seed += 1
    assert in_mid_scan >= 4
