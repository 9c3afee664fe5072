"""The demo's last line is a command that works with what is installed."""

import shlex

import pytest

from jaxscan.cli import demo, simulate
from jaxscan.cli.main import main

RESULT = {
    "path": "out",
    "object": "panda",
    "points": 10,
    "errors": {"absolute": 0.1, "absolute_after_fit": 0.1, "completeness": 0.9},
    "seconds": 30.0,
}


@pytest.mark.parametrize(
    ("there", "last", "before"),
    [
        ({"viser", "matplotlib"}, "view out/panda.stl", "files: out/panda.png"),
        ({"matplotlib"}, "view out/panda.stl --png out/panda-mesh.png", "pip install viser, then"),
        (set(), "inspect out/panda.stl", "pip install viser, then"),
    ],
    ids=["all", "no viewer", "plain"],
)
def test_the_last_line_is_a_command_that_works_here(monkeypatch, there: set[str], last: str, before: str):
    monkeypatch.setattr(demo, "find_spec", lambda name: name if name in there else None)
    lines = demo.describe(RESULT).split("\n")
    assert lines[-1].endswith(last)
    assert before in lines[-2]


def test_what_is_no_demo_is_replaced_when_it_is_asked_for_alone(tmp_path):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "rig.json").write_text("{}")
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "notes.txt").write_text("mine")
    assert main(["demo", "-o", str(tmp_path)]) == 2
    assert (tmp_path / "session" / "notes.txt").read_text() == "mine"


def test_a_command_that_is_proposed_can_be_pasted():
    lines = demo.describe({**RESULT, "path": "my folder/a"}).split("\n")
    assert shlex.split(lines[-1])[-1].startswith("my folder/a/panda")
    words = {"path": "a b", "sides": 1, "scans": ["scan"], "photographs": 3, "true_points": 9, "object": "cup"}
    for line in simulate.describe({**words, "steps_apart": None}).split("\n")[1:]:
        assert any(word.startswith("a b/") for word in shlex.split(line))
