"""Lists of photographs in alphabetical order, `frame1`, `frame10`, `frame2`: not that in which they were taken.

Many programs list a folder so. Each photograph then gets the steps of another, and where the object is round nothing
else shows it.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from jaxscan.files.listing import natural_key

# Names of which a list's order says something.
_FEWEST: Final = 5


def text_order_note(what: str, paths: Sequence[Path], steps: Sequence[Sequence[int]] = ()) -> str | None:
    """What is said of photographs that are listed in alphabetical order; None for any other order.

    Args:
        what: the key that lists them.
        paths: the photographs as they are listed.
        steps: of each axis, motor steps of each photograph: where they rise evenly in the order of the numbers, each
            was listed with its own.
    """
    names = [str(path) for path in paths]
    natural = sorted(range(len(names)), key=lambda i: natural_key(names[i]))
    if len(names) < _FEWEST or natural == list(range(len(names))) or not _as_text(names) or _decimal(names):
        return None
    moving = [each for each in steps if len(set(each)) > 1]
    if moving and all(_even([each[i] for i in natural]) and not _even(each) for each in moving):
        return None
    before, odd = next((a, b) for a, b in pairwise(paths) if natural_key(str(a)) > natural_key(str(b)))
    return (
        f"{what} are listed in alphabetical order, {odd.name} after {before.name}, not by their numbers: "
        f'list them in the order in which they were taken, or give a glob such as "*{odd.suffix}", which is sorted by '
        "the numbers"
    )


def _as_text(names: Sequence[str]) -> bool:
    """Whether they are in alphabetical order, as they are or with their numbers without leading zeros."""
    bare = [re.sub("[0-9]+", lambda number: str(int(number[0])), name) for name in names]
    return any(each == sorted(each) for each in (list(names), bare))


def _decimal(names: Sequence[str]) -> bool:
    """Whether they are in the order of numbers with a decimal point: times are."""

    def key(name: str) -> list[str | float]:
        parts = re.split(r"([0-9]+(?:\.[0-9]+)?)", name)
        return [float(part) if i % 2 else part for i, part in enumerate(parts)]

    keys = [key(name) for name in names]
    return keys == sorted(keys)


def _even(steps: Sequence[int]) -> bool:
    return len({b - a for a, b in pairwise(steps)}) == 1
