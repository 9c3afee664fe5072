"""Two axes: of one controller on one line, on lines of their own, and in scans of any mixture."""

import json
import random
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from hardware import Frame, StageDriver
from hardware.emulator.port import EmulatedTerminal
from hardware.errors import HardwareError, LeftOnError, NotHomedError, SettingsError, StoppedError
from hardware.lasers import ControllerLaser
from hardware.safety import safely
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import BiStep2A04, Grbl, Marlin, Travel
from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan

STAGE = Travel(last=12000, switch=-1000)
TABLE = Travel(last=3200, steps_per_turn=3200, reference="here")
WITH_SWITCH = Travel(last=3200, steps_per_turn=3200)
KINDS = {"grbl": (Grbl, 250, 250), "marlin": (Marlin, 80, 0)}


def pair(kind: str, faults: str = "", travel: Travel = TABLE, first: str | None = None) -> tuple:
    """A stage on X and a turntable on Y of one controller; their X homes at once, as X alone, unless it is named."""
    make, steps_per_mm, _ = KINDS[kind]
    url = f"emulator://{kind}?length=14000&play=150&y_length=90000&y_start=40000&y_play=20{faults}"
    stage = make(url, STAGE, steps_per_mm=steps_per_mm, axis=first)
    table = make(url, travel, steps_per_mm=steps_per_mm, axis="Y", beside=stage)
    return stage, table


def true_steps(stage, kind: str) -> tuple[float, float]:
    """Where the two loads really are: from the stage's step 0, and from where the table's motor began."""
    port = stage.line.port
    x, y = (port.axes[letter].load(port.clock.now_s()) for letter in "XY")
    return x - KINDS[kind][2] + STAGE.switch, y


@pytest.mark.parametrize("kind", KINDS)
def test_two_axes_of_one_controller(kind):
    stage, table = pair(kind)
    assert isinstance(table, StageDriver)
    assert table.line is stage.line
    with pytest.raises(NotHomedError, match=r"axis Y: .* home it"):
        table.move_to(100)
    stage.home()
    table.home()
    begun = true_steps(stage, kind)[1]
    for place, turn in ((3000, 8), (3000, 16), (500, 16), (500, 3200), (12000, 0)):
        stage.move_to(place)
        table.move_to(turn)
        assert (stage.position(), table.position()) == (place, turn)
        assert true_steps(stage, kind) == pytest.approx((place, begun + turn))
    laser = ControllerLaser(table)
    laser.on()
    assert stage.line.port.laser
    laser.off()
    table.check()
    # To home the one moves nothing of the other, and costs it no count.
    stage.home()
    assert true_steps(stage, kind) == pytest.approx((0, begun))
    assert table.position() == 0
    stage.close()
    table.close()


@pytest.mark.parametrize("kind", KINDS)
def test_a_switch_of_its_own(kind):
    stage, table = pair(kind, travel=WITH_SWITCH, first="X")
    table.home()
    stage.home()
    pull_off = KINDS[kind][2]
    assert true_steps(stage, kind) == pytest.approx((0, pull_off - WITH_SWITCH.switch))
    table.move_to(1600)
    assert true_steps(stage, kind) == pytest.approx((0, pull_off - WITH_SWITCH.switch + 1600))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("by", [0, 1])
def test_a_stop_of_one_stops_both(kind, by):
    axes = pair(kind, "&speed=10")
    stage, table = axes
    for axis in axes:
        axis.home()
    ended = []

    def move() -> None:
        try:
            table.move_to(3200)
        except HardwareError as error:
            ended.append(error)

    mover = threading.Thread(target=move)
    mover.start()
    time.sleep(0.2)
    axes[by].stop()
    port = stage.line.port
    assert not any(axis.moving(port.clock.now_s()) for axis in port.axes.values())
    mover.join(2)
    assert isinstance(ended[0], StoppedError)
    for axis in axes:
        with pytest.raises(NotHomedError):
            axis.position()
    # What a reset in mid-move has locked is unlocked.
    table.home()
    stage.home()
    table.move_to(8)
    assert (stage.position(), table.position()) == (0, 8)


