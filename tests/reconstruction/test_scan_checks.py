"""Positions of axes that do not go with the rig are refused or remarked upon before any photograph is read."""

from dataclasses import replace
from pathlib import Path

import pytest

from jaxscan.errors import InputError
from jaxscan.files.axes import StepRule
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings
from jaxscan.reconstruction.frames import wrong_size
from jaxscan.reconstruction.scan_checks import check_scan, way_notes
from jaxscan.rig import Rotary
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
    with pytest.raises(InputError, match=r"scan.toml: \[scan.axes\] the turntable moves, and the position of the s"):
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
    assert note.endswith("If it turned once, the steps given for each frame are wrong: a full turn is 3200")
    with pytest.raises(InputError, match=r"turntable turns by 35775 degrees, 99.4 full turns.*A full turn is 3200"):
        way_notes(rig, scan(turntable=tuple(range(0, 160 * 2000, 2000))))


def test_profiles_far_apart_are_remarked_upon_but_not_those_beyond_zero(rig):
    (note,) = way_notes(rig, scan(turntable=tuple(range(0, TURN, 400))))
    assert "up to 45.0 degrees of the turntable apart" in note
    assert way_notes(rig, scan(turntable=(*range(1600, TURN, 20), *range(0, 1600, 20)))) == []


def test_so_many_steps_as_are_said_are_few_enough(rig):
    """As many frames as were advised before were still too few."""
    turns = tuple(range(0, TURN, 400))
    (note,) = way_notes(rig, scan(turntable=turns))
    assert note.endswith("take one every 10 degrees, 88 steps, or fewer")
    every = 88
    assert way_notes(rig, scan(turntable=tuple(range(0, TURN, every)))) == []
    assert way_notes(rig, scan(turntable=tuple(range(0, TURN, every + 1)))) != []


def test_a_turn_between_two_sweeps_along_a_line_is_not_frames_apart(rig):
    there = {"stage": (*ALONG, *ALONG), "turntable": (0,) * len(ALONG) + (1600,) * len(ALONG)}
    assert way_notes(rig, scan(**there)) == []
    turns = tuple(range(0, TURN, 40))
    twice = {"stage": (0,) * len(turns) + (9000,) * len(turns), "turntable": (*turns, *(n + 1600 for n in turns))}
    assert not any("apart" in note for note in way_notes(rig, scan(**twice)))


def test_a_video_whose_frames_are_far_apart(rig):
    rules = {"stage": StepRule(37000, 0), "turntable": StepRule(0, 400)}
    video = Scan(Path("scan.toml"), StripeSettings(), video=Path("scan.mp4"), rules=rules)
    (note,) = way_notes(rig, video)
    assert "up to 45.0 degrees of the turntable apart" in note
    (note,) = way_notes(rig, replace(video, rules={"stage": StepRule(37000, 0), "turntable": StepRule(8, 0)}))
    assert "all its frames are of one place, stage 37000, turntable 8" in note
    with pytest.raises(InputError, match=r"scan.toml: \[scan.axes\] turntable turns by 225 degrees a frame: are these"):
        way_notes(rig, replace(video, rules={"stage": StepRule(37000, 0), "turntable": StepRule(0, 2000)}))
    with pytest.raises(InputError, match=r"turntable turns by 675 degrees, 1.9 full turns: are these"):
        way_notes(rig, scan(turntable=(0, 2000, 4000, 6000)))


def test_a_place_beyond_all_measure_is_refused(rig):
    check_scan(rig, scan(stage=tuple(n + 10**7 for n in ALONG)))
    with pytest.raises(InputError, match=r"scan.toml: \[scan\] at step 9007199254740992 the stage is 9.01e\+09 m from"):
        check_scan(rig, scan(stage=(2**53,) * 4, turntable=(0, 20, 40, 60)))


def test_a_sequence_that_no_session_can_have_is_not_advised(rig):
    with pytest.raises(InputError, match=r"the lift moves.*it has stage, turntable: name the axis as the rig does$"):
        check_scan(rig, scan(lift=ALONG))
    with pytest.raises(InputError, match=r"calibrate with a \[turntable\] sequence, or name the axis as"):
        check_scan(rig_2003.simulated_rig(0), scan(turntable=ALONG))


def test_a_table_whose_steps_are_wide(rig):
    coarse = replace(rig, motion=Rotary.create([0.0, 0.0, 0.3], [0.0, 0.0, 300.0]))
    (note,) = way_notes(coarse, scan(turntable=tuple(range(20))))
    assert note.endswith("take one every 10 degrees or fewer")


def test_photographs_of_a_part_of_the_sensor_are_refused_with_the_way_to_read_them():
    def said(size: tuple[int, int]) -> str:
        return wrong_size("000.png", size, (1024, 768))

    assert "000.png: the photograph has 1024 x 512 pixels, the rig was calibrated with 1024 x 768: " in said(
        (1024, 512)
    )
    assert "subtract the region's first column and row from principal; for binned pixels" in said((512, 384))
    assert said((2048, 700)).endswith("at the size it was calibrated for")
    assert "it is turned by a quarter, as phones and programs do by an EXIF" in said((768, 1024))
    assert said((768, 1024)).endswith("makes them look like those of the calibration")
