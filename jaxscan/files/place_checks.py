"""Checks of where an axis stood: what its reference switch, or a board in view, has shown of the frames taken."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from jaxscan.files.table import Table

# How it was found out, by the switch and by the board.
_FOUND: Final = ("its switch was met at another count than before", "the board that rides on it is seen elsewhere")


@dataclass(frozen=True)
class PlaceCheck:
    """A check of the axes of a scan.

    Attributes:
        first, last: the frames that it covers, counted from 0: those since the check before, or since homing.
        off: by how many motor steps the count of an axis was off, by the axis's name; empty where all were right.
        unverified: whether there was to be a check, and the scan ended, or the line was too bad, before it was made.
        by_board: whether a board in the photographs was looked at, not the switch met.
    """

    first: int
    last: int
    off: Mapping[str, int] = field(default_factory=dict)
    unverified: bool = False
    by_board: bool = False


def read_checks(table: Table, frames: int | None) -> tuple[PlaceCheck, ...]:
    """The checks that `[scan]` lists.

    Args:
        table: of the scan.
        frames: how many it has, None where that is not known.

    Raises:
        InputError: one that is none, or of frames that the scan does not have.
    """
    checks = []
    for number, values in enumerate(table.sequence("checks", "tables") if "checks" in table else ()):
        if not isinstance(values, dict):
            raise table.error("checks", "give tables, as { first = 0, last = 119, off = { stage = 35 } }")
        check = Table(table.path, f"{table.prefix}checks {number + 1}: ", values)
        check = check.only("first", "last", "off", "unverified", "by_board")
        first, last = check.whole("first"), check.whole("last")
        if not 0 <= first <= last or (frames is not None and last >= frames):
            raise check.error("last", f"is of frames {first} to {last}: give frames of the scan, counted from 0")
        off = check.table("off", "off.") if "off" in check else None
        unverified = check.boolean("unverified", False)
        found = {} if off is None else {axis: off.whole(axis) for axis in off.values}
        checks.append(PlaceCheck(first, last, found, unverified, check.boolean("by_board", False)))
    return tuple(checks)


def check_values(checks: Sequence[PlaceCheck]) -> list[dict[str, Any]]:
    """As `read_checks` reads them."""
    return [
        {
            "first": check.first,
            "last": check.last,
            **({"off": dict(check.off)} if check.off else {}),
            **({"unverified": True} if check.unverified else {}),
            **({"by_board": True} if check.by_board else {}),
        }
        for check in checks
    ]


def doubts(checks: Sequence[PlaceCheck]) -> Iterator[str]:
    """What is said of frames whose places are doubtful."""
    for check in checks:
        if check.unverified and check.by_board:
            yield (
                f"frames {check.first} to {check.last} are not verified: no photograph before or after them shows the "
                "board. If the motor lost steps there, nothing says so"
            )
        elif check.unverified:
            yield (
                f"frames {check.first} to {check.last} were to be verified and were not: the scan ended, or its line "
                "was bad, before the switch was met again. If the motor lost steps, nothing says so"
            )
        off = " and ".join(f"{abs(steps)} steps of the {axis}" for axis, steps in check.off.items())
        if off:
            yield (
                f"frames {check.first} to {check.last} may have been taken elsewhere than their positions say, by up "
                f"to {off}: {_FOUND[check.by_board]}. The motor lost steps: take them again, more slowly"
            )
