"""How large errors are that several shapes show: none, their size, or the prior where noise hides them."""

import numpy as np
import pytest

from jaxscan.measurement.border import expected
from jaxscan.measurement.evidence import Shown, weights

SIZES = np.array([0.0, 0.0125, 0.025, 0.05, 0.1])


def shown(size, noise, shapes, seed=0):
    """What so many shapes show of errors of a size, one number each."""
    random = np.random.default_rng(seed)
    found = size * random.normal(size=shapes) + noise * random.normal(size=shapes)
    return [Shown(np.array([each]), np.array([[noise**2]])) for each in found]


@pytest.mark.parametrize("size", SIZES)
def test_the_true_size_is_the_likeliest(size):
    likely = weights(shown(size, 0.003, 400), SIZES)
    assert likely.sum() == pytest.approx(1)
    assert likely[size == SIZES] > 0.9


def test_without_evidence_the_prior_is_left():
    for each in ([], shown(0.0, 1e3, 5)):
        likely = weights(each, SIZES, 9.0)
        np.testing.assert_allclose(likely, [0.9, 0.025, 0.025, 0.025, 0.025], rtol=1e-3)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-12])
def test_numbers_of_one_shape_count_with_their_covariance(off):
    """Two numbers whose noise is the same one say as much as one of them, however they are rounded."""
    twice = Shown(np.array([0.05, 0.05 + off]), 0.01**2 * np.array([[1.0, 1.0], [1.0, 1.0]]))
    along = Shown(np.array([0.05, 0.05]) @ np.ones((2, 1)) / np.sqrt(2), np.array([[2 * 0.01**2]]))
    none = Shown(np.zeros(1), np.zeros((1, 1)))
    np.testing.assert_allclose(weights([twice], SIZES), weights([along, none], SIZES), atol=1e-6)


def test_a_border_is_off_by_what_it_shows_where_others_show_it_too():
    """Ten balls whose last columns are 0.08 px off, and one that is too small to show anything."""
    off, squares, blurred = expected([*shown(0.08, 0.01, 10), None, *shown(0.0, 10.0, 1)])
    found = [float(each.found[0]) for each in shown(0.08, 0.01, 10)]
    assert blurred > 0.999
    np.testing.assert_allclose(off[:10], found, rtol=0.1)
    np.testing.assert_allclose(squares[:10], np.square(found) + 0.01**2, rtol=0.15)
    np.testing.assert_allclose(off[10:], 0, atol=1e-4)
    np.testing.assert_allclose(np.sqrt(squares[10:]), 0.08, atol=0.03)


def test_a_sharp_scan_keeps_its_border_unless_it_is_off_by_chance():
    """The 300 scans have five shapes, and are as noisy as those of a drawn part."""
    blurred = [expected(shown(0.0, 0.04, 5, seed))[2] for seed in range(300)]
    assert np.median(blurred) < 0.1
    assert np.mean(np.array(blurred) > 0.5) < 0.02
