"""What photographs cover, and the words that follow from it where something stays open."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.coverage import AxisCoverage, Coverage, StripeCoverage, measure_coverage
from jaxscan.calibration.observability import OpenQuestion, cause_and_fix
from jaxscan.errors import ObservabilityError
from tests.calibration import synthetic


@pytest.fixture
def coverage(calibration):
    return measure_coverage(calibration.observations, calibration.rig, calibration.photograph_poses())


def test_numbers_are_those_of_the_poses_drawn(coverage, session):
    rng = np.random.default_rng(0)
    tilts, distances = [], []
    for view in session.views:
        R, t = synthetic.board_pose(rng)
        rng.normal(size=view.corners.shape)
        rng.normal(size=len(view.stripes[0].pixels))
        tilts.append(np.degrees(np.arccos(R[2, 2])))
        distances.append(np.linalg.norm(R @ synthetic.BOARD.points().mean(axis=0) + t))
    np.testing.assert_allclose(coverage.tilts_deg, tilts, atol=0.5)
    np.testing.assert_allclose(coverage.distances_mm, distances, rtol=3e-3)
    assert coverage.corners_in_cells.sum() == 11 * 54
    assert coverage.axes["stage"].photographs == 5
    assert coverage.axes["stage"].way == pytest.approx(8.0, rel=5e-3)
    (stripe,) = coverage.stripes
    assert stripe.views == 11
    assert 270 < stripe.depths_mm[0] < stripe.depths_mm[1] < 420


EMPTY = np.zeros(0)
COVERAGE = Coverage(
    tilts_deg=np.zeros(1),
    normals=np.zeros((1, 3)),
    tilt_spread_deg=4.0,
    distances_mm=np.zeros(1),
    corners_in_cells=np.zeros((6, 8), int),
    image_share=0.3,
    reach=0.4,
    stripes=(StripeCoverage("", 2, 300, (340.0, 341.0), 2.5, 180.0),),
    axes={"stage": AxisCoverage(3, 0.25, "mm"), "turntable": AxisCoverage(4, 6.5, "degrees")},
)


@pytest.mark.parametrize(
    ("name", "spread", "words"),
    [
        ("camera.focal.0", 4.0, "normals lie within 4.0°.*Tilt the board by 30°"),
        ("camera.radial.1", 40.0, "30 % of the image and reach 40 %.*lens with fewer terms"),
        ("camera.division.0", 40.0, "30 % of the image and reach 40 %.*lens with fewer terms"),
        ("camera.principal.0", 40.0, "within 40°.*Tilt the board"),
        ("lights.0.plane.0", 40.0, "2 views lie between 340.0 and 341.0 mm.*spread by 2.5 mm.*distances"),
        ("motion.stage.per_step.1", 40.0, "moved the board by 0.25 mm over 3 photographs.*whole travel"),
        ("motion.turntable.centre.0", 40.0, "by 6.50 degrees over 4 photographs.*30° and more"),
    ],
)
def test_cause_and_mend_come_from_the_session(name, spread, words):
    import re

    text = cause_and_fix(OpenQuestion("", (name,)), replace(COVERAGE, tilt_spread_deg=spread), 0.1)
    assert re.search(words, text)


def test_a_turn_that_is_wide_enough_is_not_asked_to_be_wider():
    """A board that was turned by half a turn between two photographs: "331.71 degrees … Turn it by 30° and more"."""
    axes = {**COVERAGE.axes, "turntable": replace(COVERAGE.axes["turntable"], way=331.71)}
    text = cause_and_fix(OpenQuestion("", ("motion.turntable.centre.0",)), replace(COVERAGE, axes=axes), 0.1)
    assert (
        "moved the board by 331.71 degrees over 4 photographs. That is enough, so these photographs are not of" in text
    )
    assert "30°" not in text


@pytest.mark.parametrize("name", ["camera.focal.0", "camera.radial.1", "camera.tilt.0"])
def test_corners_that_contradict_the_model_are_not_laid_on_the_poses(name):
    """A board bent by 10 mm once got the advice to tilt it by 30° or more."""
    question, coverage = OpenQuestion("", (name,)), replace(COVERAGE, tilt_spread_deg=70.0)
    text = cause_and_fix(question, coverage, 1.7)
    assert text.startswith("corners fit to 1.7 px, where a tenth of a pixel is usual")
    assert "See whether the board is flat" in text
    # Neither is a light, whose stripes are its own.
    assert "Hold the board at distances" in cause_and_fix(OpenQuestion("", ("lights.0.plane.0",)), coverage, 1.7)


def test_a_stage_that_hardly_moves_is_refused_in_words():
    with pytest.raises(ObservabilityError, match=r"the motion of the stage is not determined.*moved the board by 0\.0"):
        calibrate(synthetic.observations(seed=0, n_stage=5, step=4))
