"""PLY files written: ASCII in the shortest words that read back as the same numbers, and binary in both byte orders."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from tempfile import TemporaryFile
from typing import Final

import numpy as np
from jaxtyping import Int, Shaped

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.ply import WORDS, Element, Format, Lists, Order, Ply, byte_order

# Rows that are packed at a time: they stay in the processor's cache.
_ROWS_AT_ONCE: Final = 1 << 14
_COPIED_AT_ONCE: Final = 1 << 20


def write_ply_file(path: str | os.PathLike[str], content: Ply) -> None:
    """Write a PLY file, whole or not at all.

    Raises:
        InputError: an element's columns differ in length or have a type that PLY has no word for, or the file cannot be
            written.
    """
    elements = [(name, e.count, list(_declarations(path, name, e))) for name, e in content.elements.items()]
    with replacing(path, "wb") as file:
        file.write(_header(content.format, content.comments, elements))
        for element in content.elements.values():
            chunks = _lines(element) if content.format == "ascii" else _packed(element, content.format)
            for chunk in chunks:
                file.write(chunk)


@contextmanager
def writing_ply_file(
    path: str | os.PathLike[str], name: str, comments: Sequence[str] = ()
) -> Iterator[Callable[[Element], None]]:
    """Write a binary PLY file of one element whose rows come some at a time: the block is given what adds them.

    How many there are is said at a file's beginning and known at its end: till then they wait beside it, on the disk.

    Raises:
        InputError: as `write_ply_file`, or later rows have other columns than the first.
    """
    form: Format = "binary_little_endian"
    count, declared = 0, None
    with replacing(path, "wb") as file, TemporaryFile(dir=os.path.dirname(os.path.realpath(path))) as rows:

        def add(element: Element) -> None:
            nonlocal count, declared
            own = list(_declarations(path, name, element))
            if declared not in (None, own):
                raise InputError(f"{path}: rows with {own} cannot follow rows with {declared}: write two files")
            count, declared = count + element.count, own
            for chunk in _packed(element, form):
                rows.write(chunk)

        yield add
        file.write(_header(form, comments, [(name, count, declared or [])]))
        rows.seek(0)
        shutil.copyfileobj(rows, file, _COPIED_AT_ONCE)


def _header(form: Format, comments: Sequence[str], elements: Sequence[tuple[str, int, list[str]]]) -> bytes:
    lines = ["ply", f"format {form} 1.0", *comments]
    for name, count, declarations in elements:
        lines += [f"element {name} {count}", *declarations]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def _declarations(path: str | os.PathLike[str], name: str, element: Element) -> Iterator[str]:
    for key, column in element.columns.items():
        dtypes = [column.counts.dtype, column.values.dtype] if isinstance(column, Lists) else [column.dtype]
        words = [WORDS.get(dtype.newbyteorder("=")) for dtype in dtypes]
        if len(column) != element.count or None in words:
            raise InputError(
                f"{path}: property {key} of element {name} has {len(column)} rows of {dtypes[-1]}; PLY takes "
                f"{element.count} of {', '.join(WORDS.values())}"
            )
        yield " ".join(["property", *(["list"] if len(words) == 2 else []), *map(str, words), key])


def _packed(element: Element, form: Format) -> Iterator[memoryview | bytes]:
    """Binary records, some rows at a time."""
    order = byte_order(form)
    lengths = {name: c.length for name, c in element.columns.items() if isinstance(c, Lists)}
    if not element.count or not element.columns:
        return
    if None in lengths.values():
        yield _packed_row_by_row(element, order)
        return
    fields: list[tuple] = []
    parts: list[tuple[str, Shaped[np.ndarray, "rows ..."]]] = []
    for name, column in element.columns.items():
        if isinstance(column, Lists):
            fields.append((f"{name} count", column.counts.dtype.newbyteorder(order)))
            fields.append((name, column.values.dtype.newbyteorder(order), (lengths[name],)))
            parts += [(f"{name} count", column.counts), (name, column.values.reshape(element.count, -1))]
        else:
            fields.append((name, column.dtype.newbyteorder(order)))
            parts.append((name, column))
    buffer = np.empty(min(element.count, _ROWS_AT_ONCE), np.dtype(fields))
    for start in range(0, element.count, _ROWS_AT_ONCE):
        rows = buffer[: element.count - start]
        for name, values in parts:
            rows[name] = values[start : start + len(rows)]
        yield rows.view(np.uint8).data


def _packed_row_by_row(element: Element, order: Order) -> bytes:
    """Binary records with lists of several lengths."""
    pieces: list[list[bytes]] = []
    for column in element.columns.values():
        if isinstance(column, Lists):
            items = _cut(column.values, order, np.asarray(column.counts, np.int64))
            pieces.append([n + item for n, item in zip(_cut(column.counts, order), items, strict=True)])
        else:
            pieces.append(_cut(column, order))
    return b"".join(piece for row in zip(*pieces, strict=True) for piece in row)


def _cut(
    values: Shaped[np.ndarray, "items"], order: Order, counts: Int[np.ndarray, "rows"] | None = None
) -> list[bytes]:
    """The bytes of each row, which has `counts` items; one item where no counts are given."""
    whole, size = values.astype(values.dtype.newbyteorder(order)).tobytes(), values.dtype.itemsize
    ends = size * np.cumsum(np.ones(len(values), np.int64) if counts is None else counts)
    return [whole[a:b] for a, b in pairwise([0, *ends.tolist()])]


def _lines(element: Element) -> Iterator[bytes]:
    """Rows in words, the shortest that read back as the same numbers."""
    if not element.columns:
        return
    columns: list[list[str]] = []
    for column in element.columns.values():
        if isinstance(column, Lists):
            words, ends = column.values.astype(str).tolist(), np.cumsum(column.counts, dtype=np.int64).tolist()
            starts = [0, *ends][:-1]
            columns.append([" ".join([str(b - a), *words[a:b]]) for a, b in zip(starts, ends, strict=True)])
        else:
            columns.append(column.astype(str).tolist())
    for row in zip(*columns, strict=True):
        yield (" ".join(row) + "\n").encode("ascii")
