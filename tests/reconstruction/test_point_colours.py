"""Colours of points: those of their own pixels, and none where something stands in front, or the stripe does."""

import numpy as np
import pytest

from jaxscan.geometry import Pose
from jaxscan.reconstruction.point_colours import point_colours
from jaxscan.rig import Camera


def camera() -> Camera:
    return Camera.create((100, 80), (100.0, 100.0), (49.5, 39.5))


def test_a_point_has_the_colour_of_its_pixel_where_the_motion_has_carried_it() -> None:
    v, u = np.mgrid[:80, :100]
    photograph = np.stack([u, v, np.full_like(u, 7)], axis=-1).astype(np.uint8)
    points = np.array([[0.0, 0.0, 100.0], [12.0, -5.0, 100.0], [500.0, 0.0, 100.0]])
    pose = Pose(np.zeros(3), np.array([3.0, 0.0, 0.0]))
    found = point_colours(camera(), pose, points, photograph)
    np.testing.assert_allclose(found[:2], [[52.5, 39.5, 7.0], [64.5, 34.5, 7.0]], atol=1e-4)
    assert np.isnan(found[2]).all()


def test_what_is_hidden_has_none() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-20, 20, 81), np.linspace(-20, 20, 81)))
    wall = np.stack([x, y, np.full_like(x, 100.0)], axis=-1)
    near = np.abs(x) < 5
    # A plate of 10 mm before the wall hides what is behind it: 6.25 mm either way at half the distance from the plate.
    plate = np.stack([x, y, np.full_like(x, 80.0)], axis=-1)[near]
    photograph = np.full((80, 100, 3), 9, np.uint8)
    pose = Pose(np.zeros(3), np.zeros(3))
    known = np.isfinite(point_colours(camera(), pose, np.concatenate([plate, wall]), photograph)[:, 0])
    assert known[: len(plate)].all()
    seen = known[len(plate) :]
    assert not seen[np.abs(x) < 5.5].any()
    assert seen[np.abs(x) > 8.0].all()


@pytest.mark.parametrize("columns", [True, False])
def test_what_is_in_the_stripe_has_none(columns: bool) -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-30, 30, 61), np.linspace(-30, 30, 61)))
    wall = np.stack([x, y, np.full_like(x, 100.0)], axis=-1)
    stripe = np.full(100 if columns else 80, 30.0)
    stripe[:40] = np.nan
    photograph = np.full((80, 100, 3), 9, np.uint8)
    pose = Pose(np.zeros(3), np.zeros(3))
    known = np.isfinite(point_colours(camera(), pose, wall, photograph, stripe, columns=columns)[:, 0])
    u, v = x + 49.5, y + 39.5
    line, place = (u, v) if columns else (v, u)
    lit = (np.rint(line) >= 40) & (np.abs(place - 30) < 12)
    np.testing.assert_array_equal(known, ~lit)
