"""Positions of axes that do not go with the rig are refused or remarked upon before any photograph is read."""

from pathlib import Path

import pytest

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings
from jaxscan.reconstruction.scan_checks import check_scan, way_notes
from jaxscan.simulation import rig_2003

TURN = rig_2003.STEPS_PER_TURN
ALONG = tuple(range(0, 20000, 2000))


@pytest.fixture(scope="module")
def rig():
    return rig_2003.with_turntable(rig_2003.simulated_rig(0), 0)


def scan(**axes: tuple[int, ...]) -> Scan:
    return Scan(Path("scan.toml"), StripeSettings(), axes=axes)


def test_it_must_be_said_where_what_carries_a_turntable_stands(rig):
    turns = tuple(range(0, TURN, 400))
    with pytest.raises(
        InputError, match=r"scan.toml: \[scan.axes\] the turntable moves, and it is not said where the s"
    ):
        check_scan(rig, scan(turntable=turns))
    check_scan(rig, scan(turntable=turns, stage=(37000,) * len(turns)))
    # The turntable stands on the stage, so wherever it stands it goes along.
    check_scan(rig, scan(stage=ALONG))
    assert way_notes(rig, scan(stage=ALONG)) == []


def test_frames_of_one_place_are_remarked_upon(rig):
    (note,) = way_notes(rig, scan(stage=(37000,) * 5))
    assert "all 5 frames are of one place, stage 37000" in note


def test_more_than_a_turn_and_the_steps_of_another_axis(rig):
    fine = tuple(range(0, TURN, 20))
    assert way_notes(rig, scan(turntable=fine)) == []
    assert way_notes(rig, scan(turntable=(*fine, TURN))) == []
    (note,) = way_notes(rig, scan(turntable=(*fine, *(TURN + n for n in fine))))
    assert "more than one full turn" in note
    with pytest.raises(InputError, match=r"turntable turns by 35775 degrees, 99.4 full turns.*A full turn is 3200"):
        way_notes(rig, scan(turntable=tuple(range(0, 160 * 2000, 2000))))


def test_profiles_far_apart_are_remarked_upon_but_not_those_beyond_zero(rig):
    (note,) = way_notes(rig, scan(turntable=tuple(range(0, TURN, 400))))
    assert "up to 45.0 degrees of the turntable apart" in note
    assert way_notes(rig, scan(turntable=(*range(1600, TURN, 20), *range(0, 1600, 20)))) == []
