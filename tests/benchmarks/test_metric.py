"""The gate: what is worse than the baseline, and what only noise of a busy machine."""

import math

import pytest

from benchmarks.__main__ import _gate, main
from benchmarks.metric import Metric, ratio

BASELINE = {"cloud.rms": 0.05, "kept": 0.99, "over_a_copy": 0.8}


def figures(rms=0.05, kept=0.99, copy=0.8):
    return [
        Metric("cloud.rms", rms, "mm", "lower", 0.16),
        Metric("kept", kept, "", "higher", 0.95),
        ratio("over_a_copy", copy, 0.75, "higher"),
    ]


def test_an_accuracy_a_tenth_worse_fails_though_it_reaches_its_goal():
    assert _gate(figures(), BASELINE) == 0
    assert _gate(figures(rms=0.052, kept=0.97), BASELINE) == 0
    assert _gate(figures(rms=0.055), BASELINE) == 1
    assert _gate(figures(kept=0.9), BASELINE) == 1
    assert _gate(figures(rms=math.nan), BASELINE) == 1


def test_a_ratio_of_times_passes_where_it_reaches_its_goal_or_has_not_halved():
    assert _gate(figures(copy=0.76), BASELINE) == 0
    assert _gate(figures(copy=0.45), BASELINE) == 0
    assert _gate(figures(copy=0.35), BASELINE) == 1


def test_what_has_no_baseline_or_is_not_measured_does_not_pass(capsys):
    assert _gate([*figures(), Metric("new", 1.0, "", "lower")], BASELINE) == 1
    assert "new; add it with --save-baseline" in capsys.readouterr().out
    assert _gate([], BASELINE) == 1


@pytest.mark.parametrize(("value", "worse"), [(1.0, False), (1.04, False), (1.06, True)])
def test_slack_is_a_part_of_the_baseline(value, worse):
    assert Metric("x", value, "", "lower").worse_than(1.0) is worse
    assert Metric("x", 1 / value, "", "higher").worse_than(1.0) is worse
    assert not Metric("x", 100 * value).worse_than(1.0)


def test_what_cannot_be_written_or_read_is_refused_before_anything_is_measured(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "nist", "--json", str(tmp_path / "none" / "x.json")])
    with pytest.raises(SystemExit):
        main()
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "nist"])
    monkeypatch.setenv("JAXSCAN_DATA", str(tmp_path / "none"))
    with pytest.raises(SystemExit):
        main()
    heard = capsys.readouterr()
    assert heard.out == ""
    assert "create it first" in heard.err
    assert "JAXSCAN_DATA is" in heard.err
