"""Profiles as CSV: one line for each point with a header, or without one a line of z for each profile."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.files.listing import gap_in_numbers
from jaxscan.files.table import Table
from jaxscan.files.text import read_text

# What each column is called where the file does not say it with `columns`, letters' case left out.
_USUAL: Final = {
    "x": ("x", "x_mm", "x [mm]", "x (mm)"),
    "z": ("z", "z_mm", "z [mm]", "z (mm)", "range", "height"),
    "intensity": ("intensity", "i", "reflectivity"),
    "profile": ("profile", "frame", "line", "row"),
}
_NEEDED: Final = ("x", "z")
_SEPARATORS: Final = (";", "\t", ",")
# Letters of a CSV file: some 20 million points.
_LONGEST: Final = 1 << 30
_NONE: Final = ("", "nan", "null", "none", "-", "inf", "-inf", "invalid")

Columns = dict[str, Float[np.ndarray, "lines"]]
Found = tuple[
    Float[np.ndarray, "profiles points"] | None,
    Float[np.ndarray, "profiles points"],
    Float[np.ndarray, "profiles points"] | None,
]


def read_profiles_csv(table: Table, files: Sequence[Path]) -> Found:
    """X, z and intensity of each profile; no x where the files have no header and each line is a profile.

    Args:
        table: `[profiles]`, with `columns` and `invalid` where they are given.
        files: one with all profiles, or one for each.

    Raises:
        InputError: a number cannot be read, a column is missing, or profiles have different lengths.
    """
    renamed = _renamed(table)
    invalid = table.number("invalid") if "invalid" in table else None
    if (gap := gap_in_numbers(files)) and "steps" not in table and "axes" not in table:
        raise table.error(
            "files",
            f"{gap[1].name} follows {gap[0].name}: put the profiles between them there, or list where the axis stood "
            "for each profile under steps",
        )
    parts = [_read(file, renamed, invalid) for file in files]
    if isinstance(parts[0], np.ndarray):
        rows = [part for part in parts if isinstance(part, np.ndarray)]
        if len(rows) != len(parts) or len({part.shape[1] for part in rows}) > 1:
            raise _unlike(table, files, [part.shape[1] if isinstance(part, np.ndarray) else 0 for part in parts])
        return None, np.concatenate(rows), None
    named = [part for part in parts if isinstance(part, dict)]
    if len(named) != len(parts):
        raise table.error("files", "some have a header and some have none: export all in one way")
    if len(files) == 1:
        named = _split(table, files[0], named[0])
    counts = [len(part["z"]) for part in named]
    if len(set(counts)) > 1:
        raise _unlike(table, files, counts)
    stacked = {name: np.stack([part[name] for part in named]) for name in named[0] if all(name in p for p in named)}
    return stacked["x"], stacked["z"], stacked.get("intensity")


def _renamed(table: Table) -> dict[str, str]:
    """What columns are called by the file of the profiles, as `[profiles.columns]` has it."""
    if "columns" not in table:
        return {}
    given = table.table("columns", "[profiles.columns] ").only(*_USUAL)
    return {name: given.string(name) for name in _USUAL if name in given}


def _read(file: Path, renamed: dict[str, str], invalid: float | None) -> Columns | Float[np.ndarray, "profiles points"]:
    """The columns of a file with a header; the lines of one without."""
    titles = {name: (renamed[name].lower(),) if name in renamed else usual for name, usual in _USUAL.items()}

    def parse(text: str) -> Columns | Float[np.ndarray, "profiles points"]:
        lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"]
        if not lines:
            raise ValueError("is empty: export the profiles again")
        first = lines[0][1]
        separator = max(_SEPARATORS, key=first.count)
        separator = separator if separator in first else None
        if separator and all(line.rstrip(" ").endswith(separator) for _, line in lines):
            # The end of a line, and no further column.
            lines = [(n, line.rstrip(" ")[:-1]) for n, line in lines]
            first = lines[0][1]
        header = [word.strip().strip('"').lower() for word in first.split(separator)]
        if all(_is_number(word) for word in header):
            rows = [_row(n, line.split(separator), len(header), invalid) for n, line in lines]
            return np.array(rows)
        places = {name: next((header.index(t) for t in names if t in header), None) for name, names in titles.items()}
        for name in _NEEDED:
            if places[name] is None:
                named = f", which [profiles.columns] {name} names" if name in renamed else ""
                raise ValueError(
                    f'has no column "{renamed.get(name, name)}"{named}; its columns are {", ".join(header)}: name the '
                    f"one that is {name} under [profiles.columns]"
                )
        if len(lines) == 1:
            raise ValueError("has a header and no points: export the profiles again")
        rows = np.array([_row(n, line.split(separator), len(header), invalid) for n, line in lines[1:]])
        return {name: rows[:, place] for name, place in places.items() if place is not None}

    try:
        return parse(read_text(file, "CSV", longest=_LONGEST))
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _row(line: int, words: Sequence[str], count: int, invalid: float | None) -> list[float]:
    if len(words) != count:
        raise ValueError(f"line {line} has {len(words)} numbers, the first has {count}: export it again")
    values = []
    for word in words:
        plain = word.strip().strip('"').lower()
        if plain in _NONE:
            values.append(np.nan)
            continue
        try:
            value = float(plain)
        except ValueError:
            fix = "with points for decimals, and ; between columns" if "," in word else "without text in its lines"
            raise ValueError(f'line {line}: "{word.strip()}" is no number: export it {fix}') from None
        values.append(np.nan if value == invalid or not np.isfinite(value) else value)
    return values


def _is_number(word: str) -> bool:
    if word in _NONE:
        return True
    try:
        float(word)
    except ValueError:
        return False
    return True


def _split(table: Table, file: Path, columns: Columns) -> list[Columns]:
    """The profiles of one file, by its column `profile`."""
    if "profile" not in columns:
        raise table.error(
            "files",
            f'{file.name} is one file without a column "profile": add one that counts the profiles, name it under '
            "[profiles.columns], or give a file for each profile",
        )
    number = columns["profile"]
    if not np.isfinite(number).all() or (number != np.round(number)).any():
        raise InputError(f'{file}: the column "profile" has a number that is not whole: it counts the profiles')
    starts = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    counted = number[starts]
    if len(np.unique(counted)) != len(counted):
        raise InputError(f"{file}: the points of a profile are not together: sort the lines by the profile")
    gaps = np.flatnonzero(np.diff(counted) != 1)
    if len(gaps) and "steps" not in table and "axes" not in table:
        raise InputError(
            f"{file}: profile {counted[gaps[0] + 1]:.0f} follows {counted[gaps[0]]:.0f}: list where the axis stood "
            "for each profile under steps"
        )
    ends = [*starts[1:], len(number)]
    return [{name: of[a:b] for name, of in columns.items()} for a, b in zip(starts, ends, strict=True)]


def _unlike(table: Table, files: Sequence[Path], counts: Sequence[int]) -> InputError:
    other = next(i for i, count in enumerate(counts) if count != counts[0])
    where = f" ({files[other].name})" if len(files) > 1 else ""
    return table.error(
        "files",
        f"profile {other}{where} has {counts[other]} points, the first {counts[0]}: export all points of every "
        "profile, invalid ones too",
    )
