"""A board that started in the wrong place is found again once the camera is known."""

import numpy as np
import pytest

from benchmarks.starts import HARDSHIPS, LENS, session
from jaxscan import calibrate
from jaxscan.rig import Camera


@pytest.mark.parametrize(
    ("hardship", "seed", "factor"),
    [("plain", 0, 0.3), pytest.param("astray", 3, None, marks=pytest.mark.long), ("strangers", 5, None)],
)
def test_no_board_stays_where_it_started_wrong(hardship, seed, factor):
    drawn = HARDSHIPS[hardship]
    observations = session(drawn, seed)
    given = factor and Camera.create((640, 480), factor * np.asarray(drawn.focal), (319.5, 239.5), LENS)
    found = calibrate(observations, lens=LENS, start=given or None)
    sigma = np.sqrt(found.covariance.matrix[0, 0])
    assert abs(float(found.rig.camera.focal[0]) - drawn.focal[0]) < 4 * sigma < 0.03 * drawn.focal[0]
    used = [view.used().sum() for view in observations.views]
    share = np.array([kept.corners.sum() for kept in found.kept]) / used
    belongs = np.arange(len(share)) >= drawn.strangers
    assert (share[belongs] > 0.9 * (1 - drawn.astray) - 0.15).all()
    assert found.corner_sigma_px == pytest.approx(drawn.noise, rel=0.35)
