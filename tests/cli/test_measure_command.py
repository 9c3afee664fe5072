"""`jaxscan measure`: the guide's own example, run; what is written; what is refused."""

import csv
import json
import shlex

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.files.rig_file import write_rig
from jaxscan.reconstruction import write_points
from tests.measurement.test_measure import KNOWN, STEPS, level
from tests.test_docs import ROOT, blocks, commands


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    from benchmarks.measured_parts import Scene, implicit, scan
    from tests.measurement.test_measure import PART, TRUTH

    folder = tmp_path_factory.mktemp("block")
    scene = Scene(implicit(level, STEPS), STEPS, PART, TRUTH)
    write_points(folder / "block.npz", scan(scene, KNOWN, np.random.default_rng(4), 0.3))
    write_points(folder / "block.ply", scan(scene, KNOWN, np.random.default_rng(4), 0.3))
    write_rig(folder / "rig.json", KNOWN)
    text, *_ = blocks(ROOT / "docs" / "measure.md", "toml")
    (folder / "part.toml").write_text(text)
    return folder


def test_the_guide(block, monkeypatch, capsys):
    monkeypatch.chdir(block)
    (line,) = (each for each in commands(ROOT / "docs" / "measure.md") if each.startswith("jaxscan measure block"))
    assert main(shlex.split(line)[1:]) == 0
    said = capsys.readouterr().out
    assert "block, conforming" in said
    rows = {row["name"]: row for row in csv.DictReader((block / "block.csv").read_text().splitlines())}
    for name, truth in (("dome", 9.0), ("step", 4.0)):
        assert abs(float(rows[name]["value"]) - truth) < 1.5 * float(rows[name]["uncertainty"])
    (snippet,) = blocks(ROOT / "docs" / "measure.md", "python")
    exec(compile(snippet, "measure.md", "exec"), {})
    assert "step" in capsys.readouterr().out


def test_json_report_and_a_cloud_without_intervals(block, capsys):
    argv = ["measure", str(block / "block.npz"), str(block / "part.toml"), "--rig", str(block / "rig.json"), "--json"]
    assert main([*argv, "--report", str(block / "report"), "--png", str(block / "block.png")]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["verdict"] == "conforming"
    assert result["dimensions"][0]["sigma_rig"] > 0
    assert "conforming" in (block / "report" / "report.html").read_text()
    assert main(["measure", str(block / "block.ply"), str(block / "part.toml")]) == 0
    assert "measured without intervals: a cloud does not say" in capsys.readouterr().out


def test_what_is_refused(block, capsys):
    argv = ["measure", str(block / "block.ply"), str(block / "part.toml"), "--rig", str(block / "rig.json")]
    assert main(argv) == 2
    assert "measure the range image (.npz), or leave --rig out" in capsys.readouterr().err
    assert main(["batch", str(block), "--rig", "rig.json", "-o", str(block / "out"), "--measure", "part.toml"]) == 2
    assert "add --ending .npz" in capsys.readouterr().err


def test_a_report_that_cannot_be_made_is_refused_before_any_work(block, capsys):
    (block / "taken").write_text("")
    argv = ["measure", str(block / "none.npz"), str(block / "part.toml"), "--report", str(block / "taken")]
    assert main(argv) == 2
    assert "taken: cannot be made" in capsys.readouterr().err
