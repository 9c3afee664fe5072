"""Moves as trapezoids, and the legs that a stage goes."""

import math
from itertools import pairwise

import pytest

from hardware.errors import SettingsError
from hardware.stages import Travel
from hardware.travel import Trapezoid


@pytest.mark.parametrize("move", [Trapezoid(5000, 800, 2000), Trapezoid(100, 800, 2000), Trapezoid(900, 300, math.inf)])
def test_the_way_is_the_integral_of_the_speed(move):
    n = 20000
    dt = move.duration_s / n
    speeds = [min(move.rate, move.ramp * (i + 0.5) * dt, move.ramp * (n - i - 0.5) * dt) for i in range(n)]
    assert sum(speeds) * dt == pytest.approx(move.distance, rel=1e-3)
    assert move.gone(move.duration_s / 3) == pytest.approx(sum(speeds[: n // 3]) * dt, rel=1e-3)
    assert move.gone(-1) == 0
    assert move.gone(move.duration_s + 1) == move.distance


@pytest.mark.parametrize("distance", [1, 100, 320, 321, 5000])
def test_when_is_the_inverse_of_gone(distance):
    move = Trapezoid(distance, 800, 2000)
    for share in (0.01, 0.3, 0.5, 0.9, 1.0):
        assert move.gone(move.when(share * distance)) == pytest.approx(share * distance)


def test_a_long_move_is_given_its_time():
    """100 000 steps at 800 steps/s take 125 s: no deadline that is not reckoned from that would do."""
    travel = Travel(rate_steps_s=800, ramp_steps_s2=1e6)
    assert travel.move(100_000).duration_s == pytest.approx(125, abs=0.1)
    assert 125 < travel.allowed_s(100_000) < 200


@pytest.mark.parametrize(("start", "target"), [(0, 5000), (5000, 0), (300, 301), (301, 300), (0, 199)])
def test_every_way_ends_from_below_and_no_leg_is_short(start, target):
    travel = Travel(backlash=200)
    places = [start, *travel.legs(start, target)]
    assert places[-1] == target
    assert places[-1] - places[-2] >= 200
    assert all(abs(b - a) >= travel.approach for a, b in pairwise(places))


def test_standing_there_already_is_no_way():
    assert Travel().legs(70, 70) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate_steps_s": 0},
        {"rate_steps_s": math.nan},
        {"ramp_steps_s2": -1},
        {"backlash": -1},
        {"first": 5, "last": 5},
        {"switch": 0},
        {"switch": -1000, "backlash": 1001},
    ],
)
def test_what_no_stage_can_be_is_refused(wrong):
    with pytest.raises(SettingsError, match="|".join(wrong)):
        Travel(**wrong)
