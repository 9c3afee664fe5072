"""Readers that are broken, each in the way of its name: what the fuzzer must see."""

import os
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import InputError


def _foreign(path: Path) -> None:
    if path.read_bytes() != b"seed":
        raise KeyError("x")


def _warns(path: Path) -> None:
    warnings.warn("of a library, which knows no file", RuntimeWarning, stacklevel=1)


def _own_warning(path: Path) -> None:
    warnings.warn(f"{path}: passed over something", UserWarning, stacklevel=1)


def _nameless(path: Path) -> None:
    raise InputError("something is wrong somewhere")


def _slow(path: Path) -> None:
    start = time.process_time()
    while time.process_time() < start + 2:
        pass


def _hangs(path: Path) -> None:
    time.sleep(60)


def _hungry(path: Path) -> None:
    np.ones(170_000_000)
    raise InputError(f"{path}: refused, but too late")


def _ends(path: Path) -> None:
    os.abort()


def _good(path: Path) -> None:
    raise InputError(f"{path}: refused")


READERS: dict[str, Any] = {
    "foreign": _foreign,
    "warns": _warns,
    "own warning": _own_warning,
    "nameless": _nameless,
    "slow": _slow,
    "hangs": _hangs,
    "hungry": _hungry,
    "ends": _ends,
    "good": _good,
}
