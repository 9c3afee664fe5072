"""Arrays in NumPy's own formats, read by their headers first: nothing is allocated before the file is seen to hold it.

NumPy's own reader evaluates the header as Python and allocates what it promises: a header that was cut off, or one of
some terabytes, ends in whatever error comes first. Here a header is three fields, and an array has plain numbers.

Source: NumPy, "A simple file format for NumPy arrays" (NEP 1).
"""

import math
import os
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

import numpy as np
from jaxtyping import Shaped

from jaxscan.errors import InputError
from jaxscan.foreign import foreign
from jaxscan.missing import no_such_file

NPY_START: Final = b"\x93NUMPY"
_LONGEST_HEADER: Final = 1 << 16
_MOST_AXES: Final = 32
_MOST_BYTES: Final = 1 << 62
_READ_AT_ONCE: Final = 1 << 20
_KIND: Final = re.compile(r"'descr'\s*:\s*'([<>|=]?[biufc][0-9]{1,2})'")
_FORTRAN: Final = re.compile(r"'fortran_order'\s*:\s*(True|False)")
_SHAPE: Final = re.compile(r"'shape'\s*:\s*\(([0-9L,\s]*)\)")
_AGAIN: Final = "copy or write it again"


@dataclass(frozen=True)
class NpyHeader:
    """What an array says of itself before its numbers begin.

    Attributes:
        dtype: of each number.
        shape: how many there are along each axis.
        by_columns: whether the first axis runs fastest.
    """

    dtype: np.dtype
    shape: tuple[int, ...]
    by_columns: bool

    @property
    def n_bytes(self) -> int:
        """Size of all its numbers, bytes."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(name: str, file: IO[bytes]) -> NpyHeader:
    """The header of an array; the file then stands at its numbers.

    Args:
        name: of the array, for errors: "a.npy: " stands before them.
        file: at its beginning.

    Raises:
        InputError: it is none, or not of plain numbers.
    """
    start = file.read(8)
    if len(start) < 8 or not start.startswith(NPY_START):
        raise InputError(f"{name}: is no NumPy array: {_AGAIN}")
    if start[6] not in (1, 2, 3):
        raise InputError(f"{name}: is a NumPy array of format {start[6]}, not of 1 to 3: save it with numpy.save")
    digits = 2 if start[6] == 1 else 4
    length = int.from_bytes(file.read(digits), "little")
    raw = file.read(length) if length <= _LONGEST_HEADER else b""
    if len(raw) < length or not length:
        raise InputError(f"{name}: is no whole NumPy array, its header is cut off: {_AGAIN}")
    text = raw.decode("latin1")
    kind, fortran, shape = (field.search(text) for field in (_KIND, _FORTRAN, _SHAPE))
    if kind is None or fortran is None or shape is None:
        raise InputError(f"{name}: is no NumPy array of plain numbers: its header is {text[:80].strip()!r}: {_AGAIN}")
    try:
        dtype = np.dtype(kind[1])
        axes = tuple(int(word.strip(" \n\tL")) for word in shape[1].split(",") if word.strip())
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: its header has numbers that are none ({error}): {_AGAIN}") from error
    # NumPy's own limits, which hold for arrays without numbers too.
    if len(axes) > _MOST_AXES or math.prod(max(axis, 1) for axis in axes) * dtype.itemsize > _MOST_BYTES:
        raise InputError(f"{name}: its header has a shape that no array has, {text[:80].strip()!r}: {_AGAIN}")
    return NpyHeader(dtype, axes, fortran[1] == "True")


def read_npy(name: str, file: IO[bytes], header: NpyHeader, there: int) -> Shaped[np.ndarray, "*shape"]:
    """The numbers of an array.

    Args:
        name: of the array, for errors.
        file: behind its header.
        header: of the array.
        there: how many bytes follow, as far as is known before they are read.

    Raises:
        InputError: they are fewer than the header promises.
    """
    if header.n_bytes > there:
        raise InputError(
            f"{name}: is no whole NumPy array: its header promises {header.n_bytes} bytes, {there} follow: {_AGAIN}"
        )
    values = np.empty(math.prod(header.shape), header.dtype)
    rest = values.view(np.uint8).data
    while rest:
        piece = file.read(min(len(rest), _READ_AT_ONCE))
        if not piece:
            raise InputError(f"{name}: is no whole NumPy array, {len(rest)} bytes are missing at its end: {_AGAIN}")
        rest[: len(piece)] = piece
        rest = rest[len(piece) :]
    native = values.astype(header.dtype.newbyteorder("="), copy=False)
    return native.reshape(header.shape, order="F" if header.by_columns else "C")


def read_npz(
    path: str | os.PathLike[str],
    wanted: Callable[[str], bool],
    check: Callable[[Mapping[str, NpyHeader]], None] = lambda headers: None,
) -> dict[str, Shaped[np.ndarray, "*shape"]]:
    """Arrays of an NPZ file by their names.

    Args:
        path: the file.
        wanted: which of the names.
        check: is given the headers of all of them, before any number is read.

    Raises:
        InputError: the file is missing, is no whole NPZ file, or a wanted member of it is no array.
    """
    path = Path(path)
    try:
        file = path.open("rb")
    except FileNotFoundError as error:
        raise no_such_file(Path(path)) from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder: name an .npz file in it") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error
    # What zipfile and its decompressors raise is for each method of packing another.
    with file, foreign(path, "is not a whole NPZ file", _AGAIN), zipfile.ZipFile(file) as archive:
        names = {name: member for member in archive.namelist() if wanted(name := member.removesuffix(".npy"))}
        headers = {}
        for name, member in names.items():
            with archive.open(member) as opened:
                headers[name] = read_npy_header(f'{path}: "{name}"', opened)
        check(headers)
        arrays = {}
        for name, member in names.items():
            with archive.open(member) as opened:
                header = read_npy_header(f'{path}: "{name}"', opened)
                there = archive.getinfo(member).file_size - opened.tell()
                arrays[name] = read_npy(f'{path}: "{name}"', opened, header, there)
        return arrays
