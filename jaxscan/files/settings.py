"""What sessions and scans have in common: their folder, their step counts, and the settings of a laser."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, cast

import tomli_w

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.table import Table
from jaxscan.files.text import read_toml
from jaxscan.images import StripeSettings
from jaxscan.images.stripe_settings import COLORS
from jaxscan.missing import no_such_file

# Folders that are named.
_NAMED: Final = 3
# By which table each is known from the other.
_TELLING: Final = {"session.toml": "views", "scan.toml": "scan", "profiles.toml": "profiles"}


def toml_in(path: Path, name: str) -> Path:
    """The TOML file of a session or scan, given its folder or the file itself.

    Raises:
        InputError: it is not there, or the folder has none.
    """
    if path.is_dir():
        if not (path / name).is_file():
            refuse_hidden_ending(path, name)
            raise InputError(f"{path}: has no {name}: {_what_else(path, name)}")
        return path / name
    if not path.exists():
        raise no_such_file(Path(path), "file or folder")
    return path


def _what_else(folder: Path, name: str) -> str:
    """What to do about a folder without this file: it may be of another kind, or a folder in it may be meant."""
    for other in _TELLING:
        if other != name and (folder / other).is_file():
            return f"it has a {other}, so it is a {other.removesuffix('.toml')}: name the folder with the {name}"
    inside = sorted(path.parent.name for path in folder.glob(f"*/{name}"))
    if inside:
        return f"{', '.join(str(folder / each) for each in inside[:_NAMED])} has one: name that"
    return "write one there, or name another folder"


def read_listing(path: Path, name: str, keys: Sequence[str]) -> Table:
    """The outermost table of a session's or a scan's TOML file.

    Args:
        path: of the folder, or of its TOML file.
        name: that file's, "session.toml" or "scan.toml".
        keys: what it may hold.

    Raises:
        InputError: the file is not there, is another kind of file, or holds another key.
    """
    wanted = f"the {name} that lists the photographs"
    table = read_toml(toml_in(path, name), wanted)
    other = next((kind for kind, key in _TELLING.items() if key in table), name)
    if _TELLING[name] not in table and other != name:
        raise InputError(f"{table.path}: is a {other}, but a {name} is expected: name {wanted}")
    return table.only(*keys)


def refuse_hidden_ending(folder: Path, name: str) -> None:
    """Refuse a TOML file to which an editor has added an ending that file managers hide.

    Raises:
        InputError: there is one.
    """
    if (folder / f"{name}.txt").is_file():
        raise InputError(f"{folder / name}.txt: ends in .txt, and is not read: rename it to {name}")


def read_stripe_settings(table: Table) -> StripeSettings:
    """How the stripe is looked for, from a `[laser]` table."""
    return StripeSettings(
        color=cast(Literal["red", "green", "blue", "grey"], table.string("color", "red", COLORS)),
        columns=table.boolean("columns", True),
        name=table.string("name") if "name" in table else "",
    )


def stripe_values(settings: StripeSettings) -> dict[str, Any]:
    """The inverse of `read_stripe_settings`."""
    name = {"name": settings.name} if settings.name else {}
    return {**name, "color": settings.color, "columns": settings.columns}


def read_steps(table: Table, per_file: str, files: Sequence[Path], what: str) -> tuple[int, ...]:
    """The motor step count of each file: from `steps`, or counted from 0 in increments of the entry `per_file`.

    Raises:
        InputError: neither or both are given, or their number is not that of the files.
    """
    step = read_step_rule(table, per_file)
    if step is not None:
        return tuple(step * i for i in range(len(files)))
    steps = table.wholes("steps")
    if len(steps) != len(files):
        raise table.error("steps", f"{len(steps)} step counts for {len(files)} {what}: give one for each")
    return steps


def read_step_rule(table: Table, per_file: str) -> int | None:
    """The steps from one file to the next where they are given as one number, None where `steps` lists them."""
    if "steps" in table and per_file in table:
        raise table.error("steps", f"{per_file} is given too: keep one of them")
    if "steps" in table:
        return None
    if per_file not in table:
        raise table.error("steps", f"is missing: give the motor step count of each photograph, or {per_file}")
    step = table.motor_steps(per_file, "steps = ")
    if step == 0:
        raise table.error(per_file, "the motor does not move: give the motor steps from one photograph to the next")
    return step


def relative_name(path: Path, folder: Path) -> str:
    """A path as a TOML file in this folder names it: relative where it lies inside."""
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.as_posix()


def write_toml(path: Path, values: Mapping[str, Any]) -> None:
    """Write a TOML file, whole or not at all."""
    with replacing(path, "w") as file:
        file.write(tomli_w.dumps(values))
