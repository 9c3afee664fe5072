"""Stages on emulated controllers: where they come to stand, and what they say when something is wrong."""

import threading
import time

import pytest

from benchmarks.serial_sessions import TRAVEL, struck
from hardware import StageDriver
from hardware.emulator.port import EmulatedTerminal
from hardware.errors import (
    HardwareError,
    LineLostError,
    NoAnswerError,
    NotHomedError,
    PositionUncertainError,
    SettingsError,
    StoppedError,
)
from hardware.lasers import ControllerLaser, FixedLaser, RtsLaser
from hardware.stages import BiStep2A04, Grbl, Marlin

KINDS = {
    "bistep": (lambda url, **k: BiStep2A04(url, TRAVEL, **k), 0),
    "bistep?echo=1": (lambda url, **k: BiStep2A04(url, TRAVEL, **k), 0),
    "grbl": (lambda url, **k: Grbl(url, TRAVEL, steps_per_mm=250, **k), 250),
    "marlin": (lambda url, **k: Marlin(url, TRAVEL, steps_per_mm=80, **k), 0),
}


def make(kind: str, faults: str = "", **how):
    join = "&" if "?" in kind else "?"
    return KINDS[kind][0](f"emulator://{kind}{join}length=14000&play=150{faults}", **how)


def true_steps(stage, kind: str) -> float:
    port = stage.line.port
    return port.axis.load(port.clock.now_s()) - KINDS[kind][1] + TRAVEL.switch


@pytest.mark.parametrize("kind", KINDS)
def test_the_load_is_where_the_position_says_from_either_side(kind):
    stage = make(kind)
    assert isinstance(stage, StageDriver)
    with pytest.raises(NotHomedError, match="home"):
        stage.move_to(100)
    stage.home()
    for place in (0, 3000, 3001, 3000, 500, 12000):
        stage.move_to(place)
        assert stage.position() == place
        assert true_steps(stage, kind) == pytest.approx(place)
    stage.stop()
    with pytest.raises(NotHomedError):
        stage.position()
    stage.home()
    assert true_steps(stage, kind) == pytest.approx(0)
    stage.close()
    stage.close()


@pytest.mark.parametrize("kind", KINDS)
def test_a_long_way_takes_its_time_and_no_more(kind):
    stage = make(kind)
    stage.home()
    clock = stage.line.clock
    begin_s = clock.now_s()
    stage.move_to(12000)
    assert 12000 / 800 < clock.now_s() - begin_s < 12000 / 800 + 2


def test_places_beyond_the_travel_are_refused_before_anything_moves():
    stage = make("bistep")
    stage.home()
    for place in (-1, 12001):
        with pytest.raises(SettingsError, match="from 0 to 12000"):
            stage.move_to(place)
    assert stage.position() == 0


@pytest.mark.parametrize("kind", KINDS)
def test_stop_from_another_thread(kind):
    stage = make(kind, "&speed=10")
    stage.home()
    ended = []

    def move() -> None:
        try:
            stage.move_to(12000)
        except HardwareError as error:
            ended.append(error)

    mover = threading.Thread(target=move)
    mover.start()
    time.sleep(0.3)
    stage.stop()
    axis, now_s = stage.line.port.axis, stage.line.clock.now_s()
    assert not axis.moving(now_s)
    assert 500 < true_steps(stage, kind) < 11000
    mover.join(2)
    assert not mover.is_alive()
    assert isinstance(ended[0], StoppedError)


@pytest.mark.parametrize("kind", ["bistep", "grbl", "marlin"])
@pytest.mark.parametrize("silent", [0, 1])
def test_a_cable_pulled_in_mid_move_says_that_the_stage_may_move(kind, silent):
    stage = make(kind, f"&pull_s=18&silent={silent}")

    def move_about() -> None:
        while True:
            stage.home()
            stage.move_to(12000)

    with pytest.raises(HardwareError, match="MAY STILL BE MOVING"):
        move_about()
    assert stage.line.clock.now_s() < 60
    with pytest.raises(LineLostError, match="MAY STILL BE MOVING"):
        stage.stop()


