"""One table of a TOML or JSON file, read with the types and keys that the format has.

Every value is asked for by key and type, and every error says file, key, value and fix. The keys a table may have are
stated first, so that a mistyped one is reported as what it is and not as the absence of the right one.
"""

import difflib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from jaxscan.errors import InputError

_LONGEST_VALUE_SHOWN = 60
# Whole numbers beyond this are not exact in float64.
_LARGEST_WHOLE: Final = 2**53
# Its square is still a float32.
LARGEST: Final = 1e18


class PassedOverWarning(UserWarning):
    """Something in a file or folder was not understood and was left aside; the text says what."""


@dataclass(frozen=True)
class Table:
    """A table of a file and where it stands there.

    Attributes:
        path: the file.
        prefix: what to put before a key to name it in an error: `[board] ` or `camera.`.
        values: the keys and their values, as the parser gave them.
    """

    path: Path
    prefix: str
    values: Mapping[str, Any]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def error(self, key: str, problem: str) -> InputError:
        """The error for one key: file, key, value (where there is one), and the problem with its fix."""
        shown = f" = {show(self.values[key])}" if key in self.values else ""
        return InputError(f"{self.path}: {self.prefix}{key}{shown}: {problem}")

    def unknown(self, known: Sequence[str]) -> list[str]:
        """The keys that are not among the known ones."""
        return [key for key in self.values if key not in known]

    def only(self, *known: str) -> "Table":
        """The table itself, if it has no other keys than these.

        Raises:
            InputError: it has; the known key that looks most like it is suggested.
        """
        for key in self.unknown(known):
            near = difflib.get_close_matches(key, known, n=1)
            fix = f'did you mean "{near[0]}"?' if near else f"the keys here are {', '.join(known)}"
            raise self.error(key, f"unknown key; {fix}")
        return self

    def table(self, key: str, prefix: str) -> "Table":
        """The table under a key."""
        header = prefix.strip()
        value = self._required(key, f"a table {header}" if header.startswith("[") else "a table")
        if not isinstance(value, dict):
            raise self.error(key, "must be a table")
        return Table(self.path, prefix, value)

    def optional_table(self, key: str, prefix: str) -> "Table":
        """The table under a key, or an empty one where there is no such key."""
        return self.table(key, prefix) if key in self else Table(self.path, prefix, {})

    def tables(self, key: str) -> list["Table"]:
        """The tables under a key, [[key]] in TOML; none where there is no such key. Each is known by its name."""
        values = self.sequence(key, f"tables [[{key}]]") if key in self else []
        for i, value in enumerate(values):
            if not isinstance(value, dict):
                raise self.error(key, f"entry {i} is no table: write [[{key}]] above its lines")
        names = [value.get("name") for value in values]
        named = [f"{name!r}" if isinstance(name, str) and name else str(i + 1) for i, name in enumerate(names)]
        return [Table(self.path, f"[[{key}]] {name} ", value) for name, value in zip(named, values, strict=True)]

    def string(self, key: str, default: str | None = None, choices: Sequence[str] = ()) -> str:
        """A text that is not empty, and one of the choices where there are any."""
        value = self._value(key, default, f"one of {', '.join(choices)}" if choices else "a text in quotes")
        if not isinstance(value, str) or not value:
            raise self.error(key, "must be a text in quotes that is not empty")
        if choices and value not in choices:
            raise self.error(key, f"must be one of {', '.join(choices)}")
        return value

    def boolean(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.values.get(key, default)
        if not isinstance(value, bool):
            raise self.error(key, "must be true or false")
        return value

    def whole(self, key: str) -> int:
        """A whole number."""
        value = self._required(key, "a whole number")
        if not _is_whole(value):
            raise self.error(key, f"must be a whole number{_float_hint(value)}")
        return value

    def motor_steps(self, key: str, listed: str) -> int:
        """A whole number of motor steps from one photograph to the next.

        Args:
            key: where it stands.
            listed: how a list of the steps of all photographs begins.
        """
        value = self._required(key, "a whole number")
        if isinstance(value, float) and math.isfinite(value) and not value.is_integer():
            some = ", ".join(str(round(i * value)) for i in range(4))
            raise self.error(key, f"must be a whole number; where steps differ, list them all: {listed}[{some}, …]")
        return self.whole(key)

    def wholes(self, key: str) -> tuple[int, ...]:
        """A list of whole numbers."""
        for i, value in enumerate(values := self.sequence(key, "whole numbers")):
            if not _is_whole(value):
                raise self.error(key, f"entry {i} is {show(value)}: must be a whole number{_float_hint(value)}")
        return tuple(values)

    def number(self, key: str) -> float:
        """A finite number of at most `LARGEST` either way."""
        value = self._required(key, "a number")
        if not _is_finite(value):
            raise self.error(key, f"must be a finite number{_number_hint(value)}")
        return float(value)

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...]:
        """A list of such numbers, this many where a count is given."""
        values = self.sequence(key, "numbers")
        for i, value in enumerate(values):
            if not _is_finite(value):
                raise self.error(key, f"entry {i} is {show(value)}: must be a finite number{_number_hint(value)}")
        if count is not None and len(values) != count:
            raise self.error(key, f"must hold {count} number{'s' if count != 1 else ''}, it holds {len(values)}")
        return tuple(float(value) for value in values)

    def size(self, key: str) -> tuple[int, int]:
        """Columns and rows, both positive."""
        values = self.wholes(key)
        if len(values) != 2 or min(values) < 1:
            raise self.error(key, "must be two positive whole numbers: columns, rows")
        return values[0], values[1]

    def sequence(self, key: str, of: str) -> list[Any]:
        """A list, whatever is in it; `of` says in errors what should be."""
        value = self._required(key, f"a list of {of}")
        if not isinstance(value, list):
            raise self.error(key, f"must be a list of {of}")
        return value

    def _value(self, key: str, default: Any, expected: str) -> Any:
        return self._required(key, expected) if default is None else self.values.get(key, default)

    def _required(self, key: str, expected: str) -> Any:
        if key not in self.values:
            raise self.error(key, f"is missing: add {expected}")
        return self.values[key]


def show(value: Any) -> str:
    """A value as the file has it, cut where it is long."""
    try:
        text = json.dumps(value, default=str, ensure_ascii=False)
    except (ValueError, RecursionError):  # a whole number of more digits than Python writes, lists without end
        return "a value too long to show"
    return text if len(text) <= _LONGEST_VALUE_SHOWN else f"{text[:_LONGEST_VALUE_SHOWN]}…"


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _LARGEST_WHOLE


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= LARGEST


def _number_hint(value: Any) -> str:
    if isinstance(value, str):
        return " (no quotes, and a point before decimals)"
    too_large = isinstance(value, int | float) and LARGEST < abs(value) < math.inf
    return f" of at most {LARGEST:g} either way" if too_large else ""


def _float_hint(value: Any) -> str:
    if isinstance(value, int) and not isinstance(value, bool):
        return f" of at most {_LARGEST_WHOLE} either way"
    if isinstance(value, float) and value.is_integer() and abs(value) <= _LARGEST_WHOLE:
        return f": write {int(value)}"
    return " (no fraction, no quotes)"
