"""How alike neighbours are: white noise is not, smoothed noise as much as it was smoothed."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxscan.measurement.alike import INDEPENDENT, how_alike

GRID = np.argwhere(np.ones((120, 150), bool))


def of(noise):
    return how_alike([(GRID, noise.ravel(), 0)])


def test_white_noise_is_independent():
    alike = of(np.random.default_rng(0).normal(size=(120, 150)))
    assert alike.tau() == pytest.approx(1.0, abs=0.15)


def test_smooth_noise_is_worth_fewer_and_variances_follow():
    """τ of noise smoothed by a normal kernel of σ is 2 √π σ along each axis; variances are those of many drawings."""
    random = np.random.default_rng(1)
    weights = np.stack([np.ones(len(GRID)), np.cos(GRID[:, 1] / 6)])
    sums, alike = [], []
    for _ in range(60):
        noise = gaussian_filter(random.normal(size=(120, 150)), (1.0, 2.0), mode="wrap")
        noise /= noise.std()
        sums.append(weights @ noise.ravel())
        alike.append(of(noise))
    assert np.median([each.tau() for each in alike]) == pytest.approx(4 * np.pi * 2.0, rel=0.15)
    predicted = np.mean([np.diag(each.variance(GRID, weights)) for each in alike], axis=0)
    # Waves as short as the grain average out: weights that change have less.
    np.testing.assert_allclose(predicted[1], np.var(sums, axis=0)[1], rtol=0.5)
    assert predicted[1] < 0.45 * predicted[0]


def test_without_places_errors_are_independent():
    weights = np.ones((1, 10))
    assert INDEPENDENT.variance(None, weights)[0, 0] == 10
    assert how_alike([]).tau() == 1
