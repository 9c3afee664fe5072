import cv2
import numpy as np
import pytest

from jaxscan.images.board_map import map_board

SIZE = (640, 480)
K = np.array([[256.0, 0, 325.0], [0, 256.0, 233.0], [0, 0, 1]])
WIDE, NONE = np.array([-0.25, 0.06, 0, 0]), np.zeros(4)
COLUMNS, ROWS = 9, 6


def seen(at, lens, sag):
    """Pixels of board points, in squares, by OpenCV."""
    X = np.column_stack([at, sag * (at[:, 0] / (COLUMNS - 1) - 0.5) ** 2])
    return cv2.projectPoints(X, np.array([0.35, -0.3, 0.1]), np.array([-6.0, -1.6, 5.5]), K, lens)[0][:, 0]


def board(lens, sag=0.0):
    """A grid of corners, and the curvature of both lines through each."""
    at = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)), axis=-1).reshape(-1, 2).astype(float)
    bends, h = [], 1e-3
    for step in h * np.eye(2):
        before, here, after = (seen(at + sign * step, lens, sag) for sign in (-1, 0, 1))
        along, second = (after - before) / 2, after - 2 * here + before
        bends.append((along[:, 0] * second[:, 1] - along[:, 1] * second[:, 0]) / np.linalg.norm(along, axis=1) ** 3)
    return seen(at, lens, sag).reshape(ROWS, COLUMNS, 2), np.stack(bends, axis=-1).reshape(ROWS, COLUMNS, 2)


def test_a_wide_angle_lens_bends_lines_as_it_does_at_the_outermost_corners_too():
    grid, bends = board(WIDE)
    assert np.abs(bends).max() > 1.5e-3
    for start in (None, map_board(grid, SIZE).parameters):
        np.testing.assert_allclose(map_board(grid, SIZE, start).bends, bends, atol=1e-4)


def test_noise_wild_corners_and_hidden_ones_hardly_change_the_bends():
    grid, bends = board(WIDE)
    grid += 0.02 * np.random.default_rng(0).standard_normal(grid.shape)
    grid[1, 2] += [4, -3]
    grid[4, 7] = np.nan
    found = map_board(grid, SIZE)
    np.testing.assert_allclose(found.bends, bends, atol=1e-4)
    np.testing.assert_allclose(found.pixels[4, 7], board(WIDE)[0][4, 7], atol=0.05)


def test_without_a_lens_lines_are_straight():
    np.testing.assert_allclose(map_board(board(NONE)[0], SIZE).bends, 0, atol=1e-7)


def test_a_board_that_is_not_flat_bends_its_lines_too():
    grid, bends = board(NONE, sag=0.05)
    error = map_board(grid, SIZE).bends - bends
    assert np.sqrt((error**2).mean()) < 0.3 * np.sqrt((bends**2).mean())
    # Nor does it spoil what is read of a lens: 15 px from the corner 1e-4 / px is a third of a hundredth of a pixel.
    grid, bends = board(WIDE, sag=0.02)
    np.testing.assert_allclose(map_board(grid, SIZE).bends, bends, atol=1e-4)


@pytest.mark.parametrize("count", [0, 5, 8])
def test_few_corners_say_nothing_of_bends(count):
    grid, _ = board(WIDE)
    grid.reshape(-1, 2)[count:] = np.nan
    grid[1, 1] = np.nan if count == 0 else grid[1, 1]
    found = map_board(grid, SIZE)
    assert found is None or not found.bends.any()