@pytest.mark.parametrize("kind", ["bistep", "grbl", "marlin"])
def test_a_stage_without_a_switch_ends_in_time(kind):
    stage = make(kind, "&length=9000000&start=8000000")
    with pytest.raises(NoAnswerError, match="switch"):
        stage.home()
    assert not stage.line.port.axis.moving(stage.line.clock.now_s())


def test_nobody_at_the_other_end():
    stage = make("bistep", "&drop=1")
    with pytest.raises(NoAnswerError, match="check that it is on, cable and baud rate"):
        stage.home()


def test_a_controller_that_lost_its_power_is_noticed():
    stage = make("bistep")
    stage.home()
    stage.move_to(1000)
    stage.line.send(b"!")
    with pytest.raises(PositionUncertainError, match="says 0 steps, but it was left at 1000"):
        stage.move_to(2000)
    stage.home()
    stage.move_to(2000)
    assert true_steps(stage, "bistep") == 2000


def test_a_count_that_was_kept_may_be_taken_over():
    stage = make("bistep", homed=True)
    stage.line.send(b"700=")
    assert stage.position() == 700
    stage.stop()
    with pytest.raises(NotHomedError):
        stage.position()


@pytest.mark.parametrize(("byte", "stride"), [(b"=", 5), (b"g", 9), (b"!", 9)])
def test_one_byte_garbled_anywhere_defines_no_position(byte, stride):
    """The second of `2000g` and `2000=`, or of `-1?` and `-1=`, is understood as well."""
    for index in range(0, 400, stride):
        assert struck("bistep", index, byte[0]).fault == ""


def test_part_of_an_order_that_leads_back_to_the_start():
    """`2=00g`: a count of 2, and from there to 0, where it stood before."""
    outcomes = [struck("bistep", index, ord("=")) for index in range(90, 150)]
    assert [outcome.fault for outcome in outcomes] == [""] * 60
    assert any(outcome.error for outcome in outcomes)


def test_lasers(tmp_path):
    stage = make("bistep")
    laser = RtsLaser(stage.line)
    assert laser.switchable
    assert not stage.line.port.laser
    laser.on()
    assert stage.line.port.laser
    laser.off()
    assert not stage.line.port.laser
    assert not FixedLaser().switchable
    for kind in ("grbl", "marlin"):
        stage = make(kind)
        stage.home()
        laser = ControllerLaser(stage)
        laser.on()
        assert stage.line.port.laser
        laser.off()
        assert not stage.line.port.laser


@pytest.mark.parametrize("kind", ["bistep", "grbl", "marlin"])
def test_a_laser_beyond_a_pulled_cable_may_be_on(kind):
    stage = make(kind, "&pull_s=30")
    stage.home()
    laser = RtsLaser(stage.line) if kind == "bistep" else ControllerLaser(stage)
    laser.on()
    stage.line.clock.sleep(60)
    with pytest.raises(LineLostError, match="LASER MAY STILL BE ON"):
        laser.off()


def test_ports_that_are_not_there_and_settings_that_cannot_be(tmp_path):
    with pytest.raises(SettingsError, match="scanner devices"):
        BiStep2A04(str(tmp_path / "ttyUSB0"))
    with pytest.raises(SettingsError, match="no such controller"):
        BiStep2A04("emulator://a4988")
    with pytest.raises(SettingsError, match="unknown: drops"):
        BiStep2A04("emulator://bistep?drops=1")
    with pytest.raises(SettingsError, match="steps_per_mm"):
        Grbl("emulator://grbl", steps_per_mm=0)


def test_a_real_serial_port_through_a_terminal():
    with EmulatedTerminal("emulator://bistep?speed=1&echo=1") as terminal:
        stage = BiStep2A04(terminal.path, TRAVEL, homed=True)
        stage.line.send(b"700=")
        assert stage.position() == 700
        stage.line.send(b"9000g")
        stage.stop()
        assert not terminal.controller.axis.moving(terminal.clock.now_s())
        stage.close()
