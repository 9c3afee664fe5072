"""Measured dimensions as CSV: a line for each dimension of one surface, or a line for each surface of many."""

import csv
import os
from collections.abc import Mapping, Sequence
from typing import Any, Final

from jaxscan.atomic import replacing

_COLUMNS: Final = (
    "name",
    "value",
    "uncertainty",
    "low",
    "high",
    "unit",
    "nominal",
    "least",
    "largest",
    "verdict",
    "sigma_rig",
    "form_mm",
    "points",
    "left_out",
    "problem",
)
_OF_EACH: Final = ("value", "uncertainty", "verdict")


def write_csv(path: str | os.PathLike[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """A line for each dimension.

    Raises:
        InputError: the file cannot be written.
    """
    write_lines(path, _COLUMNS, [[row[name] for name in _COLUMNS] for row in rows])


def write_scans_csv(
    path: str | os.PathLike[str], scans: Mapping[str, Sequence[Mapping[str, Any]]], problems: Mapping[str, str]
) -> None:
    """A line for each scan: of every dimension its value, half the width of its interval, and its verdict.

    Args:
        path: the file.
        scans: the rows of each.
        problems: why scans have none, or not all; a column beside their names.

    Raises:
        InputError: the file cannot be written.
    """
    names = list(dict.fromkeys(row["name"] for rows in scans.values() for row in rows))
    heads = ["scan", "problem", *(f"{name} {what}" if what != "value" else name for name in names for what in _OF_EACH)]
    lines = []
    for scan in dict.fromkeys([*scans, *problems]):
        by_name = {row["name"]: row for row in scans.get(scan, ())}
        cells = [by_name[name][what] if name in by_name else None for name in names for what in _OF_EACH]
        lines.append([scan, problems.get(scan), *cells])
    write_lines(path, heads, lines)


def write_lines(path: str | os.PathLike[str], heads: Sequence[str], lines: Sequence[Sequence[Any]]) -> None:
    """A heading and lines; a cell that is None is empty.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path, "w") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows([["" if cell is None else cell for cell in line] for line in lines])
