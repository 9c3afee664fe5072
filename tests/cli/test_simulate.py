"""`jaxscan simulate`: what it writes, and what it refuses before any work."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxscan.cli import simulate
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.rig import Rig
from jaxscan.simulation import Lighting, Scene, rig_2003
from jaxscan.simulation.folders import read_scan_truth


def parse(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    simulate.add_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture
def few_photographs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig_2003, "BOARD_VIEWS", 2)
    monkeypatch.setattr(rig_2003, "STAGE_VIEWS", 2)
    monkeypatch.setattr(rig_2003, "SCAN_FRAMES", 2)
    monkeypatch.setattr(rig_2003, "TURNTABLE_VIEWS", 3)
    monkeypatch.setattr(rig_2003, "TURN_APART", 1600)
    monkeypatch.setattr("jaxscan.simulation.swept.STRIPES", 3)
    monkeypatch.setattr("jaxscan.cli.compiled.keep_compiled", lambda: None)


def test_a_light_that_sweeps(few_photographs: None, tmp_path: Path) -> None:
    out = tmp_path / "world"
    result = simulate.run(parse(str(out), "--object", "box", "--swept"))
    assert result["photographs"] == 10
    session, scan = read_session(out / "session"), read_scan(out / "scan")
    assert session.sheets == ("swept",)
    assert [step for step, _ in session.views.lit("", 1)] == [400, 1000, 1600]
    assert scan.axes == {"sweep": (400, 1600)}
    rig = read_rig(out / "truth" / "rig.json").rig
    assert rig.light_axis("sweep").amount(100.0) == (pytest.approx(1.0), "degrees")
    with pytest.raises(InputError, match="--swept goes without --turntable, --apart: leave one of them out"):
        simulate.run(parse(str(tmp_path / "other"), "--swept", "--turntable", "--apart", "3"))


def test_sessions_scans_and_truth(few_photographs: None, tmp_path: Path) -> None:
    out = tmp_path / "world"
    result = simulate.run(parse(str(out), "--object", "box", "--quality", "80", "--turntable", "--seed", "2"))
    assert result["photographs"] == 9
    session = read_session(out / "session")
    assert len(session.views.boards) == 2
    assert session.turntable is not None
    assert len(session.turntable.images) == 3
    assert read_rig(out / "truth" / "rig.json").rig.axis("turntable") is not None
    scan = read_scan(out / "scan")
    assert len(scan.frames) == 2
    # It turns once all around, with the stage where the sheet holds the axis.
    assert (scan.moving, scan.axes["turntable"]) == (("turntable",), (0, 1600))
    assert scan.frames[0].suffix == ".jpg"
    assert (out / "truth" / "scan.npz").is_file()
    first, *commands = simulate.describe(result).splitlines()
    assert "box" in first
    assert commands == [
        f"next: jaxscan calibrate {out}/session -o {out}/rig.json",
        f"then: jaxscan reconstruct {out}/scan --rig {out}/rig.json -o {out}/scan.npz",
        f"then: jaxscan mesh {out}/scan.npz -o {out}/model.stl",
        f"then: jaxscan compare {out}/scan.npz {out}/truth",
    ]


def test_a_box_from_three_sides(few_photographs: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig_2003, "SCAN_FRAMES", 19)
    out = tmp_path / "world"
    result = simulate.run(parse(str(out), "--object", "box", "--sides", "3", "--apart", "18000"))
    assert result["scans"] == ["scan-000", "scan-120", "scan-240"]
    assert "--object panda or figure" in result["warnings"][0]
    first, second = (read_scan_truth(out / "truth", which) for which in ("000", "120"))
    assert read_scan(out / "scan-240").axes["stage"] == (0, 18000, 36000) == tuple(first.axes["stage"])
    assert not np.array_equal(first.position, second.position, equal_nan=True)
    assert simulate.describe(result).splitlines()[1:] == [
        f"next: jaxscan calibrate {out}/session -o {out}/rig.json",
        f"then: jaxscan merge {out}/scan-* --rig {out}/rig.json --turn 120 -o {out}/model.stl",
    ]


@pytest.mark.parametrize(("name", "warned"), [("box", True), ("panda", False)])
def test_sides_that_will_not_register_are_said_before_the_work(
    name: str, warned: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def work(*words: Any, **more: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "simulate_into", work)
    with pytest.raises(KeyboardInterrupt):
        simulate.run(parse(str(tmp_path / "world"), "--object", name, "--sides", "8"))
    assert ("warning: jaxscan merge will not join the sides of a box" in capsys.readouterr().err) is warned


def test_boards_held_by_hand_and_a_laser_of_two_lobes(
    few_photographs: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot: list[tuple[int, str, float]] = []

    def render(rig: Rig, scene: Any, *, lighting: Lighting, **how: Any) -> np.ndarray:
        moments = 1 if isinstance(scene, Scene) else len(scene)
        shot.append((moments, lighting.laser_profile, lighting.sheet_sigma_mm))
        return np.zeros((480, 640, 3), np.uint8)

    monkeypatch.setattr("jaxscan.simulation.photographs.render", render)
    words = "--stripes", "--shake-mm", "0.5", "--laser-profile", "two-lobed", "--sheet-mm", "0.6"
    simulate.run(parse(str(tmp_path / "world"), *words))
    assert {(kind, sigma) for _, kind, sigma in shot} == {("two-lobed", 0.6)}
    # Two poses, each of board and stripe, are smeared; two photographs on the stage and two frames of the scan are not.
    moments = [count for count, _, _ in shot]
    assert len(moments) == 8
    assert min(moments[:4]) > 1
    assert moments[4:] == [1] * 4


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="no simulation"):
        simulate.run(parse(str(tmp_path)))
    with pytest.raises(InputError, match="is a file"):
        simulate.run(parse(str(tmp_path / "thesis.txt")))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    "words",
    [
        ("--noise", "-1"),
        ("--blur", "-2"),
        ("--speckle", "2"),
        ("--speckle-length", "-1", "0"),
        ("--ambient-colour", "1", "2", "0"),
        ("--highlight", "-5"),
        ("--ghost", "1.5"),
        ("--laser-profile", "square"),
        ("--sheet-mm", "0"),
        ("--guide-mm", "3"),
        ("--screw-mm", "-2.5"),
        ("--screw-steps", "0"),
        ("--play-mm", "-0.1"),
        ("--play-mm", "2.5"),
        ("--shake-mm", "-1"),
        ("--shake-mm", "500"),
        ("--quality", "0"),
        ("--seed", "-1"),
        ("--mesh", "none.stl"),
        ("--sides", "0"),
        ("--sides", "1000"),
        ("--apart", "0"),
        # One frame alone.
        ("--apart", "72001"),
        ("--apart", "3200", "--turntable"),
    ],
)
def test_bad_options_write_nothing(words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxscan.cli.compiled.keep_compiled", lambda: None)
    with pytest.raises(InputError):
        simulate.run(parse(str(tmp_path / "world"), *words))
    assert not (tmp_path / "world").exists()


def test_a_stage_that_is_no_line_is_drawn_and_written_as_truth(few_photographs: None, tmp_path: Path) -> None:
    out = tmp_path / "world"
    words = "--guide-mm", "0.1", "--screw-mm", "0.05", "--screw-steps", "2900", "--object", "box"
    simulate.run(parse(str(out), *words))
    axes: Any = read_rig(out / "truth" / "rig.json").rig.axes()
    assert {name: part.kind for name, part in axes.items()} == {"stage": "screw_on_guide"}
    assert float(axes["stage"].period[0]) == 2900
    assert np.hypot(*map(float, axes["stage"].wave)) == pytest.approx(0.05)


def test_a_stage_with_play_is_photographed_there_and_back(
    few_photographs: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig_2003, "STAGE_VIEWS", 4)
    out = tmp_path / "world"
    simulate.run(parse(str(out), "--play-mm", "0.1", "--object", "box"))
    part: Any = read_rig(out / "truth" / "rig.json").rig.axis("stage")
    assert part.kind == "screw_on_guide_with_play"
    assert float(part.play[0]) * part.amount(1.0)[0] == pytest.approx(0.1)
    steps = np.array(read_session(out / "session").stage.steps)  # type: ignore[union-attr]
    assert set(np.sign(np.diff(steps))) == {1, -1}


def test_a_simulation_is_replaced_when_it_is_asked_for_alone(few_photographs: None, tmp_path: Path) -> None:
    out = tmp_path / "world"
    simulate.run(parse(str(out), "--object", "box"))
    before = (out / "truth" / "rig.json").read_bytes()
    with pytest.raises(InputError, match="holds a simulation already: name another folder, or replace it with --force"):
        simulate.run(parse(str(out), "--object", "box", "--seed", "1"))
    assert (out / "truth" / "rig.json").read_bytes() == before
    simulate.run(parse(str(out), "--object", "box", "--seed", "1", "--force"))
    assert (out / "truth" / "rig.json").read_bytes() != before
