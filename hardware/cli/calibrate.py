"""`scanner calibrate`: a calibration session under guidance."""

import argparse
import shlex
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import (
    add_board_arguments,
    add_scanner_arguments,
    as_input,
    board_of,
    check_travel,
    say,
    scanner,
)
from jaxscan.cli.progress import resting

if TYPE_CHECKING:
    from hardware.guide import Operator, Sight

HELP: Final = "take a calibration session: what to do with the board next, then the axes automatically"
EXAMPLE: Final = (
    "scanner calibrate session --board 9x6 --square 16\n"
    "  scanner calibrate session --turntable-frames 32 --turntable-at 48000\n"
    "  scanner calibrate session --show live.png   # a live picture, for a viewer that follows its file"
)
_STAGE_FRAMES: Final = 31
# Between two live pictures.
_EVERY_S: Final = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("folder", type=Path, metavar="SESSION", help="the folder to make")
    add_board_arguments(parser)
    parser.add_argument("--views", type=int, default=11, help="poses of the board (default: 11)")
    parser.add_argument(
        "--stage-frames", type=int, help="places of the stage (default: 31 where there is one; 0 for no stage)"
    )
    parser.add_argument("--stage-apart", type=int, default=2000, help="motor steps between them (default: 2000)")
    parser.add_argument(
        "--turntable-frames",
        type=int,
        default=0,
        help="places of the turntable, once around in equal parts (default: 0; 16 are enough)",
    )
    parser.add_argument(
        "--turntable-at",
        type=int,
        metavar="STEP",
        help="where the stage stands meanwhile, so that the board on the turntable is in view",
    )
    parser.add_argument(
        "--show", type=Path, metavar="IMAGE", help="the live picture with corners and coverage, written again and again"
    )
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Take it."""
    from hardware.devices import read_scanner
    from hardware.guide import check_session, guided_session
    from hardware.places import STAGE, TURNTABLE, along, full_turn
    from hardware.simulated.operator import simulated_operator
    from jaxscan.atomic import check_writable
    from jaxscan.errors import InputError

    board = board_of(args)
    settings = read_scanner(args.scanner)
    if args.stage_frames is None:
        args.stage_frames = _STAGE_FRAMES if STAGE in settings.axes else 0
    if args.stage_frames < 0:
        raise InputError(f"--stage-frames {args.stage_frames}: give 2 or more, or 0 for a rig without a stage")
    steps = [args.stage_apart * i for i in range(args.stage_frames)]
    turns: Sequence[int] = ()
    if args.turntable_frames:
        with as_input():
            turns = full_turn(settings.travels, TURNTABLE, args.turntable_frames)
        if STAGE in settings.axes and args.turntable_at is None:
            raise InputError("--turntable-at: say where the stage is to stand while the board on the turntable turns")
    check_session(args.views, steps, turns)
    check_travel(settings, along(STAGE, steps))
    check_travel(settings, along(TURNTABLE, turns, {} if args.turntable_at is None else {STAGE: args.turntable_at}))
    if args.show is not None:
        check_writable(args.show)
    with scanner(args) as devices:
        hand = simulated_operator(devices.camera, args.views, say)
        session = guided_session(
            args.folder,
            devices,
            board,
            _Terminal(hand, args.show),
            views=args.views,
            stage_steps=steps,
            turntable_steps=turns,
            turntable_at=args.turntable_at or 0,
            stripe=settings.stripe,
        )
    counts = session.counts
    return {
        "path": str(args.folder),
        "views": len(session.views.boards),
        "stage_images": counts.get(STAGE, 0),
        "turntable_images": counts.get(TURNTABLE, 0),
    }


class _Terminal:
    """Whoever sits at the terminal, or the simulated operator; the live picture goes to a file."""

    def __init__(self, hand: "Operator | None", picture: Path | None):
        self._hand, self._picture = hand, picture

    def ready(self, wish: str, look: Callable[[], object]) -> bool:
        """Ask, and wait for the Enter key."""
        if self._hand is not None:
            return self._hand.ready(wish, look)
        say(f"\n{wish}")
        answered, failures = threading.Event(), []

        def look_on() -> None:
            try:
                while not answered.wait(_EVERY_S):
                    look()
            except Exception as error:  # noqa: BLE001 (raised where it is waited for)
                failures.append(error)

        looking = threading.Thread(target=look_on, daemon=True)
        if self._picture is not None:
            looking.start()
        try:
            with resting():
                answer = input("Enter when it is held still, q to end: ")
        except EOFError:
            answer = "q"
        finally:
            answered.set()
            if self._picture is not None:
                looking.join()
        if failures:
            raise failures[0]
        return answer.strip().lower() != "q"

    def show(self, sight: "Sight") -> None:
        """Write the picture, whole each time."""
        if self._picture is not None:
            from jaxscan.images import write_image

            write_image(self._picture, sight.picture())

    def say(self, words: str) -> None:
        """Tell."""
        say(words)


def describe(result: dict[str, Any]) -> str:
    """What there is, and what to do with it."""
    around = f", {result['turntable_images']} on the turntable" if result["turntable_images"] else ""
    return (
        f"{result['path']}: {result['views']} views of the board, {result['stage_images']} along the stage{around}\n"
        f"next: jaxscan calibrate {shlex.quote(result['path'])} -o rig.json --report report"
    )
