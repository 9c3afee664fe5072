"""A second board in the photograph is seen, and one alone is not taken for two."""

import numpy as np
import pytest
import render

from jaxscan.images import Board, find_board, shows_second_board

BOARD = Board.checkerboard([7, 6], 10.0)


def photograph(*left_edges_px: float) -> np.ndarray:
    """Boards of 7 x 6 corners side by side."""
    pattern = render.checkerboard((7, 6), 10.0)
    image = np.full((240, 520), 210.0)
    for left in left_edges_px:
        square = 22.0
        corners = [[left, 60], [left + 6 * square, 60], [left + 6 * square, 60 + 5 * square], [left, 60 + 5 * square]]
        H = render.homography([[0, 0], [60, 0], [60, 50], [0, 50]], corners)
        image = np.minimum(image, render.photograph(pattern, H, image.shape, blur=0.7))
    return image.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(("edges", "two"), [((60.0,), False), ((300.0,), False), ((60.0, 310.0), True)])
def test_a_second_board(edges, two):
    image = photograph(*edges)
    found = find_board(BOARD, image)
    assert found is not None
    assert shows_second_board(BOARD, image, found.corners) is two


def test_a_stripe_across_both_hides_neither():
    image = photograph(60.0, 310.0)
    found = find_board(BOARD, image)
    assert found is not None
    image[108:111] = 255
    # Corners under the stripe are not seen.
    corners = np.where(np.abs(found.corners[:, 1:] - 109) < 8, np.nan, found.corners)
    assert np.isnan(corners).any()
    assert shows_second_board(BOARD, image, corners)


def test_other_kinds_cannot_be_told():
    board = Board.circles([7, 6], 10.0)
    assert not shows_second_board(board, photograph(60.0, 310.0), np.zeros((42, 2)))
