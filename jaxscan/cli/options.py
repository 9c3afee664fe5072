"""Values of options that several commands have."""

import argparse
from collections.abc import Callable
from typing import Any


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
