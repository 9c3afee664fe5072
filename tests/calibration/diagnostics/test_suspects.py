"""A photograph that does not belong is named, and what was done to it where that can be told."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics.suspects import mirror, suspects
from tests.calibration.diagnostics import cases


def test_nothing_is_suspected_without_reason(calibration):
    assert suspects(calibration) == ()


def test_a_photograph_of_another_camera(session, monkeypatch):
    (found,) = suspects(calibrate(cases.of_another_camera(session, 4, monkeypatch)))
    assert found.name == "view-4"
    assert found.corners_rejected > 0.9
    assert found.explanation is None


@pytest.mark.parametrize(
    ("left_to_right", "words"), [(True, "mirrored left to right"), (False, "mirrored top to bottom")]
)
def test_a_mirrored_photograph(session, left_to_right, words):
    (found,) = suspects(calibrate(cases.mirrored(session, 4, left_to_right)))
    assert found.name == "view-4"
    assert found.explanation == words


def test_a_turned_photograph_in_the_middle_of_the_stage(session, calibration):
    """It is in the middle, where the sequence's pose is; the others say how the board stood."""
    (stage,) = session.sequences
    views = list(stage.views)
    turned = np.array(session.image_size) - 1 - views[2].corners
    views[2] = replace(views[2], corners=turned)
    without = calibrate(replace(session, sequences=(replace(stage, views=tuple(views)),)))
    (found,) = suspects(without)
    assert found.name == views[2].name
    assert found.staged
    assert found.corners_rejected == 1
    sigma = without.covariance.sigma("motion.stage.per_step.1")
    assert (
        abs(float(without.rig.axis("stage").per_step[1]) - float(calibration.rig.axis("stage").per_step[1])) < 3 * sigma
    )


def test_mirroring_twice_is_nothing(session):
    view, size = session.views[3], session.image_size
    again = mirror(mirror(view, session.board, size, u=True, v=False), session.board, size, u=True, v=False)
    assert abs(again.corners - view.corners).max() < 1e-9
