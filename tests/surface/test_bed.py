"""A bed's own scan as the floor."""

import numpy as np
import pytest
from scenes import grid, seen

from jaxscan.surface.bed import floor_from_scan
from jaxscan.surface.floor import find_floor, stands_on


def bowl(x, y):
    """A bed that is bent by 1.2 mm."""
    return 0.005 * x**2 + 0.2 * np.sin(y / 3)


def test_heights_are_over_the_bed_and_not_over_its_plane():
    x, y = grid()
    floor = floor_from_scan(seen(bowl(x, y), 0.02, seed=1))
    thin = (np.abs(x) < 6) & (np.abs(y) < 6)
    image = seen(bowl(x, y) + np.where(thin, 0.3, 0.0), 0.02, seed=2)
    assert floor.sigma_mm == pytest.approx(0.02, rel=0.15)
    height = floor.height(image.points)
    # Heights are at right angles to a plane that is itself a little tilted.
    np.testing.assert_allclose(height[thin].mean(), 0.3, atol=0.004)
    np.testing.assert_allclose(height[~thin].mean(), 0.0, atol=0.002)
    assert height[~thin].std() == pytest.approx(0.021, rel=0.1)
    np.testing.assert_array_equal(stands_on(image, floor)[thin], True)
    assert stands_on(image, floor)[~thin].mean() < 0.002
    # The plane does not tell it from the bed.
    plane = find_floor(seen(bowl(x, y), 0.02, seed=1))
    assert plane.height(image.points)[~thin].std() > 0.1


def test_the_frame_is_the_beds_own():
    # Tilted by 10 degrees against the camera, and a step in it along the travel.
    x, y = grid()
    bed = 0.18 * x + np.where(y > 0, 0.5, 0.0)
    floor = floor_from_scan(seen(bed, 0.01, seed=1))
    image = seen(bed + 2.0, 0.01, seed=2)
    inner = np.abs(y) > 1
    np.testing.assert_allclose(np.median(floor.height(image.points)[inner]), 2 * np.cos(np.arctan(0.18)), atol=0.01)
    assert floor.height(image.points)[inner].std() < 0.02


def test_beside_the_bed_no_height_is_known_and_its_plane_says_what_stands_there():
    x, y = grid()
    bare = seen(np.where(np.abs(x) < 8, 0.0, np.nan), 0.01, seed=1)
    floor = floor_from_scan(bare)
    image = seen(np.where((np.abs(x - 9) < 2) & (np.abs(y) < 6), 4.0, 0.0), 0.01, seed=2)
    height = floor.height(image.points)
    assert np.isnan(height[np.abs(x) > 8 + floor.reach_mm + 0.2]).all()
    assert np.isfinite(height[np.abs(x) < 8]).all()
    np.testing.assert_array_equal(stands_on(image, floor), (np.abs(x - 9) < 2) & (np.abs(y) < 6))
    assert np.isnan(floor.height(np.full((2, 3), np.nan))).all()
