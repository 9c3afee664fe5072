"""Errors of the stage: a board that stood off its line is found there, with the σ that the corners leave."""

from dataclasses import replace

import numpy as np

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics.stage_errors import stage_errors
from tests.calibration import synthetic

MISSED_MM = 0.1


def test_a_straight_stage_is_within_its_sigma(calibration):
    (found,) = stage_errors(calibration)
    assert found.error_mm.shape == (5, 3)
    # The line took some freedom of its own: less than the 15 numbers' χ², and no 99.9 % above.
    assert ((found.error_mm / found.sigma_mm) ** 2).sum() < 37.7
    assert ((found.rotation_mrad / found.rotation_sigma_mrad) ** 2).sum() < 37.7
    np.testing.assert_allclose(found.travel_mm, np.arange(5) * 2.0, rtol=5e-3)


def test_a_missed_step_is_measured(session):
    """Steps of 2 mm; in the third photograph of five the board stands 0.1 mm too far."""
    stage = session.sequences[0]
    direction = synthetic.PER_STEP / np.linalg.norm(synthetic.PER_STEP)
    # How far a corner moves follows from the neighbouring photographs, 2 mm before and after.
    before, here, after = (stage.views[i].corners for i in (1, 2, 3))
    moved = here + (after - before) / 4.0 * MISSED_MM
    views = list(stage.views)
    views[2] = replace(views[2], corners=moved)
    result = calibrate(replace(session, sequences=(replace(stage, views=tuple(views)),)))
    (found,) = stage_errors(result)
    off = found.error_mm[:, 0]
    # The line runs through five photographs at once, and takes a fifth of it.
    assert abs(off[2] - 0.8 * MISSED_MM) < 4 * found.sigma_mm[2, 0]
    assert np.argmax(np.abs(off)) == 2
    assert found.chi2_along > 4
    assert direction @ np.stack(result.rig.axis("stage").per_step) > 0
