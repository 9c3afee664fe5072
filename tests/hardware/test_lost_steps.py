"""Steps that a motor loses: the switch is met again, and the frames since are marked."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.lost_steps import KINDS, Session, session
from hardware.cli.main import main
from hardware.errors import CameraError, PositionUncertainError, SettingsError
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Grbl, Marlin, Travel
from jaxscan.errors import InputError
from jaxscan.files.place_checks import PlaceCheck, doubts
from jaxscan.files.scan import read_scan, write_scan
from jaxscan.images import write_image
from tests.hardware.test_scanning import GreyCamera

TRAVEL = Travel(last=20000)


def devices(**how: float) -> Devices:
    stage, laser = SimulatedStage(TRAVEL, **how), SimulatedLaser()
    return Devices(GreyCamera(stage, laser), {"stage": stage}, laser)


@pytest.mark.parametrize(("play", "places"), [(0, (0, 5000, 10000)), (150, (12000, 300, 7777)), (0, (20000,))])
def test_a_motor_that_keeps_its_steps_is_found_to(tmp_path: Path, play: int, places: tuple[int, ...]):
    scanner = devices(play=play)
    folder = ScanFolder.create(tmp_path / "cup", Plan({"stage": places}))
    take(folder, scanner, verify=0)
    assert read_scan(tmp_path / "cup").checks == (PlaceCheck(0, len(places) - 1),)
    # It counts from the switch again, and goes on.
    stage = scanner.axes["stage"]
    stage.move_to(4000)
    assert isinstance(stage, SimulatedStage)
    assert stage.true_position() == 4000


@pytest.mark.parametrize("stall_rate", [300.0, 450.0, 700.0])
@pytest.mark.parametrize("places", [(5000, 6000), (100, 9000, 2000), (1000, 15000)])
def test_lost_steps_mark_the_frames(tmp_path: Path, stall_rate: float, places: tuple[int, ...]):
    """Above some rate the motor makes every other step, and the controller counts them all."""
    scanner = devices(stall_rate=stall_rate)
    folder = ScanFolder.create(tmp_path / "cup", Plan({"stage": places}))
    with pytest.raises(PositionUncertainError, match=r"steps were lost, the stage by \d+ steps: frames 0 to") as error:
        take(folder, scanner, verify=0)
    (check,) = read_scan(tmp_path / "cup").checks
    assert (check.first, check.last) == (0, len(places) - 1)
    assert abs(check.off["stage"]) > 100
    assert f"by {abs(check.off['stage'])} steps" in str(error.value)
    assert len(read_scan(tmp_path / "cup").frames) == len(places)


def test_frames_between_two_checks(tmp_path: Path):
    scanner = devices()
    folder = ScanFolder.create(tmp_path / "cup", Plan({"stage": tuple(range(0, 7000, 1000))}))
    stage = scanner.axes["stage"]
    assert isinstance(stage, SimulatedStage)

    def taken(path: Path, frame: object) -> None:
        if len(folder.done.frames) == 5:
            # A hand pushes the load.
            stage.line.port.axis.push(-30, stage.line.port.clock.now_s())

    with pytest.raises(PositionUncertainError, match="frames 3 to 5 are marked"):
        take(folder, scanner, taken=taken, verify=3)
    assert read_scan(tmp_path / "cup").checks == (PlaceCheck(0, 2), PlaceCheck(3, 5, {"stage": 30}))
    take(folder, scanner, verify=3)
    assert read_scan(tmp_path / "cup").checks[-1] == PlaceCheck(6, 6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_motor_is_found_to_be(kind: str):
    """Without a fault every photograph of every controller is verified."""
    for seed in range(2):
        found = session(seed, kind, sound=True)
        assert (found.error, found.wrong, found.right) == ("", 0, found.photographs)


def test_sessions_as_they_come_leave_no_wrong_place_unmarked():
    """Rates at which motors stall, loads that are pushed, bad lines, three controllers."""
    check([session(seed) for seed in range(30)])


@pytest.mark.long
def test_five_hundred_sessions_leave_no_wrong_place_unmarked():
    check([session(seed) for seed in range(500)])


def check(found: list[Session]) -> None:
    assert sum(one.wrong for one in found) > len(found) // 3
    assert {one.kind for one in found if one.wrong} == {one.kind for one in found if one.right} == set(KINDS)
    # Neither called right, nor in a scan that says nothing of them.
    assert [one for one in found if one.called_right or one.unchecked] == []


@pytest.mark.parametrize("kind", [Grbl, Marlin])
@pytest.mark.parametrize("lost", [0, 30, -300])
def test_controllers_that_define_their_count_by_homing(kind: type[Grbl | Marlin], lost: int):
    per_mm, at_switch = (250, 250) if kind is Grbl else (80, 0)
    stage = kind(f"emulator://{kind.__name__.lower()}?length=22000&play=100", TRAVEL, steps_per_mm=per_mm)
    assert stage.verifiable
    stage.home()
    stage.move_to(5000)
    port = stage.line.port
    port.axis.push(-lost, port.clock.now_s())
    assert stage.verify() == pytest.approx(lost, abs=1)
    # It counts again, and its own limits hold again.
    stage.move_to(3000)
    assert port.axis.load(port.clock.now_s()) == 3000 + at_switch - TRAVEL.switch
    assert stage.verify() == 0


@pytest.mark.parametrize(("key", "value"), [(20, "1"), (21, "0"), (22, "0")])
def test_grbl_whose_limits_do_not_let_it(key: int, value: str, tmp_path: Path):
    stage = Grbl("emulator://grbl?length=22000", TRAVEL, steps_per_mm=250)
    stage.line.port.controller.settings[key] = value
    assert not stage.verifiable
    with pytest.raises(SettingsError, match="cannot be verified"):
        stage.verify()
    folder = ScanFolder.create(tmp_path / "cup", Plan({"stage": (0, 1000)}, settle_s=0.0))
    laser = SimulatedLaser()
    take(folder, Devices(GreyCamera(SimulatedStage(TRAVEL), laser), {"stage": stage}, laser), verify=0)
    assert folder.done.checks == ()


def test_what_was_to_be_verified_and_was_not_is_marked(tmp_path: Path):
    """A scan that ends early says so of its frames, also after it was continued."""
    scanner = devices()
    folder = ScanFolder.create(tmp_path / "cup", Plan({"stage": (0, 1000, 2000)}))
    assert isinstance(scanner.camera, GreyCamera)
    scanner.camera.fails_at = 2000
    with pytest.raises(CameraError):
        take(folder, scanner, verify=0)
    assert read_scan(tmp_path / "cup").checks == (PlaceCheck(0, 1, unverified=True),)
    (said,) = doubts(folder.done.checks)
    assert "frames 0 to 1 were to be verified and were not" in said
    scanner.camera.fails_at = -1
    take(ScanFolder.resume(tmp_path / "cup"), scanner, verify=0)
    assert read_scan(tmp_path / "cup").checks == (PlaceCheck(0, 1, unverified=True), PlaceCheck(2, 2))


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scan = ["scan", str(tmp_path / "cup"), "--frames", "3", "--apart", "100", "--json"]
    assert main(scan) == 0
    assert json.loads(capsys.readouterr().out)["checks"] == [{"first": 0, "last": 2}]
    assert main([*scan[:1], str(tmp_path / "plate"), *scan[2:], "--no-verify"]) == 0
    assert json.loads(capsys.readouterr().out)["checks"] == []
    for options, words in {
        ("--no-verify", "--verify", "2"): "leave one",
        ("--verify", "-1"): "a number of frames",
    }.items():
        assert main([*scan[:1], str(tmp_path / "bowl"), *scan[2:], *options]) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "bowl").exists()


def test_an_axis_without_a_switch(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "scanner.toml").write_text(
        '[stage]\nkind = "bistep"\nport = "emulator://bistep"\nreference = "here"\n'
        '[laser]\nkind = "fixed"\n[camera]\nkind = "folder"\nsource = "."\n'
    )
    write_image(tmp_path / "photograph.png", np.zeros((4, 5, 3), np.uint8))
    with_it = ["--scanner", str(tmp_path / "scanner.toml"), "--verify"]
    assert main(["scan", str(tmp_path / "cup"), "--frames", "1", "--apart", "100", *with_it]) == 2
    assert "the stage cannot be verified: no switch" in capsys.readouterr().err


def test_what_reads_the_scan_says_it(tmp_path: Path):
    assert main(["scan", str(tmp_path / "cup"), "--frames", "3", "--apart", "100"]) == 0
    scan = read_scan(tmp_path / "cup")
    marked = type(scan)(**{**vars(scan), "checks": (PlaceCheck(0, 1), PlaceCheck(2, 2, {"stage": 35}))})
    write_scan(marked)
    assert read_scan(tmp_path / "cup") == marked
    (said,) = doubts(read_scan(tmp_path / "cup").checks)
    assert said.startswith("frames 2 to 2 may have been taken elsewhere than their positions say, by up to 35 steps")


@pytest.mark.parametrize(
    ("checks", "words"),
    [
        ("3", "a list of tables"),
        ("[3]", "give tables"),
        ("[{ first = 0, last = 9 }]", "frames of the scan"),
        ("[{ first = 2, last = 1 }]", "frames of the scan"),
        ("[{ first = 0, last = 1, off = { stage = 1.5 } }]", "whole number"),
        ("[{ first = 0, last = 1, of = { stage = 1 } }]", 'did you mean "off"'),
    ],
)
def test_checks_that_are_none(tmp_path: Path, checks: str, words: str):
    assert main(["scan", str(tmp_path / "cup"), "--frames", "3", "--apart", "100", "--no-verify"]) == 0
    file = tmp_path / "cup" / "scan.toml"
    file.write_text(file.read_text().replace("[scan]\n", f"[scan]\nchecks = {checks}\n"))
    with pytest.raises(InputError, match=f"checks.*{words}"):
        read_scan(tmp_path / "cup")
