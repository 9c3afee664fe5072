"""The shape of a stripe: straight with noise, and bent."""

import numpy as np
import pytest

from jaxscan.calibration.diagnostics.stripe_shapes import shape, stripe_shapes


def test_noise_has_the_bend_that_noise_has():
    rng = np.random.default_rng(0)
    along = np.arange(100.0, 500.0)
    bends = []
    for _ in range(50):
        found = shape("a", "", along, 0.3 + 0.02 * rng.normal(size=400), 300.0)
        bends.append(found.bend_mm / found.bend_of_noise_mm)
        assert found.offset_mm == pytest.approx(0.3, abs=5 * found.offset_error_mm)
    # A running mean is not ten independent numbers, but within a third of their range.
    assert 0.67 < np.mean(bends) < 1.5


def test_a_bow_is_measured_from_peak_to_valley():
    along = np.random.default_rng(1).permutation(np.arange(400.0))
    t = 2 * along / 399 - 1
    found = shape("a", "", along, 0.1 + 0.05 * t - 0.4 * t**2, 300.0)
    assert found.tilt_mm == pytest.approx(0.05, abs=1e-3)
    # The mean of 0.4 t² is 0.4 / 3; about it a parabola has an RMS of √(4/45) of its height.
    assert found.beside_mm == pytest.approx(np.hypot(0.1 - 0.4 / 3, 0.05 / np.sqrt(3)), abs=1e-3)
    assert found.crooked_mm == pytest.approx(0.4 * np.sqrt(4 / 45), rel=0.05)
    # The running mean is read where its window is whole: t from −0.9 to 0.9.
    assert found.bend_mm == pytest.approx(0.4 * 0.9**2, rel=0.03)
    assert (np.diff(found.along_px) > 0).all()


def test_distances_are_those_of_the_residuals(calibration):
    shapes = stripe_shapes(calibration)
    assert len(shapes) == len(calibration.fits)
    # The noise in mm from the plane, board by board: about 0.1 px times depth over focal length.
    for found in shapes:
        assert found.noise_mm == pytest.approx(0.1 * 345 / 690, rel=0.5)
        assert found.bend_mm < 3 * found.bend_of_noise_mm
