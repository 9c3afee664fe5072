"""Observations from the corners that another program found, such as Bouguet's toolbox (`calib_data.mat`)."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from jaxscan.calibration.observations import Observations, View
from jaxscan.errors import InputError
from jaxscan.files.camera_file import CameraFile
from jaxscan.images import Board


def observations_from(content: CameraFile, path: Path) -> Observations:
    """The corners of a file as views of one checkerboard, whose unit of length is taken to be the millimetre.

    The toolbox counts the corners row by row, x fastest, with y upwards and decreasing from row to row; so the same
    order counts our board's points with y downwards, and z away from the camera in place of towards it.

    Args:
        content: what `read_camera_file` returns.
        path: the file, for errors.

    Raises:
        InputError: there are no corners, or they are not those of one grid of squares.
    """
    views = [view for view in content.views if len(view.points)]
    if not views:
        raise InputError(f"{path}: holds no corners (x_1, X_1): save them with the toolbox, or calibrate a session")
    first = views[0]
    for view in views[1:]:
        if view.points.shape != first.points.shape or not np.allclose(view.points, first.points):
            raise InputError(
                f"{path}: {view.name} shows other points of the board than {first.name}: click the same squares in all"
            )
    board = _board(first.points, path)
    return Observations(content.image_size, board, tuple(View(view.name, view.pixels) for view in views))


def _board(points: Float64[np.ndarray, "points 3"], path: Path) -> Board:
    turned = np.stack([points[:, 0], points[0, 1] - points[:, 1], points[:, 2]], axis=-1)
    columns = int(np.argmax(turned[:, 1] != 0)) or 1
    pitch = float(turned[1, 0] - turned[0, 0]) if len(turned) > 1 else 0.0
    if columns < 3 or len(turned) // columns < 3 or not pitch > 0:
        raise InputError(f"{path}: X_1 is no grid of three by three corners or more, row by row: use a larger board")
    board = Board.checkerboard([columns, len(turned) // columns], pitch)
    expected = board.points()
    if expected.shape != turned.shape or not np.allclose(turned, expected, atol=1e-6 * pitch):
        raise InputError(
            f"{path}: X_1 is no grid of squares of {pitch:g} mm, row by row: use a board of squares, with dX = dY"
        )
    return board
