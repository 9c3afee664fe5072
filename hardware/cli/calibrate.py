"""`scanner calibrate`: a calibration session under guidance."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import add_scanner_arguments, say, scanner

if TYPE_CHECKING:
    from hardware.guide import Operator
    from hardware.protocols import Camera

HELP: Final = "take a calibration session: what to do with the board next, then the stage by itself"
EXAMPLE: Final = "scanner calibrate session --board 9x6 --square 16"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("folder", type=Path, metavar="SESSION", help="the folder to make")
    parser.add_argument("--board", default="9x6", help="inner corners of the checkerboard (default: 9x6)")
    parser.add_argument("--square", type=float, default=16.0, help="side of its squares, mm (default: 16)")
    parser.add_argument("--views", type=int, default=11, help="poses of the board (default: 11)")
    parser.add_argument(
        "--stage-frames", type=int, default=31, help="places of the stage (default: 31; 0 for no stage)"
    )
    parser.add_argument("--stage-apart", type=int, default=2000, help="motor steps between them (default: 2000)")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Take it."""
    from hardware.devices import read_scanner
    from hardware.guide import guided_session
    from jaxscan.errors import InputError
    from jaxscan.images import Board

    counts = args.board.lower().split("x")
    if len(counts) != 2 or not all(count.isdigit() for count in counts):
        raise InputError(f"--board {args.board}: give columns and rows of inner corners, as 9x6")
    board = Board.checkerboard([int(count) for count in counts], args.square)
    settings = read_scanner(args.scanner)
    steps = [args.stage_apart * i for i in range(args.stage_frames)]
    with scanner(args) as devices:
        session = guided_session(
            args.folder,
            devices,
            board,
            _operator(devices.camera, args.views),
            views=args.views,
            stage_steps=steps,
            stripe=settings.stripe,
        )
    stage = session.stage
    return {
        "path": str(args.folder),
        "views": len(session.views.boards),
        "stage_images": 0 if stage is None else len(stage.images),
    }


class _Person:
    """Whoever sits at the terminal."""

    def ready(self, wish: str) -> bool:
        """Ask, and wait for the Enter key."""
        say(f"\n{wish}")
        return input("Enter when it is held still, q to end: ").strip().lower() != "q"

    def say(self, words: str) -> None:
        """Tell."""
        say(words)


def _operator(camera: "Camera", views: int) -> "Operator":
    """A person, or the simulated one for the simulated camera."""
    world = getattr(camera, "world", None)
    if world is None:
        return _Person()
    from hardware.simulated.operator import SimulatedOperator

    return SimulatedOperator(world, views, say)


def describe(result: dict[str, Any]) -> str:
    """What there is, and what to do with it."""
    return (
        f"{result['path']}: {result['views']} views of the board, {result['stage_images']} along the stage\n"
        f"next: jaxscan calibrate {result['path']} -o rig.json --report report"
    )
