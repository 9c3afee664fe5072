"""Opening what a person or a program wrote: a TOML or a JSON file as its outermost table."""

import json
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from jaxscan.errors import InputError
from jaxscan.files.kinds import kind_in_words
from jaxscan.files.table import Table, show
from jaxscan.missing import no_such_file

# A list of a hundred thousand photographs has three million letters.
_LONGEST: Final = 8 << 20


def read_toml(path: Path, wanted: str = "another file") -> Table:
    """The outermost table of a TOML file.

    Args:
        path: the file.
        wanted: which file is to be named in place of one that is none, in words.

    Raises:
        InputError: the file is missing, not text, or not TOML; the text says where.
    """
    return Table(path, "", parse_file(path, "TOML", tomllib.loads, wanted))


def read_json(path: Path, wanted: str = "another file") -> Table:
    """The outermost table of a JSON file, in which no key appears twice; `wanted` as `read_toml` has it.

    Raises:
        InputError: the file is missing, not text, not JSON, or not an object; the text says where.
    """
    values = read_json_value(path, wanted)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds {show(values)}, but an object in braces is expected")
    return Table(path, "", values)


def read_json_value(path: Path, wanted: str = "another file") -> Any:
    """What a JSON file holds: an object, in which no key appears twice, a list, or whatever it is; `wanted` as above.

    Raises:
        InputError: the file is missing, not text, or not JSON; the text says where.
    """

    def parse(text: str) -> Any:
        return json.loads(text, object_pairs_hook=lambda pairs: _without_twins(path, pairs))

    return parse_file(path, "JSON", parse, wanted)


def parse_file(path: Path, kind: str, parse: Callable[[str], Any], wanted: str = "another file") -> Any:
    """What `parse` makes of a text file of some kind; a `ValueError` of its own says what is wrong with the text.

    Where the file is of another kind, a photograph for one, that is said in place of where the text goes wrong.

    Raises:
        InputError: the file is missing, empty, not text, or not of its kind; the text says where.
    """
    text = read_text(path, kind, wanted)
    try:
        return parse(text)
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply to be read as {kind}: write it again") from error
    except ValueError as error:  # the parsers' own errors, which name line and column, and numbers without end
        _refuse_other_kind(path, kind, wanted)
        raise InputError(f"{path}: is not valid {kind}: {error}: correct it there, or name {wanted}") from error


def read_text(path: Path, kind: str, wanted: str = "another file", longest: int = _LONGEST) -> str:
    """The text of a file of some kind.

    Args:
        path: the file.
        kind: what it should be, for errors: "TOML".
        wanted: what to name in its place, for errors.
        longest: it may have this number of letters.

    Raises:
        InputError: the file is missing, empty, longer, or not text.
    """
    try:
        # utf-8-sig: editors on Windows put a byte order mark before the text. Newlines come out plain.
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(longest + 1)
    except FileNotFoundError as error:
        raise no_such_file(Path(path)) from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder, but a {kind} file is expected: name the file in it") from error
    except UnicodeDecodeError as error:
        _refuse_other_kind(path, kind, wanted)
        raise InputError(
            f"{path}: is not text (byte {error.start}), but a {kind} file is expected: "
            f"save it as UTF-8, or name {wanted}"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error
    if len(text) > longest:
        _refuse_other_kind(path, kind, wanted)
        raise InputError(f"{path}: is longer than {longest >> 20} million letters, as no {kind} file is: name {wanted}")
    if not text.strip():
        raise InputError(f"{path}: is empty, but a {kind} file is expected: write it again")
    return text


def _refuse_other_kind(path: Path, kind: str, wanted: str) -> None:
    """Say what the file is, where that is known and is not what was expected."""
    expected, found = f"a {kind} file", kind_in_words(path)
    if found not in ("", expected):
        raise InputError(f"{path}: is {found}, but {expected} is expected: name {wanted}")


def _without_twins(path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        twin = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        raise InputError(f'{path}: the key "{twin}" appears twice in one object: keep one of them')
    return values
