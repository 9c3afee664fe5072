"""Units of clouds: said, or pointed out; never converted in silence."""

import warnings

import numpy as np
import pytest

from jaxscan.files.cloud import Cloud
from jaxscan.files.units import UnitsWarning, cloud_in_millimetres, in_millimetres

POINTS = np.random.default_rng(0).uniform(size=(50, 3)).astype(np.float32) * [0.16, 0.15, 0.12]


def test_what_is_as_small_as_a_bunny_in_metres_is_pointed_out_and_stays():
    with pytest.warns(UnitsWarning, match=r"bun\.ply: is 0\.2\d* mm across, taken for millimetres.* say --units m;"):
        assert in_millimetres("bun.ply", POINTS, None) is POINTS


def test_what_is_said_is_done_without_a_word():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(in_millimetres("bun.ply", POINTS, "mm"), POINTS)
        np.testing.assert_allclose(in_millimetres("bun.ply", POINTS, "m"), 1000 * POINTS)
        np.testing.assert_allclose(in_millimetres("bun.ply", 100 * POINTS, None), 100 * POINTS)
        assert in_millimetres("none.ply", POINTS[:0], None).shape == (0, 3)


def test_sigma_has_the_unit_of_the_points():
    points = POINTS.astype(np.float32)
    cloud = cloud_in_millimetres("a.ply", Cloud(points, sigma=points[:, 0], sigma_pixel=points[:, 1]), "inch")
    for found, given in ((cloud.points, points), (cloud.sigma, points[:, 0]), (cloud.sigma_pixel, points[:, 1])):
        assert found is not None
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, 25.4 * given, rtol=1e-6)
