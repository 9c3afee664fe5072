"""The lens ladder: the F-test is SciPy's, too simple a lens is pointed out, too rich a one as well."""

import numpy as np
import pytest
from scipy import stats

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics.ladder import climb, f_test
from tests.calibration import synthetic


def test_f_test_is_scipys():
    F = ((120.0 - 100.0) / 2) / (100.0 / 90)
    assert f_test(120.0, 100.0, 2, 90.0) == pytest.approx(stats.f.sf(F, 2, 90), rel=1e-9)
    assert f_test(100.0, 100.0, 2, 90.0) == 1.0
    assert f_test(100.0, np.nan, 2, 90.0) == 1.0


def test_the_true_lens_is_supported_and_no_richer_one(calibration):
    tried = climb(calibration)
    assert tried.chosen == tried.supported == "radial1"
    by_name = {rung.lens: rung for rung in tried.rungs}
    assert [r.supported for r in tried.rungs] == [True, True, False, False, False, False]
    # By corners alone, so not the joint fit's, but the same noise.
    assert by_name["radial1"].rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.08)
    assert by_name["none"].held_out_px > 2 * by_name["radial1"].held_out_px
    assert tried.held_out_of_views_px.shape == (11,)


def test_too_simple_a_lens_is_pointed_out(monkeypatch):
    """Drawn with k1 and k2, solved with k1."""
    import cv2

    K = np.array([[700.0, 0, 319.5], [0, 700.0, 239.5], [0, 0, 1]])
    k = np.array([-0.25, 0.9, 0, 0])
    zero = np.zeros(3)
    monkeypatch.setattr(
        synthetic, "project", lambda X: cv2.projectPoints(X.reshape(-1, 1, 3), zero, zero, K, k)[0].reshape(-1, 2)
    )
    result = calibrate(synthetic.observations(seed=3, n_stage=0, laser=False), lens="radial1")
    tried = climb(result)
    assert tried.chosen == "radial1"
    assert tried.supported == "radial2"
