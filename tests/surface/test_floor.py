"""The floor: found below larger and smaller things, measured, taken away, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import ball, block, grid, seen

from jaxscan.errors import InputError
from jaxscan.rig import Linear
from jaxscan.surface.floor import find_floor, floor_from_picks, stands_on


def test_the_floor_under_a_block():
    image = block(noise=0.02)
    floor = find_floor(image)
    np.testing.assert_allclose(floor.up, [0, 0, -1], atol=1e-3)
    assert floor.sigma_mm == pytest.approx(0.02, rel=0.1)
    assert floor.tolerance_mm == pytest.approx(3 * floor.sigma_mm)
    assert floor.flatness_mm < 0.02
    assert abs(floor.height(np.array([0.0, 0.0, 300.0]))) < 0.005
    np.testing.assert_allclose(floor.frame.matrix()[:, 1], [0, 1, 0], atol=1e-3)
    assert np.linalg.det(floor.frame.matrix()) == pytest.approx(1)
    x, y = grid()
    top = (np.abs(x) < 6) & (np.abs(y) < 6)
    np.testing.assert_array_equal(stands_on(image, floor), top)


def test_a_floor_smaller_than_what_stands_on_it():
    x, y = grid()
    image = seen(np.where((np.abs(x) < 10) & (np.abs(y) < 10), 6.0, 0.0), noise=0.02)
    assert (np.abs(image.points[..., 2] - 300) < 1).mean() < 0.4
    floor = find_floor(image)
    assert abs(floor.height(np.array([0.0, 0.0, 300.0]))) < 0.01


def test_a_ball_is_kept_down_to_where_it_touches_the_floor():
    x, y = grid()
    mound = np.maximum(0.0, 3.0 - 0.06 * (x**2 + y**2))
    image = seen(mound, noise=0.02)
    floor = find_floor(image)
    kept = stands_on(image, floor)
    above = mound > 3 * floor.sigma_mm + 0.06
    assert kept[above].mean() > 0.995
    assert kept[mound == 0].mean() < 1e-3


def test_a_bent_floor_says_so():
    x, _ = grid()
    floor = find_floor(seen(0.002 * x**2, noise=0.01))
    assert floor.flatness_mm > 0.1
    assert floor.sigma_mm > 0.05


def test_picked_points():
    image = block(noise=0.02)
    picks = [[-10.0, -2.0, 300.0], [10.0, -2.0, 300.0], [0.0, -22.0, 300.0]]
    np.testing.assert_allclose(floor_from_picks(image, picks).up, [0, 0, -1], atol=3e-3)
    # The top of the block as the floor, if that is what was picked.
    top = floor_from_picks(image, [[-4.0, -9.0, 295.0], [4.0, -9.0, 295.0], [0.0, -15.0, 295.0]])
    assert abs(top.height(np.array([0.0, 0.0, 295.0]))) < 0.02
    for some, problem in (
        (picks[:2], "2 picked points give no plane"),
        ([*picks[:2], [0.0, -2.0, 300.0]], "lie on one line"),
        ([*picks[:2], [0.0, 99.0, 300.0]], r"no point within 2 mm of the pick \[0.0, 99.0, 300.0\]; the nearest is "),
    ):
        with pytest.raises(InputError, match=problem):
            floor_from_picks(image, some)


def test_the_point_nearest_to_a_pick_beside_all_is_named():
    image = block(noise=0.0)
    x, y, z = image.points[0, 0].astype(float)
    with pytest.raises(InputError, match="no point within 2 mm of the pick") as error:
        floor_from_picks(image, [[x - 5.0, y, z]] * 3)
    assert f"the nearest is {x:.2f},{y:.2f},{z:.2f}, 5 mm away: pick on the points" in str(error.value)


def test_no_floor_and_nothing_on_it():
    flat = seen(np.zeros_like(grid()[0]), noise=0.02)
    with pytest.raises(InputError, match="nothing stands on the floor"):
        stands_on(flat, find_floor(flat))
    alone = ball(noise=0.02)
    alone = alone.where(alone.points[..., 2] < 297)
    with pytest.raises(
        InputError,
        match=r"no floor was found: .* \(--floor keep\).* \(--floor X,Y,Z:X,Y,Z:X,Y,Z\) .* \(--floor bare.npz\)",
    ):
        find_floor(alone)
    with pytest.raises(InputError, match="0 points have no floor"):
        find_floor(flat.where(np.zeros_like(flat.valid)))
    # The stage does not move within this plane.
    with pytest.raises(InputError, match="no plane through the scan's points holds the direction"):
        find_floor(replace(flat, motion=Linear.create([0.0, 0.0, 0.001])))
