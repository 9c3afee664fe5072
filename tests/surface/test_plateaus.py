"""Plateaus found without being pointed at."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import ball, grid, seen

from jaxscan.errors import InputError
from jaxscan.surface.bed import floor_from_scan
from jaxscan.surface.floor import find_floor
from jaxscan.surface.plateaus import plateaus

HEIGHTS = (2.0, 4.5, 5.0)


def steps(x, y, tilt=0.0):
    """Three steps side by side, 8 mm wide and 16 mm deep, on a floor of 40 × 24 mm."""
    level = np.select([x < -4, x < 4], HEIGHTS[:2], HEIGHTS[2]) + tilt * x
    return np.where((np.abs(x) < 12) & (np.abs(y) < 8), level, 0.0)


@pytest.fixture(scope="module")
def plane():
    return grid(60, 200)


def of(surface, noise, seed=0, least_mm2=20.0):
    image = seen(surface, noise, seed=seed)
    return plateaus(image, find_floor(image), least_mm2)


@pytest.mark.parametrize("noise", [0.005, 0.02, 0.06])
def test_steps_have_their_heights_within_the_interval(plane, noise):
    off, inside, count = [], 0, 0
    for seed in range(6):
        found = sorted(of(steps(*plane), noise, seed), key=lambda one: one.height_mm)
        assert len(found) == 3
        for one, height in zip(found, HEIGHTS, strict=True):
            assert one.spread_mm == pytest.approx(noise, rel=0.1)
            assert 70 < one.area_mm2 < 130
            assert one.points == pytest.approx(one.area_mm2 / 0.08, rel=0.05)
            assert one.tilt_deg < 0.2
            off.append((one.height_mm - height) / one.sigma_mm)
            inside += abs(one.height_mm - height) <= one.interval_mm
            count += 1
        np.testing.assert_allclose([one.centre[0] for one in found], [-8.0, 0.0, 8.0], atol=0.6)
    assert inside >= count - 3
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_the_largest_is_first_and_small_ones_do_not_count(plane):
    x, y = plane
    surface = np.where((np.abs(x + 8) < 6) & (np.abs(y) < 8), 3.0, 0.0)
    surface = np.where((np.abs(x - 10) < 2.5) & (np.abs(y) < 2.5), 6.0, surface)
    found = of(surface, 0.01, least_mm2=5.0)
    assert [round(one.height_mm) for one in found] == [3, 6]
    assert [round(one.height_mm) for one in of(surface, 0.01, least_mm2=50.0)] == [3]


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.02, 0.06])
def test_slopes_have_none(plane, noise):
    x, y = plane
    for degrees in (2.5, 5.0, 20.0, 40.0):
        wedge = np.where((np.abs(x) < 10) & (np.abs(y) < 7), 3 + np.tan(np.radians(degrees)) * (x + 10), 0.0)
        assert of(wedge, noise) == ()
    roof = np.where((np.abs(x) < 10) & (np.abs(y) < 7), 9 - 0.3 * np.abs(x), 0.0)
    assert of(roof, noise) == ()


@pytest.mark.parametrize("noise", [0.01, 0.06])
def test_the_top_of_a_pyramid_is_one_and_its_faces_are_none(plane, noise):
    x, y = plane
    pyramid = np.clip(12 - np.maximum(np.abs(x), np.abs(y)), 0.0, 6.0)
    (top,) = of(pyramid, noise)
    assert abs(top.height_mm - 6.0) <= max(top.interval_mm, 0.02)
    np.testing.assert_allclose(top.centre[[0, 2]], [0.0, 294.0], atol=0.3)


def test_a_ball_and_a_bare_floor_have_none(plane):
    image = ball(noise=0.02)
    assert plateaus(image, find_floor(image)) == ()
    for seed in range(4):
        assert of(np.zeros_like(plane[0]), 0.06, seed) == ()


def test_heights_are_over_a_bed_that_is_bent(plane):
    x, y = plane
    bed = 0.003 * x**2
    floor = floor_from_scan(seen(bed, 0.01, seed=1))
    image = seen(bed + steps(x, y), 0.01, seed=2)
    found = sorted(plateaus(image, floor), key=lambda one: one.height_mm)
    assert len(found) == 3
    for one, height in zip(found, HEIGHTS, strict=True):
        assert abs(one.height_mm - height) < 0.01
        assert one.sigma_mm < 0.005


def test_a_scan_beside_the_scanned_bed_has_no_heights(plane):
    image = seen(steps(*plane), 0.01)
    bed = seen(np.zeros_like(plane[0]), 0.01, seed=1)
    floor = floor_from_scan(replace(bed, points=bed.points + np.float32([500, 0, 0])))
    with pytest.raises(InputError, match="no point lies over the scan of the bare stage"):
        plateaus(image, floor)


def test_an_area_that_is_none(plane):
    with pytest.raises(InputError, match="plateaus of 0 mm²"):
        of(steps(*plane), 0.01, least_mm2=0.0)
