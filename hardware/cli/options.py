"""Arguments that several commands share."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hardware.devices import ScannerSettings
    from hardware.protocols import StageDriver
    from hardware.scan import Devices


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


def check_travel(settings: "ScannerSettings", steps: Sequence[int]) -> None:
    """See that the stage may be sent to all of these, before any work.

    Raises:
        InputError: it may not.
    """
    from hardware.errors import SettingsError
    from jaxscan.errors import InputError

    try:
        settings.travel.check(steps)
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
        devices.camera.close()
        devices.stage.close()


@contextmanager
def stage_alone(args: argparse.Namespace) -> "Iterator[StageDriver]":
    """The stage without camera and laser; halted when the block ends in an error."""
    from hardware.devices import open_stage
    from hardware.safety import safely

    stage = open_stage(_described(args), args.homed)
    try:
        with safely(stage, None):
            yield stage
    finally:
        stage.close()


def say(words: str) -> None:
    """One line to standard error, at once."""
    print(words, file=sys.stderr, flush=True)


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
