"""Observations from the corners that another program found, such as Bouguet's toolbox (`calib_data.mat`)."""

from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from jaxscan.calibration.observations import Observations, View
from jaxscan.errors import InputError
from jaxscan.files.camera_file import BoardView, CameraFile
from jaxscan.files.table import LARGEST
from jaxscan.images import Board


def observations_from(content: CameraFile, path: Path) -> Observations:
    """The corners of a file as views of one checkerboard, whose unit of length is taken to be the millimetre.

    The toolbox counts the corners row by row, x fastest, with y upwards and decreasing from row to row; so the same
    order counts our board's points with y downwards, and z away from the camera in place of towards it.

    In some photographs the board's columns may have been counted as rows, for the side that is clicked first is x.
    There the board is the same one turned by a quarter, and its corners are brought into the common order. Which of the
    two quarter turns it was is not known, and makes no difference: by half a turn the points come to lie on themselves.

    Args:
        content: what `read_camera_file` returns.
        path: the file, for errors.

    Raises:
        InputError: there are no corners, or they are not those of one grid of squares.
    """
    left_out = [f"{name}: no corners were found in it" for name in content.unseen]
    left_out += [f"{view.name}: it is not among the active_images" for view in content.views if not view.active]
    views = [view for view in content.views if view.active and len(view.points)]
    if not views:
        because = "".join(f"\n  {line}" for line in left_out)
        if any(len(view.points) for view in content.views):
            raise InputError(f"{path}: none of its photographs takes part: make some active in the toolbox{because}")
        raise InputError(
            f"{path}: holds no corners (x_1, X_1): save them with the toolbox, or calibrate a session{because}"
        )
    boards = [_board(view, path) for view in views]
    common = _common(boards, views, path)
    seen = [
        View(view.name, view.pixels if own.counts == common.counts else _quarter_turned(view.pixels, common))
        for view, own in zip(views, boards, strict=True)
    ]
    return Observations(content.image_size, common, tuple(seen), left_out=tuple(left_out))


def _board(view: BoardView, path: Path) -> Board:
    """The grid of one photograph."""
    points, image = view.points, view.name
    if not (np.abs(points) <= LARGEST).all():
        raise InputError(f"{path}: {image}: its X has a number that is not finite, or too large: save the file again")
    turned = np.stack([points[:, 0], points[0, 1] - points[:, 1], points[:, 2]], axis=-1)
    columns = int(np.argmax(turned[:, 1] != 0)) or 1
    pitch = float(turned[1, 0] - turned[0, 0]) if len(turned) > 1 else 0.0
    if columns < 3 or len(turned) // columns < 3 or not pitch > 0:
        raise InputError(
            f"{path}: {image}: its X is no grid of three by three corners or more, row by row: use a larger board"
        )
    board = Board.checkerboard([columns, len(turned) // columns], pitch)
    expected = board.points()
    if expected.shape != turned.shape or not np.allclose(turned, expected, atol=1e-6 * pitch):
        raise InputError(
            f"{path}: {image}: its X is no grid of squares of {pitch:g} mm, row by row: use a board of squares, with "
            "dX = dY"
        )
    return board


def _common(boards: list[Board], views: list[BoardView], path: Path) -> Board:
    """The board of most photographs, which the others show too, as it is or turned by a quarter."""
    common = Counter(boards).most_common(1)[0][0]
    others = [
        f"{view.name} ({_in_words(board)})"
        for board, view in zip(boards, views, strict=True)
        if sorted(board.counts) != sorted(common.counts) or not np.isclose(board.pitch_mm, common.pitch_mm, rtol=1e-6)
    ]
    if others:
        raise InputError(
            f"{path}: most photographs show a board of {_in_words(common)}, but not {', '.join(others)}: click the "
            "same squares in all, or make these inactive in the toolbox (active_images)"
        )
    return common


def _in_words(board: Board) -> str:
    return f"{board.counts[0]} x {board.counts[1]} corners at {board.pitch_mm:g} mm"


def _quarter_turned(pixels: Float64[np.ndarray, "points 2"], board: Board) -> Float[np.ndarray, "points 2"]:
    """Pixels in the order of a board whose rows they count as columns: (x, y) there is (rows - 1 - y, x) here."""
    columns, rows = board.counts
    return pixels.reshape(columns, rows, 2)[:, ::-1].swapaxes(0, 1).reshape(-1, 2)
