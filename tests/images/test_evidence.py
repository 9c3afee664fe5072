"""Edges of reflectance are told from speckle by their going on from line to line."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from jaxscan.images.stripes.evidence import edges_and_profiles, edges_go_on

FRAMES, LINES = 40, 800
SEEN = np.ones((FRAMES, LINES), bool)


def chance(seed, grain=0.0):
    """Coefficients that are noise alone, correlated over `grain` lines."""
    white = np.random.default_rng(seed).standard_normal((2, FRAMES, LINES))
    return gaussian_filter1d(white, grain, axis=2, mode="wrap") if grain else white


@pytest.mark.parametrize("grain", [0.0, 1.0, 2.0])
def test_chance_is_hardly_ever_taken_for_an_edge(grain):
    h3, h4 = chance(0, grain)
    assert edges_go_on(h3, h4, SEEN, SEEN).mean() < 0.01


def test_heavy_tails_are_hardly_ever_taken_for_an_edge():
    h3, h4 = np.random.default_rng(1).standard_t(4, (2, FRAMES, LINES))
    assert edges_go_on(h3, h4, SEEN, SEEN).mean() < 0.01


@pytest.mark.parametrize(("length", "share"), [(25, 0.85), (100, 0.98), (LINES, 0.98)])
@pytest.mark.parametrize("part", [0, 1])
def test_a_shape_that_goes_on_is_found_in_its_lines(length, share, part):
    h = chance(2)
    h[part, :, 300 : 300 + length] += 4.0
    found = edges_go_on(*h, SEEN, SEEN)
    assert found[:, 300 : 300 + length].mean() > share
    assert found[:, : 300 - 40].mean() < 0.01


def test_lines_without_a_stripe_are_not_read():
    h = chance(3)
    h[:, :, ::2] = np.nan
    seen = np.broadcast_to(np.arange(LINES) % 2 == 1, (FRAMES, LINES))
    found = edges_go_on(*h, seen, seen)
    assert not found[:, ::2].any()
    assert found.mean() < 0.01
    assert not edges_go_on(*h, np.zeros_like(seen), seen).any()


def test_what_is_the_same_all_along_the_stripe_is_its_profile():
    random = np.random.default_rng(2)
    noise = 0.02 * random.standard_normal((2, *SEEN.shape))
    # A flat-topped laser: the same h₄ in all lines; in a few of them there is an edge as well.
    flat = noise + np.array([0.0, -0.3])[:, None, None]
    edges, odd = edges_and_profiles(*flat, SEEN, SEEN)
    assert odd.all()
    assert edges.mean() < 0.01
    flat[0, :, 100:140] += 0.2
    edges, odd = edges_and_profiles(*flat, SEEN, SEEN)
    assert odd.all()
    assert edges[:, 104:136].all()
    assert edges[:, 160:].mean() < 0.02
    # An edge that goes from one side of the stripe to the other is no profile.
    crossing = noise + 0.3 * np.sin(np.linspace(0, 2 * np.pi, SEEN.shape[1])) * np.array([1.0, 0.5])[:, None, None]
    edges, odd = edges_and_profiles(*crossing, SEEN, SEEN)
    assert not odd.any()
    assert edges.mean() > 0.8
    np.testing.assert_array_equal(edges, edges_go_on(*crossing, SEEN, SEEN))
