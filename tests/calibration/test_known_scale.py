"""A known step of the stage is a second scale: a wrong size of the squares is said, a right one is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxscan.calibration import Calibration
from jaxscan.calibration.known_scale import scale_note
from jaxscan.files.session import Session, Views
from jaxscan.files.session_axes import StageImages
from jaxscan.images import Board
from jaxscan.view.verdict import verdict


def session(mm_per_step: float | None, square_mm: float = 16.0) -> Session:
    stage = StageImages((), (), mm_per_step=mm_per_step)
    return Session(Path("session.toml"), Board.checkerboard((9, 6), square_mm), Views(()), stage=stage)


def step(calibration: Calibration) -> float:
    return float(np.linalg.norm([float(x) for x in calibration.rig.axis("stage").per_step]))


def test_a_wrong_square_is_said_with_both_scales_and_with_the_size_that_would_do(calibration: Calibration) -> None:
    true = step(calibration)
    note = scale_note(calibration, [session(0.64 * true, 25.0)])
    assert note is not None
    assert f"{true:.4g} mm" in note
    assert f"mm_per_step = {0.64 * true:g}" in note
    assert "square_mm = 16 in place of 25" in note
    judged = verdict(replace(calibration, notes=(note,)))
    assert any("mm_per_step" in box.statement for box in judged.warnings)
    assert judged.level != "good"


@pytest.mark.parametrize("share", [1.0, 1.005, 0.995])
def test_what_agrees_is_not_spoken_of(calibration: Calibration, share: float) -> None:
    assert scale_note(calibration, [session(share * step(calibration))]) is None
    assert scale_note(calibration, [session(None)]) is None
