import cv2
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.images import Board


def test_points_run_along_the_rows():
    points = Board.checkerboard((4, 3), 2.5).points()
    assert points.shape == (12, 3)
    np.testing.assert_array_equal(points[:5], [[0, 0, 0], [2.5, 0, 0], [5, 0, 0], [7.5, 0, 0], [0, 2.5, 0]])
    assert points.dtype == np.float64


def test_charuco_points_are_those_of_opencv():
    board = Board.charuco((7, 5), 10.0, 7.0, "DICT_4X4_50")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners = cv2.aruco.CharucoBoard((7, 5), 10.0, 7.0, dictionary).getChessboardCorners()
    np.testing.assert_allclose(board.points(), corners - corners[0], atol=1e-5)


@pytest.mark.parametrize(
    ("counts", "ambiguous"), [((9, 6), False), ((6, 9), False), ((5, 5), True), ((8, 6), True), ((7, 3), True)]
)
def test_half_turn(counts, ambiguous):
    # What is printed decides: the board turned by half a turn, square for square.
    columns, rows = counts
    squares = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2
    assert np.array_equal(squares, squares[::-1, ::-1]) == ambiguous
    assert Board.checkerboard(counts, 10.0).half_turn_ambiguous == ambiguous
    assert Board.circles(counts, 10.0).half_turn_ambiguous


def test_a_charuco_board_is_never_ambiguous():
    assert not Board.charuco((6, 6), 10.0, 7.0, "DICT_4X4_50").half_turn_ambiguous


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Board.checkerboard((9, 2), 10.0), r"inner_corners = \[9, 2\]"),
        (lambda: Board.checkerboard((9,), 10.0), r"inner_corners = \[9\]"),
        (lambda: Board.checkerboard((9, 6.5), 10.0), "6.5"),
        (lambda: Board.checkerboard((9, 6), -1.0), "square_mm = -1.0"),
        (lambda: Board.checkerboard((9, 6), 0.016), r"square_mm = 0.016: give .* millimetres.*; 0.016 m are 16$"),
        (lambda: Board.checkerboard((9, 6), float("nan")), "square_mm = nan"),
        (lambda: Board.circles((7, 7), 0), "pitch_mm = 0"),
        (lambda: Board.circles((True, 7), 5.0), "circles"),
        (lambda: Board.charuco((7, 5), 10.0, 10.0, "DICT_4X4_50"), "marker_mm = 10"),
        (lambda: Board.charuco((7, 5), 10.0, 7.0, "DICT_9X9"), "DICT_4X4_50"),
        (lambda: Board.charuco((12, 12), 10.0, 7.0, "DICT_4X4_50"), "needs 72"),
    ],
)
def test_bad_boards_are_refused_by_key_and_value(make, says):
    with pytest.raises(InputError, match=says):
        make()
