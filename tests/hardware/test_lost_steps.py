"""Steps that a motor loses: the switch is met again, and the frames since are marked."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest

from hardware.cli.main import main
from hardware.errors import PositionUncertainError
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
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
    # It counts from the switch anew, and goes on.
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


def test_sessions_as_they_come_leave_no_wrong_place_unmarked(tmp_path: Path):
    """Rates at which motors stall, places and pushes as they come: what is not marked was taken where it says."""
    random = np.random.default_rng(0)
    wrong = unmarked = 0
    for session in range(60):
        stall = float(random.choice([1e6, 250.0, 400.0, 600.0, 790.0]))
        scanner = devices(stall_rate=stall, play=int(random.integers(0, 200)))
        stage = scanner.axes["stage"]
        assert isinstance(stage, SimulatedStage)
        places = tuple(map(int, random.permutation(np.arange(20))[: random.integers(1, 5)] * 1000))
        folder = ScanFolder.create(tmp_path / str(session), Plan({"stage": places}, settle_s=0.0))
        true: list[float] = []

        def taken(path: Path, frame: object, true: list[float] = true, stage: SimulatedStage = stage) -> None:
            true.append(stage.true_position())

        with contextlib.suppress(PositionUncertainError):
            take(folder, scanner, taken=taken, verify=0)
        checks = folder.done.checks
        off = np.abs(np.array(true) - places[: len(true)]) > 4
        marked = np.ones(len(true), bool)
        for check in checks:
            if not check.off:
                marked[check.first : check.last + 1] = False
        wrong += int(off.sum())
        unmarked += int((off & ~marked).sum())
    assert wrong > 20
    assert unmarked == 0


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
