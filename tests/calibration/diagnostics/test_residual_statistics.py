"""Statistics of residuals against NumPy and SciPy."""

import numpy as np
import pytest
from scipy import stats

from jaxscan.calibration.diagnostics import residual_statistics as statistics
from jaxscan.calibration.diagnostics.residual_statistics import CornerResiduals


def test_normality_is_scipys():
    scaled = np.random.default_rng(0).standard_t(5, 4000) + 0.1
    found = statistics.normality(scaled)
    assert found.skewness == pytest.approx(stats.skew(scaled))
    assert found.excess_kurtosis == pytest.approx(stats.kurtosis(scaled))
    assert found.beyond_2 == np.count_nonzero(np.abs(scaled) > 2) / 4000
    assert found.sigma == pytest.approx(np.sqrt(scaled @ scaled / 4000))
    inside = np.count_nonzero(np.abs(scaled) < 4.5) / 4000
    assert found.density @ np.diff(found.edges) == pytest.approx(inside)


def test_a_radial_error_is_seen_by_radius_and_not_over_the_image_alone():
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [640, 480], (3000, 2))
    centre = np.array([310.0, 240.0])
    out = (pixels - centre) / np.linalg.norm(pixels - centre, axis=1, keepdims=True)
    errors = 0.05 * rng.normal(size=(3000, 2)) + 0.04 * out
    found = statistics.by_radius(CornerResiduals(pixels, errors, np.full(3000, 0.05)), centre)
    assert np.abs(found.radial_px - 0.04).max() < 4 * found.radial_error_px.max()
    assert (np.diff(found.radius_px) > 0).all()
    # One bin by hand.
    radius = np.linalg.norm(pixels - centre, axis=1)
    nearest = np.argsort(radius)[: 3000 // 8]
    assert found.rms_px[0] == pytest.approx(np.sqrt((errors[nearest] ** 2).sum(axis=1).mean()))


def test_means_over_the_image():
    pixels = np.array([[10.0, 10.0]] * 6 + [[630.0, 470.0]] * 3)
    errors = np.arange(18.0).reshape(9, 2)
    found = statistics.over_image(CornerResiduals(pixels, errors, np.ones(9)), (640, 480))
    np.testing.assert_allclose(found.mean_px[0, 0], errors[:6].mean(axis=0))
    np.testing.assert_allclose(found.error_px[0, 0], errors[:6].std(axis=0, ddof=1) / np.sqrt(6))
    assert found.count[5, 7] == 3
    assert np.isnan(found.mean_px[5, 7]).all()


@pytest.mark.parametrize(("alike", "left"), [(0.4, True), (0.0, False)])
def test_corners_that_are_off_alike_in_all_photographs_are_a_field(alike, left):
    random = np.random.default_rng(0)
    pixels = random.uniform([0, 0], [640, 480], (3000, 2))
    errors = alike * np.cos(pixels / 60) + 0.3 * random.normal(size=(3000, 2))
    found = statistics.over_image(CornerResiduals(pixels, errors, np.ones(3000)), (640, 480))
    assert found.left_out(0.3) is left
    assert (found.share_off(0.3) > 0.3) is left


def test_photographs_are_the_fits_the_worst_first(calibration):
    found = statistics.photographs(calibration)
    assert len(found) == 16
    assert [p.corner_rms_px for p in found] == sorted((p.corner_rms_px for p in found), reverse=True)
    worst = next(fit for fit in (*calibration.fits, *calibration.moved_fits) if fit.name == found[0].name)
    distance = np.linalg.norm(worst.corner_errors[worst.corner_kept], axis=1)
    assert found[0].corner_rms_px == pytest.approx(np.sqrt((distance**2).mean()))


def test_drawn_noise_looks_normal(calibration):
    residuals = statistics.corner_residuals(calibration)
    for found in (statistics.corner_normality(residuals), statistics.stripe_normality(calibration.fits)):
        assert found is not None
        assert found.sigma == pytest.approx(1, abs=0.06)
        assert abs(found.skewness) < 4 * np.sqrt(6 / found.count)
        assert abs(found.excess_kurtosis) < 4 * np.sqrt(24 / found.count)
