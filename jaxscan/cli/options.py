"""Options that several commands have, and their values."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any


def add_outputs_argument(parser: argparse.ArgumentParser, metavar: str, what: str, required: bool = True) -> None:
    """Declare `-o`, which may be given more than once: the file's ending says what is written."""
    words = f"what to write: {what}; may be given more than once"
    parser.add_argument(
        "-o", "--output", type=Path, required=required, default=[], action="append", metavar=metavar, help=words
    )


def add_units_argument(parser: argparse.ArgumentParser, what: str, option: str = "--units") -> None:
    """Declare in which unit of length what is read is given."""
    words = f"unit of length of {what} (default: mm; what is less than 2 mm across is pointed out)"
    parser.add_argument(option, choices=("mm", "cm", "m", "inch"), help=words)


def numbers(count: int, kind: Callable[[str], Any] = float) -> Callable[[str], list[Any]]:
    """So many numbers with commas between them."""

    def read(text: str) -> list[Any]:
        try:
            values = [kind(word) for word in text.split(",")]
        except ValueError:
            values = []
        if len(values) != count:
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} numbers with commas between them")
        return values

    return read
