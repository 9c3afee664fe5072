"""Opening what a person or a program wrote: a TOML or a JSON file as its outermost table."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxscan.errors import InputError
from jaxscan.files.table import Table, show


def read_toml(path: Path) -> Table:
    """The outermost table of a TOML file.

    Raises:
        InputError: the file is missing, not text, or not TOML; the text says where.
    """
    return Table(path, "", parse_file(path, "TOML", tomllib.loads))


def read_json(path: Path) -> Table:
    """The outermost table of a JSON file, in which no key stands twice.

    Raises:
        InputError: the file is missing, not text, not JSON, or not an object; the text says where.
    """
    values = read_json_value(path)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds {show(values)}, but an object in braces is expected")
    return Table(path, "", values)


def read_json_value(path: Path) -> Any:
    """What a JSON file holds: an object, in which no key stands twice, a list, or whatever it is.

    Raises:
        InputError: the file is missing, not text, or not JSON; the text says where.
    """

    def parse(text: str) -> Any:
        return json.loads(text, object_pairs_hook=lambda pairs: _without_twins(path, pairs))

    return parse_file(path, "JSON", parse)


def parse_file(path: Path, kind: str, parse: Callable[[str], Any]) -> Any:
    """What `parse` makes of a text file of some kind; a `ValueError` of its own says what is wrong with the text.

    Raises:
        InputError: the file is missing, empty, not text, or not of its kind; the text says where.
    """
    try:
        # utf-8-sig: editors on Windows put a byte order mark before the text. Newlines come out plain.
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file: check the path") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder, but a {kind} file is expected: name the file in it") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not text (byte {error.start}), but a {kind} file is expected: "
            "save it as UTF-8, or name another file"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error
    if not text.strip():
        raise InputError(f"{path}: is empty, but a {kind} file is expected: write it again")
    try:
        return parse(text)
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply to be read as {kind}: write it again") from error
    except ValueError as error:  # the parsers' own errors, which name line and column, and numbers without end
        raise InputError(f"{path}: is not valid {kind}: {error}: correct it there, or name another file") from error


def _without_twins(path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        keys = [key for key, _ in pairs]
        twin = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f'{path}: the key "{twin}" stands twice in one object: keep one of them')
    return values
