"""What the report says of a good calibration, and that it says what is wrong with a bad one."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics import Diagnostics, Ladder, diagnose
from jaxscan.calibration.diagnostics.halves import Agreement
from jaxscan.calibration.diagnostics.stripe_shapes import shape
from jaxscan.calibration.diagnostics.suspects import Suspect
from jaxscan.calibration.flatness import BoardFlatness
from jaxscan.calibration.sheet_curve import SheetCurve
from jaxscan.calibration.stage_shape import StageShape
from jaxscan.view.calibration_report import compose
from jaxscan.view.findings import findings
from tests.calibration import synthetic


@pytest.fixture(scope="module")
def diagnostics(calibration) -> Diagnostics:
    return diagnose(calibration)


def words(calibration, diagnostics, volumes=()):
    return " ".join(f"{b.level}: {b.statement} {b.advice}" for b in findings(calibration, diagnostics, volumes))


def test_drawn_data_are_good_but_for_what_they_do_not_cover(calibration, diagnostics, report):
    boxes = findings(calibration, diagnostics, ())
    assert all("of the image" in box.statement for box in boxes)
    assert report.verdict.level in ("good", "care")
    assert re.search(r", \d+ to \d+ mm away, is known to 0.\d+ mm in the median", report.verdict.statement)
    assert report.sections[2].title == "What photograph would help most?"
    assert re.search(
        r"^The board \d+ mm away .* would fall from 0.\d+ to 0.\d+ mm\.$", report.sections[2].paragraphs[0]
    )
    assert len(report.numbers["next_best_views"].poses) == 3


BOWED = np.arange(400.0), 1e-5 * (np.arange(400) - 200.0) ** 2


def level(offset: float) -> np.ndarray:
    return offset + 0.02 * np.random.default_rng(0).standard_normal(400)


SUSPECT = Suspect("07.png", False, 0.96, 0.5, 0.05, 0.06, 31.0, "mirrored left to right")


def agreement(factor: float, scale: float | None = None) -> Agreement:
    names, values = ("camera.focal.0", "lights.0.plane.0"), (np.ones(2), np.ones(2))
    p = 1e-9 if factor > 1.5 else 0.5
    return Agreement(("monday", "tuesday"), (6, 5), names, values, np.array([0.5, -4.0]), factor**2, p, scale, 0.001)


def better(ladder: Ladder, lens: str) -> Ladder:
    """The ladder with a lens that halves the held-out error."""
    rungs = [replace(r, held_out_px=r.held_out_px / 2) if r.lens == lens else r for r in ladder.rungs]
    return replace(ladder, rungs=tuple(rungs), supported=lens)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: {"suspects": (SUSPECT,)}, "stop: Photograph 07.png does not fit .* fits when it is mirrored left"),
        (lambda d: {"suspects": (replace(SUSPECT, explanation=None),)}, "stop: .* another camera"),
        (
            lambda d: {"suspects": (replace(SUSPECT, explanation=None, corners_rejected=0.01, stripe_rejected=0.99),)},
            "stop: .*07.png: its corners fit, and 99 % of its stripe points were rejected: .* stripe of another photo",
        ),
        (lambda d: {"suspects": (replace(SUSPECT, explanation=None, staged=True),)}, "stop: .* Its step count"),
        (
            lambda d: {"suspects": (replace(SUSPECT, explanation=None, corners_rejected=0.04, stripe_rejected=0.31),)},
            "care: Photograph 07.png: 31 % of its stripe points were rejected. Its corners fit",
        ),
        (lambda d: {"halves": agreement(2.0)}, "care: Two halves .* 2.0 times .* lights.0.plane.0, 4.0 σ"),
        (lambda d: {"halves": agreement(6.0)}, "stop: Two halves"),
        (lambda d: {"halves": None}, "care: A half of the photographs gives no rig"),
        (
            lambda d: {"halves": None, "too_few_for_halves": True},
            "care: There are too few photographs to solve two halves",
        ),
        (lambda d: {"sessions": (agreement(9.0, 0.05),)}, "stop: Millimetres of the session tuesday are 5.00 ± 0.1 %"),
        (lambda d: {"sessions": (agreement(2.0, 0.0),)}, "care: The sessions monday and tuesday disagree"),
        (lambda d: {"ladder": replace(d.ladder, chosen="brown")}, "care: The lens .brown. is richer .* only fit noise"),
        (lambda d: {"ladder": better(d.ladder, "radial2")}, "care: The lens .radial1. is too simple"),
        (
            lambda d: {"by_radius": replace(d.by_radius, radial_px=d.by_radius.radial_px + 0.04)},
            "care: Corners .* outwards in the mean",
        ),
        (
            lambda d: {"stripes": (shape("03.png", "", *BOWED, 300.0),)},
            "care: The stripe is not straight on 1 of 1 boards: 03.png",
        ),
        (
            lambda d: {"stripes": tuple(shape(f"{i}.png", "", BOWED[0], level(i / 10), 300.0) for i in range(-2, 4))},
            r"care: The stripes are straight and fit no plane: .* by 0.15 mm in .* are 3.png \(0.3 mm\), .* stand",
        ),
        (
            lambda d: {"coverage": replace(d.coverage, tilt_spread_deg=9.0)},
            "care: All boards are nearly parallel: .* 9°",
        ),
        (
            lambda d: {"corner_normality": replace(d.corner_normality, beyond_3=0.04)},
            "care: Errors of the corners are not normal: 4.0 %",
        ),
    ],
)
def test_what_is_wrong_is_said(calibration, diagnostics, change, expected):
    changed = replace(diagnostics, **change(diagnostics))
    assert re.search(expected, words(calibration, changed))
    assert not re.search(expected, words(calibration, diagnostics))


def test_one_stripe_that_is_off_says_nothing_of_the_others(calibration, diagnostics):
    """By RMS six stripes with 0.001 mm and one with 0.15 mm lie beside the plane by far more than they are crooked."""
    stripes = tuple(shape(f"{i}.png", "", BOWED[0], level(by), 300.0) for i, by in enumerate([0.001, -0.001] * 3))
    stripes += (shape("9.png", "", BOWED[0], level(0.15), 300.0),)
    said = words(calibration, replace(diagnostics, stripes=stripes))
    assert re.search(r"care: The whole stripe is off the light plane on 9.png \(\+0.15 mm\)", said)
    assert "fit no plane" not in said


def test_stripes_are_not_called_straight_and_crooked_at_once(calibration, diagnostics):
    """Of ten stripes beside the plane as wholes, two are bent as well; then all are."""
    offsets = [0.3, -0.3] * 5
    for bent, straight in ((2, True), (10, False)):
        stripes = tuple(
            shape(f"{i}.png", "", BOWED[0], level(by) + (BOWED[1] if i < bent else 0.0), 300.0)
            for i, by in enumerate(offsets)
        )
        said = words(calibration, replace(diagnostics, stripes=stripes))
        assert ("fit no plane" in said, "is not straight" in said) == (straight, not straight)


def test_what_a_curved_sheet_explains_is_not_laid_on_the_boards(calibration, diagnostics):
    """A curved sheet that was taken as flat puts stripes beside its plane as wholes, by less than it is curved."""
    stripes = tuple(shape(f"{i}.png", "", BOWED[0], level(0.05 * i), 300.0) for i in (-1, 1, -1, 1, -1, 1, 4))
    changed = replace(diagnostics, stripes=stripes)
    on_boards = "fit no plane|is off the light plane on 4.png"
    assert len(re.findall(on_boards, words(calibration, changed))) == 2
    curved = replace(calibration, sheet_curves=(SheetCurve("", -0.3, 0.03, 200.0, 345.0),))
    assert not re.search(on_boards, words(curved, changed))
    slightly = replace(calibration, sheet_curves=(SheetCurve("", 0.03, 0.003, 200.0, 345.0),))
    assert len(re.findall(on_boards, words(slightly, changed))) == 2


def test_a_board_that_is_not_flat_comes_before_the_lens_where_the_plane_does_not_fit(calibration, diagnostics):
    """A bent board looks like another lens, and the plane's advice was that lens."""
    crooked = tuple(shape(f"{i}.png", "", BOWED[0], 40 * BOWED[1] + level(0.0), 300.0) for i in range(6))
    missing = replace(diagnostics.missing_terms, lens="brown", p=1e-9, gain=0.1, shift_in_sigma=20.0)
    changed = replace(diagnostics, stripes=crooked, ladder=None, missing_terms=missing)

    def advice(calibration):
        (box,) = (b for b in findings(calibration, changed, ()) if "does not fit the stripes" in b.statement)
        return box.advice

    assert 'Set lens = "brown"' in advice(calibration)
    flatness = BoardFlatness("flat", 5.0, 0.04, 0.1, 1e-9, 1e-9, "camera.focal.0", 20.0, 12)
    assert "--board-shape bend" in advice(replace(calibration, flatness=flatness))


