"""The order of a board's points: the same physical point first in every view, as far as the board allows it.

A grid of m × n points can be numbered row by row in as many ways as it has symmetries. Three rules choose among them:

1. The turn from x to y is clockwise on the photograph (v down), so that z = x × y points away from the camera.
   A mirrored order is never right.
2. On a checkerboard the square diagonally outside the first corner is dark. This decides the half turn where exactly
   one count is even, and the quarter turn where both counts are the same odd number.
3. What is left, a half turn or, on a square grid, quarter turns, cannot be determined from one photograph. Along a
   stage it is carried over from the image before.
"""

import numpy as np
from jaxtyping import Float, UInt

from jaxscan.images.board import Board

# Pixels u and v; what else is known of a point goes along.
Corners = Float[np.ndarray, "points values"]
Grid = Float[np.ndarray, "grid_rows grid_columns values"]


def order_grid(board: Board, corners: Corners, grey: UInt[np.ndarray, "rows columns"]) -> Corners:
    """The points of one photograph, found row by row from whichever end, in the order that the rules ask for.

    Args:
        board: a checkerboard or circles.
        corners: as they were found, pixels; of circles some may be NaN.
        grey: the photograph.
    """
    columns, rows = board.counts
    grid = corners.reshape(rows, columns, -1)
    whole = _whole(grid)
    along_x, along_y = whole[-1, -1] - whole[-1, 0], whole[-1, 0] - whole[0, 0]
    if along_x[0] * along_y[1] - along_x[1] * along_y[0] < 0:
        grid = grid[::-1]
    if board.kind == "checkerboard" and not _first_square_is_dark(grid, grey):
        turned = [order for order in _turns(grid) if _first_square_is_dark(order, grey)]
        grid = turned[0] if turned else grid
    return grid.reshape(columns * rows, -1)


def carry_order(board: Board, previous_corners: Corners, corners: Corners) -> Corners:
    """The order nearest to the corners of the image before, of those that one photograph cannot distinguish.

    All points of the board are compared: those that are NaN stand where the others put them. So an order is not the
    nearer for what is hidden, and two photographs that share no point are ordered as well as any.
    """
    if not board.half_turn_ambiguous:
        return corners
    columns, rows = board.counts
    orders = _turns(corners.reshape(rows, columns, -1))
    if board.kind == "checkerboard" and columns % 2:
        # Quarter turns of an odd square board exchange dark and light, and the colours were right already.
        orders = orders[:2]
    previous = _whole(previous_corners.reshape(rows, columns, -1))
    nearest = np.argmin([((_whole(order) - previous) ** 2).sum() for order in orders])
    return orders[nearest].reshape(len(corners), -1)


def _whole(grid: Grid) -> Float[np.ndarray, "grid_rows grid_columns 2"]:
    """Pixels of all points by the affine map that the seen ones fit best.

    Perspective and lens are left out: they move no point as far as a turn does, and would run away from a few points.
    """
    rows, columns = grid.shape[:2]
    y, x = np.indices((rows, columns)).reshape(2, -1) - (np.array([[rows], [columns]]) - 1) / 2
    basis, pixels = np.stack([np.ones_like(x), x, y], axis=1), grid[..., :2].reshape(-1, 2)
    seen = np.isfinite(pixels).all(axis=1)
    return (basis @ np.linalg.lstsq(basis[seen], pixels[seen], rcond=None)[0]).reshape(rows, columns, 2)


def _turns(grid: Grid) -> list[Grid]:
    """The grid as it is, after half a turn and, where it is square, after quarter turns."""
    turns = (0, 2, 1, 3) if grid.shape[0] == grid.shape[1] else (0, 2)
    return [np.rot90(grid, turn) for turn in turns]


def _first_square_is_dark(grid: Grid, grey: UInt[np.ndarray, "rows columns"]) -> bool:
    """Whether the square diagonally outside the first corner is dark; of a grid without gaps.

    It may lie outside the photograph; but it has the colour of the square diagonally inside, and of every second one.
    """
    centres = (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, :-1] + grid[1:, 1:]) / 4
    u, v = np.rint(centres[..., :2]).astype(int).reshape(-1, 2).clip(0, np.array(grey.shape)[::-1] - 1).T
    like_first = np.indices(centres.shape[:2]).sum(axis=0).ravel() % 2 == 0
    return bool(np.median(grey[v, u][like_first]) < np.median(grey[v, u][~like_first]))
