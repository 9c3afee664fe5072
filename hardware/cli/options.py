"""Arguments that several commands share."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hardware.devices import ScannerSettings
    from hardware.places import Place
    from hardware.protocols import StageDriver
    from hardware.scan import Devices
    from jaxscan.images import Board


def add_scanner_arguments(parser: argparse.ArgumentParser) -> None:
    """Which scanner."""
    parser.add_argument(
        "--scanner", type=Path, metavar="FILE", help="its description (default: scanner.toml here, else simulated)"
    )
    parser.add_argument("--seed", type=_seed, default=0, help="of the simulated scanner (default: 0)")
    parser.add_argument(
        "--homed",
        action="store_true",
        help="trust a BiStep2A04's count since it was last homed, and do not home it again",
    )


def add_data_argument(parser: argparse.ArgumentParser) -> None:
    """Where the lab server keeps accounts, jobs and projects."""
    parser.add_argument(
        "--data", type=Path, default=Path("scanner-lab"), metavar="DIR", help="the lab's folder (default: scanner-lab)"
    )


def add_axis_argument(parser: argparse.ArgumentParser, default: str | None, help_: str) -> None:
    """Which axis of the scanner."""
    parser.add_argument("--axis", default=default, metavar="NAME", help=help_)


def check_travel(settings: "ScannerSettings", places: "Sequence[Place]") -> None:
    """See that the axes may be sent to all of these, before any work.

    Raises:
        InputError: they may not.
    """
    from hardware.places import check_places

    with as_input():
        check_places(settings.travels, places)


@contextmanager
def as_input() -> Iterator[None]:
    """A `SettingsError` in the block becomes an error of what was given.

    Raises:
        InputError: in its place.
    """
    from hardware.errors import SettingsError
    from jaxscan.errors import InputError

    try:
        yield
    except SettingsError as error:
        raise InputError(str(error)) from error


@contextmanager
def scanner(args: argparse.Namespace) -> "Iterator[Devices]":
    """The scanner, open for the length of the block."""
    from hardware.devices import open_scanner

    devices = open_scanner(_described(args), args.seed, args.homed)
    try:
        yield devices
    finally:
        devices.close()


@contextmanager
def axes_alone(args: argparse.Namespace) -> "Iterator[dict[str, StageDriver]]":
    """The axis of `--axis`, or all of them, without camera and laser; halted when the block ends in an error."""
    from hardware.devices import open_stage
    from hardware.safety import safely

    settings = _described(args)
    axes: dict[str, StageDriver] = {}
    with ExitStack() as undo:
        for name in (args.axis,) if args.axis is not None else settings.axes:
            axes[name] = open_stage(settings, name, args.homed, axes)
            undo.callback(axes[name].close)
        with safely(axes, None):
            yield axes


def say(words: str) -> None:
    """One line to standard error, at once."""
    from jaxscan.cli import progress

    progress.say(words)
    progress.step("going on")


def _described(args: argparse.Namespace) -> "ScannerSettings":
    """The scanner's description. Where there is none that is said: simulated photographs look like real ones."""
    from hardware.devices import SCANNER_FILE, read_scanner

    settings = read_scanner(args.scanner)
    if settings.path is None:
        say(f"there is no {SCANNER_FILE} in this folder: the scanner is simulated")
    return settings


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text}: give a whole number, 0 or more")
    return int(text)


def add_board_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the checkerboard that is held, or rides on an axis."""
    parser.add_argument("--board", default="9x6", help="inner corners of the checkerboard (default: 9x6)")
    parser.add_argument("--square", type=float, default=16.0, help="side of its squares, mm (default: 16)")


def board_of(args: argparse.Namespace) -> "Board":
    """The checkerboard that the arguments describe.

    Raises:
        InputError: they describe none.
    """
    from jaxscan.cli.options import columns_and_rows
    from jaxscan.errors import InputError
    from jaxscan.images import Board

    if (counts := columns_and_rows(args.board)) is None:
        raise InputError(f"--board {args.board}: give columns and rows of inner corners, as 9x6")
    return Board.checkerboard(counts, args.square)
