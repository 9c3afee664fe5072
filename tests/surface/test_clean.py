"""Cleaning takes what was put there, says which rule took it, and moves nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import block, grid, seen

from jaxscan.errors import InputError
from jaxscan.reconstruction import RangeImage
from jaxscan.surface.clean import clean, patches
from jaxscan.surface.links import links


def with_points(image: RangeImage, places: np.ndarray, lift: float, strength: float) -> RangeImage:
    points, light = image.points.copy(), image.strength.copy()
    points[places] += np.float32([0, 0, -lift])
    light[places] = strength
    return replace(image, points=points, strength=light)


def test_a_good_surface_stays_as_it_is():
    x, y = grid()
    image = seen(0.2 * x + 0.02 * y**2, noise=0.02)
    cleaned = clean(image)
    assert cleaned.counts() == {"mixed": 0, "grazing": 0, "isolated": 0}
    np.testing.assert_array_equal(cleaned.image.points, image.points)


def test_mixed_points_at_a_depth_edge():
    image = block()
    mixed = np.zeros(image.valid.shape, bool)
    # The first column of the block, and a whole frame of it, half way down to the floor and half as bright.
    mixed[15:45, 30] = mixed[15, 30:91] = True
    cleaned = clean(with_points(image, mixed, -2.5, 120.0))
    assert (cleaned.removed[mixed] == 1).all()
    assert cleaned.counts()["mixed"] == mixed.sum()
    stayed = cleaned.removed == 0
    np.testing.assert_array_equal(cleaned.image.points[stayed], image.points[stayed])
    assert np.isnan(cleaned.image.points[mixed]).all()


def test_a_weak_point_within_a_surface_stays():
    image = block()
    weak = np.zeros(image.valid.shape, bool)
    weak[5, 5] = weak[30, 60] = True
    assert not clean(with_points(image, weak, 0.0, 60.0)).removed.any()


def test_glints_and_grazing_surfaces():
    image = block()
    glints = np.zeros(image.valid.shape, bool)
    glints[3, 10] = glints[8, 100] = glints[50:52, 8:10] = True
    cleaned = clean(with_points(image, glints, 40.0, 250.0))
    assert (cleaned.removed[glints] == 3).all()
    assert cleaned.counts() == {"mixed": 0, "grazing": 0, "isolated": 6}
    x, _ = grid()
    for tilt, share in ((75.0, 0.0), (78.0, 1.0)):
        steep = clean(seen(np.tan(np.radians(tilt)) * x), grazing_deg=77.0).removed if share == 0 else None
        if steep is not None:
            assert not steep.any()
        else:
            with pytest.raises(InputError, match="cleaning left none of 7200 points"):
                clean(seen(np.tan(np.radians(tilt)) * x), grazing_deg=75.0)


def test_patches_are_what_hangs_together():
    image = block()
    label = patches(image, links(image))
    assert len(np.unique(label)) == 2
    x, y = grid()
    top = (np.abs(x) < 6) & (np.abs(y) < 6)
    assert len(np.unique(label[top])) == 1
    assert (patches(image.where(~top), links(image.where(~top)))[top] == -1).all()