def test_boards_that_moved_between_corners_and_stripe_are_said(calibration):
    observed, moved = calibration.observations, []
    for view, by in zip(calibration.observations.views, np.random.default_rng(3).normal(0, 0.4, 11), strict=True):
        moved.append(
            replace(view, stripes=tuple(replace(s, pixels=s.pixels + np.array([0, by])) for s in view.stripes))
        )
    shaken = calibrate(replace(observed, views=tuple(moved)))
    said = words(shaken, diagnose(shaken, thorough=False))
    assert re.search(r"care: The stripes are straight and fit no plane: .* farthest are view-\d+ \(0.\d+ mm\)", said)


def test_the_worst_comes_first_and_makes_the_verdict(calibration, diagnostics, report):
    changed = replace(diagnostics, halves=agreement(2.0), suspects=(SUSPECT,))
    boxes = findings(calibration, changed, ())
    assert [box.level for box in boxes] == sorted((box.level for box in boxes), key=["stop", "care"].index)
    assert compose(calibration, changed, (), report.numbers["next_best_views"])[0].verdict.statement.startswith(
        "Do not use this calibration yet."
    )


def test_sessions_of_other_millimetres_come_before_the_photographs_that_do_not_fit_for_it(calibration, diagnostics):
    changed = replace(diagnostics, sessions=(agreement(9.0, -0.03),), suspects=(SUSPECT,))
    first, second, *_ = findings(calibration, changed, ())
    assert first.statement.startswith("Millimetres of the session tuesday are 3.00 ± 0.1 % shorter")
    assert "07.png" in second.statement


