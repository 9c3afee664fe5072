"""The demo's last line is a command that works with what is installed."""

import pytest

from jaxscan.cli import demo

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
