"""The photographs that a TOML file names, by a glob or by a list, relative to the file itself."""

import glob
import os
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from jaxscan.errors import InputError
from jaxscan.files.table import Table, show
from jaxscan.images import image_size
from jaxscan.phrases import first_few

_NAMES_SHOWN = 3
# Files whose numbers are looked at, and the part of them that has to follow each other.
_FEWEST_NUMBERED, _MOSTLY = 5, 0.8


def natural_key(name: str) -> tuple[list[str | int], str]:
    """A key that sorts names as a person counts: `view2` before `view10`."""
    # The split alternates between text and digits, so equal places hold equal types.
    parts = re.split(r"([0-9]+)", name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], name


def files_of(table: Table, key: str) -> tuple[Path, ...]:
    """The files of a glob, sorted naturally, or of a list of names, in its order.

    Raises:
        InputError: a glob that matches nothing or what is no file, a file that appears twice, or one that is not there.
    """
    value = table.values.get(key)
    if isinstance(value, str) and value:
        return _matches(table, key, value)
    names = _names(table, key)
    paths = _present(table, key, names)
    seen: set[str] = set()
    for name, path in zip(names, paths, strict=True):
        if (real := os.path.realpath(path)) in seen:
            raise table.error(key, f"{show(name)} appears twice: name each photograph once")
        seen.add(real)
    return paths


def files_or_gaps(table: Table, key: str) -> tuple[Path | None, ...]:
    """As `files_of`, but "" in a list stands for no file."""
    if isinstance(table.values.get(key), str):
        return files_of(table, key)
    names = _names(table, key, gaps=True)
    held = iter(files_of(Table(table.path, table.prefix, {key: [name for name in names if name]}), key))
    return tuple(next(held) if name else None for name in names)


def repeated_files_of(table: Table, key: str) -> tuple[Path, ...]:
    """As `files_of`, but one file may serve several times."""
    if isinstance(table.values.get(key), str):
        return files_of(table, key)
    return _present(table, key, _names(table, key))


def common_size(paths: Sequence[Path], to_their_ends: bool = False) -> tuple[int, int]:
    """Columns and rows of photographs that are all of one size.

    Args:
        paths: the photographs.
        to_their_ends: whether each is read as far as it goes, so that one that is cut off is found.

    Raises:
        InputError: two of them differ, or one cannot be read.
    """
    first, *others = paths
    odd = "all photographs must be of one camera, unscaled and uncropped; take the odd one out"
    size = image_size(first, to_their_ends)
    for path in others:
        if (other := image_size(path, to_their_ends)) != size:
            raise InputError(
                f"{path}: is {other[0]} × {other[1]} pixels, but {first} is {size[0]} × {size[1]}: "
                + (turned(other, size) or odd)
            )
    return size


def turned(size: tuple[int, int], expected: tuple[int, int]) -> str:
    """What is said of a photograph whose columns and rows are exchanged; empty where they are not.

    What EXIF says of a photograph's orientation is not read: it would move the pixels under the rig.
    """
    if size == expected or size != expected[::-1]:
        return ""
    return (
        "it is turned by a quarter, as phones and programs do by an EXIF orientation, which is not read here. Take the "
        "photographs as the camera wrote them, with the orientation locked, or turn these back: jpegtran -rotate 90 "
        "or 270, whichever makes them look like those of the calibration"
    )


def gap_in_numbers(paths: Sequence[Path]) -> tuple[Path, Path] | None:
    """The first two neighbours between whose numbers others are missing; None where there are none.

    Names count if they differ in one number alone, which nearly always rises by the same: times do not.
    """
    parts = [natural_key(path.name)[0] for path in paths]
    if len(paths) < _FEWEST_NUMBERED or len({tuple(part[::2]) for part in parts}) > 1:
        return None
    numbers = list(zip(*([int(number) for number in part[1::2]] for part in parts), strict=True))
    rising = [each for each in numbers if len(set(each)) > 1]
    if len(rising) != 1:
        return None
    steps = [b - a for a, b in pairwise(rising[0])]
    usual = max(set(steps), key=steps.count)
    gaps = [i for i, step in enumerate(steps) if usual > 0 and step > usual and step % usual == 0]
    if not gaps or steps.count(usual) < _MOSTLY * len(steps) or len(gaps) + steps.count(usual) < len(steps):
        return None
    return paths[gaps[0]], paths[gaps[0] + 1]


def name_some(paths: Sequence[Path]) -> str:
    """A few names in words: `a.png, b.png, c.png and 7 more`."""
    return first_few([path.name for path in paths], _NAMES_SHOWN)


def _matches(table: Table, key: str, pattern: str) -> tuple[Path, ...]:
    folder = table.path.parent
    if os.path.isfile(folder / pattern):  # a plain name, or one that only looks like a pattern
        return (folder / pattern,)
    if pattern.count("**") > 1:
        raise table.error(key, "has more than one **, each of which goes through all folders again: keep one")
    names = [] if "\0" in pattern else glob.glob(pattern, root_dir=folder, recursive=True)
    files = tuple(path for name in sorted(names, key=natural_key) if not os.path.isdir(path := folder / name))
    if not files:
        raise table.error(key, f"matches no file in {folder}: check folder and ending (upper and lower case differ)")
    if broken := [path for path in files if not os.path.isfile(path)]:
        raise table.error(key, f"matches {name_some(broken)}, a broken link or no plain file: put the file there")
    return files


def _names(table: Table, key: str, gaps: bool = False) -> list[str]:
    if not isinstance(table.values.get(key), list):
        missing = "" if key in table else "is missing: "
        raise table.error(key, f'{missing}must be a glob such as "photographs/*.png", or a list of names')
    names: list[Any] = table.sequence(key, "names")
    for i, name in enumerate(names):
        if not isinstance(name, str) or not (name or gaps):
            raise table.error(key, f"entry {i} is {show(name)}: must be the name of a file")
    return names


def _present(table: Table, key: str, names: Sequence[str]) -> tuple[Path, ...]:
    paths = tuple(table.path.parent / name for name in names)
    # Unlike Path.is_file, this one calls a name that the system cannot hold a missing file too.
    missing = [path for path in paths if not os.path.isfile(path)]
    if missing:
        raise table.error(
            key, f"{len(missing)} of {len(paths)} files are not in {missing[0].parent}: {name_some(missing)}"
        )
    return paths
