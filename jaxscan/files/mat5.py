"""Matrices of real numbers in a Matlab file of version 5, 6 or 7, as `save` has written since 1997.

A header of 128 bytes, then one element for each variable: a tag (type, length), and in it flags, dimensions, name and
numbers, each an element with a tag of its own, padded to 8 bytes; from version 7 on each variable is deflated. Numbers
are stored in the smallest type that holds them, column by column.

SciPy writes these files here but does not read them: a damaged type number makes its reader crash the process.

Source: The MathWorks, "MAT-File Format".
"""

import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from jaxscan.errors import InputError
from jaxscan.missing import no_such_file

_HEADER: Final = 128
_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _DEFLATED = 14, 15
# Classes of arrays: double, single, and the whole numbers from 8 to 64 bits.
_NUMERIC: Final = range(6, 16)
_COMPLEX: Final = 0x0800
# All variables together that we read come nowhere near this; a few bytes can inflate to gigabytes.
_LARGEST: Final = 1 << 26


class _DamagedError(Exception):
    """The bytes do not follow the format."""


def read_matrices(path: Path, wanted: re.Pattern[str]) -> dict[str, Float64[np.ndarray, "rows columns"]]:
    """The variables whose names match a pattern, as float64.

    Raises:
        InputError: the file is missing, is no such file, is damaged, or a variable is no matrix of real numbers.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise no_such_file(Path(path)) from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder, but a .mat file is expected: name the file in it") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error
    if data[:10] == b"MATLAB 7.3" or data[512:516] == b"\x89HDF":
        raise InputError(f"{path}: is a Matlab file of version 7.3: save it with -v7 or -v6")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        raise InputError(f"{path}: is no Matlab file of version 5 to 7: save it in Matlab or Octave with -v7")
    found: dict[str, np.ndarray] = {}
    inflated = 0
    try:
        for kind, body in _elements(data[_HEADER:], order):
            if kind == _DEFLATED:
                body = _inflated(body, order, _LARGEST - inflated)
                inflated += len(body)
            name, matrix = _variable(body, order, wanted)
            if wanted.fullmatch(name):
                if matrix is None:
                    raise InputError(f"{path}: {name} is not a matrix of real numbers: check which program wrote it")
                found[name] = matrix
    except (_DamagedError, struct.error, zlib.error, ValueError) as error:
        raise InputError(f"{path}: is damaged ({error}): copy it again, or save it in Matlab with -v7") from error
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of each element."""
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        start = at + 8
        if kind >> 16:  # up to four bytes, in the tag itself
            kind, length, start = kind & 0xFFFF, kind >> 16, at + 4
        if start + length > len(data) or (start == at + 4 and length > 4):
            raise _DamagedError(f"an element of {length} bytes goes beyond the end")
        yield kind, data[start : start + length]
        at = start + length
        at += 0 if kind == _DEFLATED else -at % 8


def _inflated(data: bytes, order: str, most: int) -> bytes:
    stream = zlib.decompressobj()
    whole = stream.decompress(data, max(most, 1))
    if stream.unconsumed_tail:
        raise _DamagedError(f"its variables unfold to more than {_LARGEST} bytes")
    kind, body = next(_elements(whole, order), (0, b""))
    if kind != _MATRIX:
        raise _DamagedError("a variable is no array")
    return body


def _variable(body: bytes, order: str, wanted: re.Pattern[str]) -> tuple[str, np.ndarray | None]:
    """Name and values of a variable; no values where it is not wanted, or is no matrix of real numbers."""
    parts = _elements(body, order)
    head = [next(parts, (0, b"")) for _ in range(3)]
    (_, flags), (_, dimensions), (_, name) = head
    if len(flags) < 4 or len(dimensions) % 4:
        raise _DamagedError("a variable has no flags or dimensions")
    text = name.decode("ascii", "replace")
    (flag,) = struct.unpack_from(f"{order}I", flags)
    shape = np.frombuffer(dimensions, f"{order}i4")
    if not wanted.fullmatch(text) or (flag & 0xFF) not in _NUMERIC or flag & _COMPLEX or len(shape) != 2:
        return text, None
    kind, numbers = next(parts, (0, b""))
    if kind not in _TYPES:
        raise _DamagedError(f"{text} holds numbers of the type {kind}, which does not exist")
    values = np.frombuffer(numbers, order + _TYPES[kind]).astype(np.float64)
    if shape.min() < 0 or int(shape[0]) * int(shape[1]) != values.size:
        raise _DamagedError(f"{text} holds {values.size} numbers for {shape[0]} × {shape[1]}")
    return text, values.reshape(shape, order="F")
