"""`scanner` with a turntable beside the stage: described, moved, scanned with, resumed, and refused."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hardware.cli.main import main
from hardware.devices import ScannerSettings, open_scanner, open_stage, read_scanner
from hardware.errors import SettingsError
from hardware.places import check_places, full_turn, read_places
from hardware.stages import STAGE_KINDS, Grbl, Travel, register_stage
from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan

SCANNER = """
[camera]
kind = "folder"
source = "recorded"
[stage]
kind = "grbl"
port = "emulator://grbl?length=40000&y_length=90000&y_start=40000"
steps_per_mm = 250
last = 20000
[axes.turntable]
kind = "grbl"
port = "emulator://grbl?length=40000&y_length=90000&y_start=40000"
axis = "Y"
steps_per_mm = 250
steps_per_turn = 3200
[laser]
kind = "controller"
"""
HERE = SCANNER.replace("steps_per_turn = 3200", 'steps_per_turn = 3200\nreference = "here"')


@pytest.fixture
def scanner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scanner of two axes, as the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recorded").mkdir()
    for i in range(8):
        cv2.imwrite(f"recorded/{i}.png", np.full((6, 8, 3), 20 * i, np.uint8))
    (tmp_path / "scanner.toml").write_text(SCANNER)
    return tmp_path


def test_a_second_axis_of_the_controller_shares_its_line(scanner: Path):
    settings = read_scanner(None)
    assert settings.travels["turntable"] == Travel(last=3200, steps_per_turn=3200)
    devices = open_scanner(settings)
    stage, table = devices.axes.values()
    assert isinstance(stage, Grbl)
    assert isinstance(table, Grbl)
    assert table.line is stage.line
    assert list(devices.axes) == ["stage", "turntable"]
    stage.home()
    devices.laser.on()
    assert stage.line.port.laser
    devices.laser.off()
    devices.close()
    # On a port of its own it has a line of its own.
    own = SCANNER.replace('axis = "Y"\n', "").replace("y_start=40000", "y_start=1", 1)
    (scanner / "scanner.toml").write_text(own)
    stage, table = open_scanner(read_scanner(None)).axes.values()
    assert table.line is not stage.line


def test_a_turntable_alone(scanner: Path):
    (scanner / "scanner.toml").write_text(SCANNER[: SCANNER.index("[stage]")] + SCANNER[SCANNER.index("[axes.") :])
    assert list(open_scanner(read_scanner(None)).axes) == ["turntable"]
    assert main(["scan", "owl", "--axis", "turntable", "--full-turn", "--frames", "4"]) == 0
    assert read_scan("owl").axes == {"turntable": (0, 800, 1600, 2400)}


def test_home_move_and_devices(scanner: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["home", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"positions": {"stage": 0, "turntable": 0}}
    assert main(["home", "--axis", "turntable"]) == 0
    assert "homed; the turntable is at step 0" in capsys.readouterr().out
    assert main(["move", "800", "--axis", "turntable"]) == 0
    assert "the turntable is at step 800" in capsys.readouterr().out
    assert main(["shoot", "one.png", "--axis", "turntable", "--step", "8"]) == 0
    capsys.readouterr()
    assert main(["devices", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["axes"] == {"stage": "answers", "turntable": "answers"}


def test_a_full_turn_and_any_mixture(scanner: Path, capsys: pytest.CaptureFixture[str]):
    argv = ["scan", "owl", "--axis", "turntable", "--full-turn", "--frames", "7", "--at", "stage=18000"]
    assert main(argv) == 0
    captured = capsys.readouterr()
    assert "7 frames, turntable steps 0 to 2743, step 18000" in captured.out
    assert "taken 0001.png at turntable 457, stage 18000: 2 of 7" in captured.err
    scan = read_scan("owl")
    assert scan.axes == {"turntable": (0, 457, 914, 1371, 1829, 2286, 2743), "stage": (18000,) * 7}
    (scanner / "places.csv").write_text("stage, turntable\n0,0\n0,1600\n\n5000,0\n5000,1600\n")
    assert main(["scan", "mixed", "--positions", "places.csv", "--json"]) == 0
    axes = {"stage": [0, 0, 5000, 5000], "turntable": [0, 1600, 0, 1600]}
    assert json.loads(capsys.readouterr().out)["axes"] == axes
    assert main(["scan", "again", "--axis", "turntable", "--frames", "2", "--apart", "8", "--at", "stage=0"]) == 0
    assert read_scan("again").axes == {"turntable": (0, 8), "stage": (0, 0)}


def test_a_scan_on_two_axes_is_gone_on_with(scanner: Path, capsys: pytest.CaptureFixture[str]):
    argv = ["scan", "owl", "--axis", "turntable", "--full-turn", "--frames", "10", "--at", "stage=500"]
    assert main(argv) == 1
    assert "no photograph for turntable 2560, stage 500, and 8 in all" in capsys.readouterr().err
    assert main(["scan", "owl", "--resume"]) == 0
    assert read_scan("owl").axes["turntable"] == tuple(range(0, 3200, 320))


def test_without_a_switch_no_scan_is_gone_on_with(scanner: Path, capsys: pytest.CaptureFixture[str]):
    (scanner / "scanner.toml").write_text(HERE)
    argv = ["scan", "owl", "--axis", "turntable", "--full-turn", "--frames", "10", "--at", "stage=500"]
    assert main(argv) == 1
    capsys.readouterr()
    before = sorted(scanner.rglob("*"))
    assert main(["scan", "owl", "--resume"]) == 2
    assert "the turntable has no switch, and where its step 0 was" in capsys.readouterr().err
    assert sorted(scanner.rglob("*")) == before


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["move", "5", "--axis", "lift"], "no axis lift, but stage, turntable"),
        (["home", "--axis", "lift"], "no axis lift, but stage, turntable"),
        (["move", "3201", "--axis", "turntable"], "the turntable goes from 0 to 3200"),
        (["scan", "new", "--axis", "turntable", "--frames", "3", "--apart", "8"], "where the stage is to stand"),
        (["scan", "new", "--full-turn", "--frames", "3"], "full turn of the stage: how many motor steps that is"),
        (["scan", "new", "--frames", "3", "--apart", "8", "--at", "lift=0"], "no axis lift"),
        (["scan", "new", "--frames", "3", "--apart", "8", "--at", "stage=0"], "is what moves"),
        (["scan", "new", "--frames", "3", "--apart", "8", "--at", "turntable=x"], "as stage=18000"),
        (["scan", "new", "--axis", "turntable", "--full-turn", "--frames", "4000"], "give 1 to 3200"),
        (
            ["scan", "new", "--axis", "turntable", "--frames", "37", "--apart", "100", "--at", "stage=0"],
            "steps 0 to 3600 of the turntable are 1.12 turns",
        ),
        (["scan", "new", "--positions", "none.csv"], "cannot be read"),
        (["scan", "new", "--positions", "places.csv", "--frames", "3"], "leave out --frames"),
        (["scan", "new", "--positions", "places.csv"], "line 3: is '5,x': give whole motor steps of stage, turntable"),
        (["scan", "new", "--apart", "8", "--full-turn"], "not allowed with"),
    ],
)
def test_what_cannot_be_is_refused(scanner: Path, capsys: pytest.CaptureFixture[str], argv: list[str], says: str):
    (scanner / "places.csv").write_text("stage,turntable\n0,0\n5,x\n")
    before = sorted(scanner.rglob("*"))
    assert main(argv) == 2
    assert says in capsys.readouterr().err
    assert sorted(scanner.rglob("*")) == before


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[axes.turntable]", '[axes."turn table"]', "letters, digits"),
        ("[axes.turntable]", "[axes.stage]", r"\[axes\] stage.*\[stage\] is given too"),
        ("steps_per_turn = 3200", "steps_per_turn = 0", "steps_per_turn = 0: give"),
        ("steps_per_turn = 3200", "steps_per_trun = 3200", 'did you mean "steps_per_turn"'),
        ("steps_per_turn = 3200", 'reference = "there"', "one of switch, here"),
        ('axis = "Y"', 'axis = "Y"\necho = true', "unknown key"),
        (
            '[axes.turntable]\nkind = "grbl"',
            '[axes.turntable]\nkind = "stepper"',
            "one of bistep, grbl, marlin, simulated",
        ),
    ],
)
def test_a_description_that_is_wrong_is_named(scanner: Path, old: str, new: str, says: str):
    (scanner / "scanner.toml").write_text(SCANNER.replace(old, new))
    with pytest.raises(InputError, match=says):
        read_scanner(None)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('axis = "Y"\n', "", "is the port of another axis: give each its letter"),
        ('axis = "Y"', 'axis = "y"', "by which the controller knows it: X, Y, Z"),
        ('[axes.turntable]\nkind = "grbl"', '[axes.turntable]\nkind = "marlin"', "is the port of another axis"),
        ("steps_per_mm = 250\nsteps_per_turn", "steps_per_turn", r"\[axes.turntable\] steps_per_mm: is missing"),
    ],
)
def test_a_second_axis_that_cannot_be_opened(scanner: Path, old: str, new: str, says: str):
    (scanner / "scanner.toml").write_text(SCANNER.replace(old, new))
    with pytest.raises((InputError, SettingsError), match=says):
        open_scanner(read_scanner(None))


def test_two_axes_cannot_share_a_bistep(scanner: Path):
    text = SCANNER.replace('"grbl"', '"bistep"').replace("steps_per_mm = 250\n", "").replace('axis = "Y"\n', "")
    (scanner / "scanner.toml").write_text(text.replace('"controller"', '"fixed"').replace("y_length", "length"))
    with pytest.raises((InputError, SettingsError), match="is that of the stage too: a bistep has one axis"):
        open_scanner(read_scanner(None))


def test_the_simulated_scanner_has_both(scanner: Path):
    settings = ScannerSettings()
    assert settings.travels["turntable"].steps_per_turn == 3200
    table = open_stage(settings, "turntable")
    table.home()
    table.move_to(3200)
    assert table.position() == 3200


def test_a_driver_of_ones_own_is_registered_in_its_file(scanner: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hardware.stages.kinds.STAGE_KINDS", dict(STAGE_KINDS))

    class Crank:
        """Somebody who turns it by hand."""

        def __init__(self, travel: Travel, *, arms: int, who: str = "anna"):
            self.travel, self.arms, self.who = travel, arms, who

    register_stage("crank", Crank, arms=int, who=str)
    monkeypatch.setattr("hardware.devices.STAGE_KINDS", __import__("hardware.stages.kinds").stages.kinds.STAGE_KINDS)
    text = (
        SCANNER[: SCANNER.index("[stage]")] + '[stage]\nkind = "crank"\narms = 2\nlast = 50\n[laser]\nkind = "fixed"\n'
    )
    (scanner / "scanner.toml").write_text(text)
    crank = open_stage(read_scanner(None))
    assert (crank.travel.last, crank.arms, crank.who) == (50, 2, "anna")
    (scanner / "scanner.toml").write_text(text.replace("arms = 2\n", ""))
    with pytest.raises(InputError, match=r"\[stage\] arms: is missing"):
        open_stage(read_scanner(None))


def test_places_from_a_table(tmp_path: Path):
    path = tmp_path / "places.csv"
    path.write_text("\ufeffstage,lift\r\n0,-5\r\n1,7\r\n", encoding="utf-8")
    assert read_places(path) == ({"stage": 0, "lift": -5}, {"stage": 1, "lift": 7})
    for text, says in (
        ("stage\n", "has no positions"),
        ("stage,stage\n0,0\n", "stands there twice"),
        ("stage,lift\n0\n", "line 2: is '0'"),
        ("stage\n1.5\n", "whole motor steps of stage"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=says):
            read_places(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        read_places(path)


def test_turns():
    travels = {"turntable": Travel(first=-3200, last=9600, switch=-5000, steps_per_turn=3200), "stage": Travel()}
    assert full_turn(travels, "turntable", 3, 100) == (100, 1167, 2233)
    # Onwards at another place of the stage is no second turn; neither is the first photograph once more.
    check_places(travels, [{"turntable": 1600 * i, "stage": 1000 * (i // 3)} for i in range(6)])
    with pytest.raises(SettingsError, match=r"steps 0 to 4800 of the turntable are 1\.50 turns"):
        check_places(travels, [{"turntable": 1600 * i, "stage": 0} for i in range(4)])
    with pytest.raises(SettingsError, match="no axis lift, but turntable, stage"):
        check_places(travels, [{"lift": 1}])


def test_a_session_on_a_scanner_without_a_stage_asks_for_none(scanner: Path, monkeypatch, capsys):
    alone = SCANNER[: SCANNER.index("[stage]")] + SCANNER[SCANNER.index("[axes.") :]
    (scanner / "scanner.toml").write_text(alone.replace('"controller"', '"fixed"'))
    monkeypatch.setattr("builtins.input", lambda prompt: "q")
    assert main(["calibrate", "session"]) == 2
    assert "ended after 0 poses" in capsys.readouterr().err
    assert main(["calibrate", "session", "--stage-frames", "2"]) == 2
    assert "no axis stage, but turntable" in capsys.readouterr().err