def test_what_was_seen_amiss_is_said(calibration, diagnostics):
    notes = "a second board is in view in 02.png: cover one of them", "the stripe runs up and down: set columns = false"
    noted = replace(calibration, notes=notes)
    assert "care: A second board is in view in 02.png" in words(noted, diagnostics)
    assert "stop: The stripe runs up and down" in words(noted, diagnostics)


def held(monkeypatch, k2: float):
    """Drawn with k1 and this k2, solved with the lens radial2 whose k2 is held at 0."""
    K, k, zero = np.array([[700.0, 0, 319.5], [0, 700.0, 239.5], [0, 0, 1]]), np.array([-0.25, k2, 0, 0]), np.zeros(3)
    monkeypatch.setattr(
        synthetic, "project", lambda X: cv2.projectPoints(X.reshape(-1, 1, 3), zero, zero, K, k)[0].reshape(-1, 2)
    )
    seen = synthetic.observations(seed=3, n_stage=0, laser=False)
    result = calibrate(seen, lens="radial2", hold=["camera.radial.1"])
    return result, diagnose(result, thorough=False)


def test_a_held_term_that_is_missing_is_to_be_freed(monkeypatch, diagnostics):
    """A richer lens would explain nearly as much, by another term."""
    result, found = held(monkeypatch, 0.9)
    # The ladder, on whose rungs it stays held, does not say otherwise.
    for each in (found, replace(found, ladder=better(replace(diagnostics.ladder, chosen="radial2"), "radial3"))):
        said = words(result, each)
        assert re.search(
            r"care: The lens model does not fit with camera.radial.1 held: free, it would explain 1\d %", said
        )
        assert "Free camera.radial.1: take it out of --hold and of hold under [camera]" in said
        assert "Free camera.radial.1, held here, or try a richer lens" in said
        assert "radial3" not in said


def test_a_held_term_that_explains_nothing_is_left_alone(monkeypatch, diagnostics):
    result, found = held(monkeypatch, 0.0)
    assert "The lens" not in words(result, found)
    simpler = words(result, replace(found, ladder=replace(diagnostics.ladder, chosen="radial2")))
    assert 'Set lens = "radial1" under [camera] in session.toml and take camera.radial.1 out of hold' in simpler


SHAPE = StageShape(
    axis="stage",
    taken="linear",
    kind="screw_on_guide",
    p=1e-9,
    travel_mm=60.0,
    bow_mm=0.1,
    bow_sigma_mm=0.01,
    turn_mrad=13.0,
    turn_sigma_mrad=0.4,
    wave_mm=0.05,
    wave_sigma_mm=0.002,
    period_steps=5333.0,
    aliases=(3200.0, 1455.0, 1231.0, 889.0),
)


def test_a_stage_that_is_no_line_is_said_once(calibration, diagnostics):
    off = diagnostics.stages[0]
    off = replace(off, error_mm=off.error_mm + 20 * off.sigma_mm)
    diagnostics = replace(diagnostics, stages=(off,))
    assert "The stage is not straight" in words(calibration, diagnostics)
    said = words(
        replace(calibration, stage_shapes=(SHAPE,), undetermined_periods=("Its period is a guess",)), diagnostics
    )
    assert "The stage is not straight" not in said
    assert "bowed by 0.1 ± 0.01 mm over 60 mm" in said
    assert "turns its load by 13 ± 0.4 mrad" in said
    assert "from those of 3200, 1455, 1231 and 1 more steps" in said
    assert "Calibrate with --motion screw_on_guide." in said
    assert "Its period is a guess." in said