def test_stopped_from_two_threads_at_once_both_stand():
    stage, table = pair("grbl", "&speed=10")
    stage.home()
    table.home()

    def fail() -> None:
        with safely({"stage": stage, "turntable": table}, None):
            raise ZeroDivisionError

    for _ in range(3):
        with pytest.raises(ZeroDivisionError):
            fail()


def test_a_pulled_cable_says_of_both_that_they_may_move():
    stage, table = pair("marlin", "&pull_s=40")
    stage.home()
    table.home()

    def go_on() -> None:
        with safely({"stage": stage, "turntable": table}, ControllerLaser(stage)):
            while True:
                table.move_to(3200)
                table.move_to(0)

    with pytest.raises(LeftOnError) as caught:
        go_on()
    for words in ("LASER MAY STILL BE ON", "STAGE MAY STILL BE MOVING", "TURNTABLE MAY STILL BE MOVING"):
        assert words in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
def test_two_axes_through_a_terminal(kind):
    make, steps_per_mm, _ = KINDS[kind]
    with EmulatedTerminal(f"emulator://{kind}?speed=1&y_length=90000&y_start=40000") as terminal:
        stage = make(terminal.path, STAGE, steps_per_mm=steps_per_mm)
        table = make(terminal.path, TABLE, steps_per_mm=steps_per_mm, axis="Y", beside=stage)
        table.home()
        before = terminal.controller.axes["Y"].motor(terminal.clock.now_s())
        stop = threading.Timer(0.8, stage.stop)
        stop.start()
        with pytest.raises(StoppedError):
            table.move_to(3200)
        stop.join()
        assert not terminal.controller.axes["Y"].moving(terminal.clock.now_s())
        assert terminal.controller.axes["Y"].motor(terminal.clock.now_s()) != before
        stage.close()


def test_a_bistep_without_a_switch():
    table = BiStep2A04("emulator://bistep?length=90000&start=40000", TABLE)
    table.home()
    for turn in (8, 3200, 0):
        table.move_to(turn)
        assert table.position() == turn
        assert table.line.port.axis.motor(table.line.clock.now_s()) == pytest.approx(40000 + turn)


def test_axes_that_cannot_be():
    stage, _ = pair("grbl")
    url = stage.line.name
    for wrong, says in (
        ({"axis": "Q"}, 'axis = "Q": give the letter'),
        ({"axis": "X", "beside": stage}, "is the port of another axis"),
        ({"beside": stage}, "is the port of another axis"),
    ):
        with pytest.raises(SettingsError, match=says):
            Grbl(url, TABLE, steps_per_mm=250, **wrong)
    with pytest.raises(SettingsError, match="is the port of another axis"):
        Marlin(url, TABLE, steps_per_mm=250, axis="Y", beside=stage)
    fourth = Grbl(url, TABLE, steps_per_mm=250, axis="A", beside=stage)
    with pytest.raises(SettingsError, match="reports 3 axes and no A"):
        fourth.home()
    for wrong, says in (
        ({"steps_per_turn": 0}, "steps_per_turn = 0"),
        ({"reference": "there"}, "must be one of switch, here"),
        ({"reference": "here", "first": 10}, "homed at 0"),
    ):
        with pytest.raises(SettingsError, match=says):
            Travel(**wrong)


