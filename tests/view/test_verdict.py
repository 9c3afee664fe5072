"""The verdict that ends every calibration: it speaks up where something is wrong, and not of a good session."""

import re
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.calibration.diagnostics import diagnose
from jaxscan.calibration.observations import BoardSequence
from jaxscan.rig import Rig
from jaxscan.rig.rig import parameter_names
from jaxscan.view.advice import Advice
from jaxscan.view.report import Report
from jaxscan.view.verdict import judge, verdict
from tests.calibration import synthetic
from tests.calibration.synthetic import BOARD, IMAGE_SIZE, K1, Noise


def pose_in_view(rng: np.random.Generator, tilt: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """A board anywhere in the image, with a long stripe on it."""
    while True:
        R = cv2.Rodrigues(np.array([*rng.uniform(-tilt, tilt, 2), rng.uniform(-0.2, 0.2)]))[0]
        middle = np.array([rng.uniform(-75, 75), rng.uniform(-55, 55), rng.uniform(280, 400)])
        t = middle - R @ BOARD.points().mean(axis=0)
        seen = synthetic.project(BOARD.points() @ R.T + t)
        within = (seen > 5).all() and (seen < np.array(IMAGE_SIZE) - 6).all()
        if within and np.isfinite(synthetic.stripe_on(R, t, True)[:, 1]).sum() > 100:
            return R, t


@pytest.fixture
def draw(monkeypatch: pytest.MonkeyPatch):
    """A session of eleven views all over the image and nine stage photographs; tilt and lens can be others."""

    def drawn(seed: int, tilt: float = 0.6, k2: float = 0.0, **how) -> Observations:
        def project(X: np.ndarray) -> np.ndarray:
            (fu, fv), (u0, v0) = synthetic.FOCAL, synthetic.PRINCIPAL
            K, lens = np.array([[fu, 0, u0], [0, fv, v0], [0, 0, 1.0]]), np.array([K1, k2, 0, 0])
            return cv2.projectPoints(X.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, lens)[0].reshape(-1, 2)

        with monkeypatch.context() as patch:
            patch.setattr(synthetic, "board_pose", lambda rng: pose_in_view(rng, tilt))
            patch.setattr(synthetic, "project", project)
            return synthetic.observations(seed=seed, n_stage=9, **how)

    return drawn


def three_boards(session: Observations) -> Observations:
    return replace(session, views=session.views[:3])


def mixed_up(session: Observations, order: Sequence[int] = (0, 8, 1, 2, 3, 4, 5, 6, 7)) -> Observations:
    """The stage's photographs in an order that names 0, 1, 10, 11, … would have."""
    (stage,) = session.sequences
    return replace(session, sequences=(replace(stage, views=tuple(stage.views[i] for i in order)),))


def counted(stage: BoardSequence, more: np.ndarray) -> BoardSequence:
    """The same photographs, other step counts."""
    return replace(stage, positions={**stage.positions, "stage": stage.steps + more})


def one_wrong_count(session: Observations) -> Observations:
    """One step count is 300 too many."""
    (stage,) = session.sequences
    return replace(session, sequences=(counted(stage, 300 * (np.arange(9) == 4)),))


def every_other_farther(session: Observations) -> Observations:
    """Every other place is 60 steps farther on than its count says."""
    (stage,) = session.sequences
    return replace(session, sequences=(counted(stage, 60 * (np.arange(9) % 2)),))


def as_it_is(session: Observations) -> Observations:
    return session


@pytest.mark.parametrize(
    ("how", "change", "lens", "level", "words", "next_words"),
    [
        ({"k2": 0.2}, as_it_is, "radial1", "care", 'kind "radial2" would explain', "More views"),
        ({}, as_it_is, "none", "stop", 'kind "radial1" would explain', 'Set lens = "radial1"'),
        ({}, three_boards, "radial1", "care", "too few photographs to solve two halves", "Hold the board"),
        ({"tilt": 0.12}, as_it_is, "radial1", "care", "nearly parallel", "Tilt the board by 30°"),
        (
            {"noise": Noise(0.05, 3.0)},
            as_it_is,
            "radial1",
            "care",
            "scatter by 3.0 px",
            "Another photograph of the board hardly helps",
        ),
        ({"noise": Noise(0.05, 6.0)}, as_it_is, "radial1", "stop", "scatter by [56].. px", "First correct"),
        ({}, mixed_up, "radial1", "stop", "do not fit their step counts", "correct images or steps"),
    ],
    ids=["lens", "no lens", "three boards", "parallel", "3 px", "6 px", "mixed up"],
)
def test_what_is_wrong_is_said_without_the_report(draw, how, change, lens, level, words, next_words):
    found = verdict(calibrate(change(draw(0, **how)), lens=lens))
    said = " ".join(box.statement for box in found.warnings)
    assert found.level == level, said
    assert re.search(words, said)
    assert next_words in found.next
    assert found.limits
    assert found.statement.startswith({"care": "Usable, with care.", "stop": "Do not use"}[level])
    assert not found.thorough


def test_with_the_report_and_without_it_the_same_is_asked_for(draw):
    """What the photographs do not cover comes first in both, also where no board would lower a point's σ."""
    calibration = calibrate(three_boards(draw(0)), lens="radial1")
    quick, advice = diagnose(calibration, thorough=False), Advice(("another photograph of the board hardly helps",))
    said = [judge(calibration, one, (), advice).next for one in (quick, replace(quick, thorough=True))]
    assert said[0].startswith("Hold the board")
    assert (
        said[1]
        == f"{said[0]} For the part of the image where it has been, another photograph of the board hardly helps."
    )


def test_mixed_up_photographs_have_one_message(draw):
    found = verdict(calibrate(mixed_up(draw(1))))
    assert [box.level for box in found.warnings] == ["stop"]
    assert "step counts" in found.warnings[0].statement
    assert found.warnings[0].statement.endswith("if stage-8 were last.")


@pytest.mark.parametrize(
    ("change", "said"), [(one_wrong_count, ["stage-4 does not fit"]), (every_other_farther, ["steps are uneven"])]
)
def test_a_wrong_step_count_has_one_message(draw, change, said):
    found = [box.statement for box in verdict(calibrate(change(draw(1)))).warnings]
    about = [each for each in found if "stage" in each]
    assert len(about) == len(said), found
    assert all(words in each for words, each in zip(said, about, strict=True)), found


def test_of_a_shuffle_the_order_is_said(draw):
    found = verdict(calibrate(mixed_up(draw(1), [4, 0, 8, 3, 7, 1, 6, 2, 5]), lens="radial1"))
    assert "in the order stage-0, stage-1, stage-2" in found.warnings[0].statement
    assert [box.level for box in found.warnings] == ["stop"], found.warnings


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, 26), marks=pytest.mark.long)])
def test_good_sessions_are_not_warned_of(draw, seeds: range):
    """Prints how many are: none of these, and a wrong alarm in a hundred would be as much as can be stood."""
    warned = [seed for seed in seeds if verdict(calibrate(draw(seed))).warnings]
    print(f"{len(warned)} of {len(seeds)} good sessions were warned of")
    assert warned == []


def test_a_rig_without_a_laser_has_a_verdict_too(draw):
    session = draw(2, laser=False)
    found = verdict(calibrate(replace(session, sequences=())))
    assert found.level == "good"
    assert "The focal length is" in found.statement
    assert "Corners" in found.limits


def test_a_held_camera_is_said_to_be_held(draw):
    session = replace(draw(2, laser=False), sequences=())
    camera = calibrate(session).rig.camera
    held = calibrate(session, start=camera, hold=parameter_names(Rig(camera)))
    found = verdict(held)
    assert "is held at" in found.statement
    # No photograph makes a lens better that was given.
    assert not [box for box in found.warnings if "the lens is a guess" in box.statement or "parallel" in box.statement]


def test_the_report_begins_with_the_same_judgement(calibration: Calibration, report: Report):
    """Report and verdict use the same words for what both look at: one function makes them."""
    quick = verdict(calibration)
    assert report.verdict.statement == quick.statement
    assert report.verdict.level == quick.level
    assert set(quick.warnings) <= set(report.sections[0].boxes)
    assert report.sections[1].paragraphs[0] == quick.limits
