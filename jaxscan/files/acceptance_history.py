"""The history of a scanner's tests: a line of JSON for each, which is only ever added to.

A test is added by writing the file again beside itself and renaming it into place, so that it is there whole or not at
all, and two programs that add at once are kept apart by a lock.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.exclusive import exclusive
from jaxscan.files.table import Table

FORMAT: Final = "jaxscan-acceptance/1"
_LONGEST: Final = 64 << 20


def read_history(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """All tests, the oldest first.

    Raises:
        InputError: the file is missing, too large, or holds a line that is no test.
    """
    file = Path(path)
    try:
        if file.stat().st_size > _LONGEST:
            raise InputError(f"{path}: is larger than {_LONGEST >> 20} MiB, too large for a history: check the name")
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such history: test with --history {path}, which begins it") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: name the file that --history wrote") from error
    return [_test(file, number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]


def add_to_history(path: str | os.PathLike[str], test: Mapping[str, Any]) -> None:
    """Add a test; whatever stands in the file stays as it is, to the byte.

    Raises:
        InputError: what stands there is no history, or it cannot be written.
    """
    file = Path(path)
    with exclusive(file.with_name(f".{file.name}.lock"), str(path)):
        before = ""
        if file.exists():
            read_history(file)
            before = file.read_text(encoding="utf-8")
        end = "\n" if before and not before.endswith("\n") else ""
        line = json.dumps({"format": FORMAT, **test}, ensure_ascii=False, allow_nan=False)
        with replacing(file, "w") as opened:
            opened.write(f"{before}{end}{line}\n")


def _test(path: Path, number: int, line: str) -> dict[str, Any]:
    where = f"{path}: line {number}"
    try:
        values = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: is no JSON: name the file that --history wrote, or take the line out") from error
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(f"{where}: is no {FORMAT}: name the file that --history wrote")
    table = Table(path, f"line {number}: ", values)
    for key in ("date", "artefact", "certificate"):
        table.string(key)
    for i, value in enumerate(table.sequence("figures", "figures")):
        if not isinstance(value, dict):
            raise table.error("figures", f"entry {i} is no table")
        figure = Table(path, f"line {number}: figures {i}: ", value)
        for key in ("figure", "of"):
            figure.string(key)
        for key in ("mean", "worst", "uncertainty", "scans"):
            figure.number(key)
        for key in ("sigma", "sigma_rig"):
            if value.get(key) is not None:
                figure.number(key)
    return values