class GreyCamera:
    """Photographs a grey that says where both axes truly are."""

    def __init__(self, axes: Mapping[str, SimulatedStage]):
        self.axes = axes

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Nothing."""

    def expose(self, positions: Mapping[str, int]) -> Frame:
        level = sum(
            factor * axis.true_position() for factor, axis in zip((0.001, 0.01), self.axes.values(), strict=True)
        )
        return Frame(np.full((4, 5), round(level), np.uint8), positions, 0.0, 0.01)

    def close(self) -> None:
        """Nothing."""


def devices() -> Devices:
    axes = {"stage": SimulatedStage(STAGE), "turntable": SimulatedStage(WITH_SWITCH)}
    return Devices(GreyCamera(axes), axes, SimulatedLaser())


MIXTURE = {"turntable": (0, 1600, 0, 1600), "stage": (2000, 2000, 7000, 7000)}


def test_a_scan_that_turns_and_shifts_and_turns_again(tmp_path: Path):
    folder = ScanFolder.create(tmp_path / "scan", Plan(MIXTURE, name="owl"))
    assert json.loads((tmp_path / "scan" / "plan.json").read_text())["axes"]["turntable"] == [0, 1600, 0, 1600]
    there = devices()

    def taken(path: Path, frame: Frame) -> None:
        scan = read_scan(tmp_path / "scan")
        assert {name: steps[-1] for name, steps in scan.axes.items()} == frame.positions
        if len(scan.frames) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        take(folder, there, taken=taken)
    # A stop is of all axes: none of them may be believed.
    for axis in there.axes.values():
        with pytest.raises(NotHomedError):
            axis.position()
    folder = ScanFolder.resume(tmp_path / "scan")
    assert folder.left == ({"turntable": 1600, "stage": 7000},)
    take(folder, there)
    scan = read_scan(tmp_path / "scan")
    assert (scan.axes, list(scan.axes)) == (MIXTURE, ["turntable", "stage"])
    levels = [int(np.asarray(pixels).flat[0]) for pixels in map(_pixels, scan.frames)]
    assert levels == [2, 18, 7, 23]
    there.close()


def test_an_axis_that_the_scan_does_not_name_does_not_move(tmp_path: Path):
    there = devices()
    before = there.axes["turntable"].true_position()
    take(ScanFolder.create(tmp_path / "scan", Plan({"stage": (0, 1000)})), there)
    assert there.axes["turntable"].true_position() == before
    assert "[scan.axes]" not in (tmp_path / "scan" / "scan.toml").read_text()


def test_positions_of_an_axis_that_the_scanner_lacks(tmp_path: Path):
    there = devices()
    alone = Devices(there.camera, {"stage": there.axes["stage"]}, there.laser)
    with pytest.raises(InputError, match="moves the axis turntable, and this scanner has stage"):
        take(ScanFolder.create(tmp_path / "scan", Plan(MIXTURE)), alone)


def test_a_scan_begun_before_axes_had_names_goes_on(tmp_path: Path):
    there = devices()
    take(ScanFolder.create(tmp_path / "scan", Plan({"stage": (0, 1000)})), there)
    path = tmp_path / "scan" / "plan.json"
    plan = json.loads(path.read_text())
    del plan["axes"]
    path.write_text(json.dumps({**plan, "format": "jaxscan-plan/1", "steps": [0, 1000, 2000]}))
    folder = ScanFolder.resume(tmp_path / "scan")
    assert folder.left == ({"stage": 2000},)
    take(folder, there)
    assert read_scan(tmp_path / "scan").axes["stage"] == (0, 1000, 2000)
    folder.go_on_at([{"stage": 3000}], 0.0)
    assert ScanFolder.resume(tmp_path / "scan").left == ({"stage": 3000},)
    with pytest.raises(
        InputError, match="position of stage for one photograph, and of turntable and stage for another"
    ):
        folder.go_on_at([{"turntable": 0, "stage": 4000}], 0.0)


def _pixels(path: Path) -> np.ndarray:
    from jaxscan.images import read_image

    return read_image(path)


@pytest.mark.parametrize("seed", range(24))
def test_two_axes_on_a_bad_line_believe_nothing_wrong(seed: int):
    """Bytes are lost, doubled, garbled and late: whatever position of either is believed, that is where it is."""
    random_ = random.Random(seed)
    faults = "".join(
        f"&{fault}={10 ** random_.uniform(-4, -2):.6f}"
        for fault in random_.sample(("drop", "double", "garble", "delay"), random_.randint(1, 4))
    )
    kind = random_.choice(tuple(KINDS))
    stage, table = pair(
        kind, f"{faults}&start=1500&stall_rate=2000&y_stall_rate=2000&seed={random_.randrange(1 << 30)}"
    )
    places = [(random_.randrange(12001), random_.randrange(3201)) for _ in range(3)]
    # Where nothing could be believed the driver says so.
    with suppress(HardwareError):
        stage.home()
        table.home()
        for place, turn in places:
            stage.move_to(place)
            table.move_to(turn)
            assert (stage.position(), table.position()) == (place, turn)
            assert true_steps(stage, kind) == pytest.approx((place, 40000 + turn))
