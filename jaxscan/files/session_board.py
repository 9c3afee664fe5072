"""`[board]` of a session: the kind of board, its pattern and its lengths."""

from functools import partial
from typing import Any, Final

from jaxscan.errors import InputError
from jaxscan.files.table import Table
from jaxscan.images import Board
from jaxscan.rig.board_shape import BOARD_SHAPES

_BOARD_KEYS: Final = {
    "checkerboard": ("inner_corners", "square_mm"),
    "circles": ("circles", "pitch_mm", "diameter_mm"),
    "charuco": ("squares", "square_mm", "marker_mm", "dictionary"),
}


def read_board(table: Table) -> tuple[Board, str]:
    """The board, and what of its shape is to be found.

    Raises:
        InputError: key, value, and how to fix it.
    """
    board = table.table("board", "[board] ")
    kind = board.string("kind", "checkerboard", tuple(_BOARD_KEYS))
    board.only("kind", "shape", *_BOARD_KEYS[kind])
    shape = board.string("shape", "flat", tuple(BOARD_SHAPES))
    if kind == "circles":
        diameter = board.number("diameter_mm") if "diameter_mm" in board else None
        make = partial(Board.circles, board.size("circles"), board.number("pitch_mm"), diameter)
    elif kind == "charuco":
        lengths = board.number("square_mm"), board.number("marker_mm")
        make = partial(Board.charuco, board.size("squares"), *lengths, board.string("dictionary"))
    else:
        make = partial(Board.checkerboard, board.size("inner_corners"), board.number("square_mm"))
    try:
        return make(), shape
    except InputError as error:
        raise InputError(f"{table.path}: [board] {error}") from error


def board_values(board: Board) -> dict[str, Any]:
    """The inverse of `read_board`: the keys of `[board]`, without its shape."""
    columns, rows = board.counts
    if board.kind == "circles":
        diameter = {"diameter_mm": board.diameter_mm} if board.diameter_mm else {}
        return {"kind": board.kind, "circles": [columns, rows], "pitch_mm": board.pitch_mm, **diameter}
    if board.kind == "charuco":
        values = {"square_mm": board.pitch_mm, "marker_mm": board.marker_mm, "dictionary": board.dictionary}
        return {"kind": board.kind, "squares": [columns + 1, rows + 1], **values}
    return {"kind": board.kind, "inner_corners": [columns, rows], "square_mm": board.pitch_mm}
