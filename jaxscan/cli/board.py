"""`jaxscan board`: a calibration board to print, and the session file that goes with it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.atomic import make_folder
from jaxscan.cli.options import add_outputs_argument, check_outputs, columns_and_rows, positive
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.images import Board

HELP: Final = "draw a calibration board to print, and write the session.toml that goes with it"
EXAMPLE: Final = (
    "jaxscan board -o board.pdf --session session\n"
    "  jaxscan board -o board.svg --kind charuco --board 10x7 --square 24 --page letter"
)

_COUNTS: Final = {"checkerboard": "9x6", "circles": "9x6", "charuco": "10x7"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_outputs_argument(parser, "PAGE", ".pdf or .svg, true to size: print it at 100 %%")
    parser.add_argument("--kind", choices=tuple(_COUNTS), default="checkerboard", help="default: checkerboard")
    parser.add_argument(
        "--board",
        metavar="CxR",
        help="columns and rows: of inner corners (checkerboard, default 9x6), of circles (default 9x6), of squares "
        "(charuco, default 10x7). Take one even and one odd number, so that up and down can be distinguished",
    )
    parser.add_argument(
        "--square",
        type=positive,
        default=16.0,
        metavar="MM",
        help="side of a square, or pitch of circles (default: 16)",
    )
    parser.add_argument(
        "--marker", type=positive, metavar="MM", help="side of a marker (charuco; default: 0.7 squares)"
    )
    parser.add_argument("--dictionary", default="DICT_4X4_50", help="of the markers (charuco; default: DICT_4X4_50)")
    parser.add_argument("--diameter", type=positive, metavar="MM", help="of circles (default: half their pitch)")
    parser.add_argument("--page", choices=("A4", "letter"), default="A4", help="paper, on its side (default: A4)")
    parser.add_argument(
        "--session", type=Path, metavar="DIR", help="write DIR/session.toml too, with this board, to be filled in"
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Draw the page and write the session file."""
    from jaxscan.files.board_page import board_page, in_words, write_board_page
    from jaxscan.files.session import SESSION_FILE, write_blank_session

    board = _board(args)
    for path in args.output:
        if path.suffix.lower() not in (".pdf", ".svg"):
            raise InputError(f"{path}: a board is written as .svg or .pdf: end its name with one of them")
    check_outputs(args.output)
    page = board_page(board, args.page)
    session = args.session / SESSION_FILE if args.session else None
    if session is not None and session.exists():
        raise InputError(f"{session}: is there already: name another folder, or correct its [board] by hand")
    for path in args.output:
        write_board_page(path, page)
    if session is not None:
        make_folder(session.parent)
        write_blank_session(session, board)
    return {
        "kind": "board",
        "path": [str(path) for path in args.output],
        "board": in_words(board),
        "ambiguous": board.half_turn_ambiguous,
        "pitch_mm": board.pitch_mm,
        "page": args.page,
        "session": str(session) if session else None,
    }


def _board(args: argparse.Namespace) -> "Board":
    """The board that was asked for."""
    from jaxscan.images import Board

    text = args.board or _COUNTS[args.kind]
    if (numbers := columns_and_rows(text)) is None:
        raise InputError(f"--board {text}: give columns and rows, as {_COUNTS[args.kind]}")
    for option, kind in (("marker", "charuco"), ("diameter", "circles")):
        if getattr(args, option) is not None and args.kind != kind:
            raise InputError(f"--{option}: only a board of --kind {kind} has it: leave it out")
    if args.kind == "circles":
        return Board.circles(numbers, args.square, args.diameter)
    if args.kind == "charuco":
        return Board.charuco(numbers, args.square, args.marker or round(0.7 * args.square, 2), args.dictionary)
    return Board.checkerboard(numbers, args.square)


def describe(result: dict[str, Any]) -> str:
    """What was written, and how to print it."""
    lines = [
        f"{', '.join(result['path'])}: {result['board']}, for {result['page']}",
        "print it at 100 % (no scaling), measure the ruler on the page, and glue the page to a flat plate",
    ]
    what = "pitch_mm" if result["board"].startswith("circles") else "square_mm"
    if result["ambiguous"]:
        other = "a checkerboard or ChArUco" if what == "pitch_mm" else "one even and one odd number of corners"
        lines.append(f"note: this board looks the same after half a turn; where that matters, take {other}")
    if result["session"]:
        lines.append(
            f"{result['session']}: {what} = {result['pitch_mm']:g}; where the ruler is not 100 mm long, write "
            f"{result['pitch_mm']:g} times its length / 100 instead"
        )
    return "\n".join(lines)
