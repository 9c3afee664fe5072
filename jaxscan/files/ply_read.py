"""PLY files read as they are: ASCII and both byte orders, any elements, any properties.

Binary records without lists, and with lists that are all of one length, are views of the file's bytes; only where
lengths differ is there a loop over the rows.
"""

import os
import struct
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Final, get_args

import numpy as np
from jaxtyping import Int, Shaped

from jaxscan.errors import InputError
from jaxscan.files.ply import SCALARS, WORDS, Column, Element, Format, Lists, Order, Ply, byte_order
from jaxscan.missing import no_such_file

_FORMATS: Final[dict[str, Format]] = {name: name for name in get_args(Format)}
_LONGEST_LINE, _LONGEST_HEADER = 1 << 12, 1 << 20
_LONGEST_NUMBER: Final = 64


@dataclass(frozen=True)
class _Declared:
    """A property in the header: its type, and that of the lengths where it is a list."""

    name: str
    item: np.dtype
    count: np.dtype | None = None


def read_ply_file(path: str | os.PathLike[str]) -> Ply:
    """Read every element of a PLY file.

    Raises:
        InputError: the file is missing, is no PLY, or holds less or more than its header says.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            form, declared, comments = _read_header(path, file)
            body = np.fromfile(file, np.uint8)
    except FileNotFoundError as error:
        raise no_such_file(Path(path)) from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder: name a PLY file in it") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error
    source = _Words(path, body) if form == "ascii" else _Bytes(path, body, byte_order(form))
    elements = {name: source.element(name, count, properties) for name, (count, properties) in declared.items()}
    source.end()
    return Ply(elements, form, comments)


def _read_header(path: Path, file: IO[bytes]) -> tuple[Format, dict[str, tuple[int, list[_Declared]]], tuple[str, ...]]:
    def bad(problem: str) -> InputError:
        return InputError(f"{path}: {problem}: check which file it is, or write it again")

    if file.readline(_LONGEST_LINE).strip() != b"ply":
        raise bad("is not a PLY file, it does not begin with the line ply")
    form: Format | None = None
    elements: dict[str, tuple[int, list[_Declared]]] = {}
    comments: list[str] = []
    while True:
        raw = file.readline(_LONGEST_LINE)
        if not raw.endswith(b"\n") or file.tell() > _LONGEST_HEADER:
            raise bad("its header does not end with the line end_header")
        line = raw.decode("utf-8", "replace").strip()
        match line.split():
            case ["end_header"]:
                break
            case []:
                continue
            case ["comment" | "obj_info", *_]:
                comments.append(line)
            case ["format", name, "1.0"] if form is None and name in _FORMATS:
                form = _FORMATS[name]
            case ["element", name, number] if number.isdecimal() and name not in elements:
                elements[name] = (int(number), [])
            case ["property", "list", count, item, name] if (
                elements and count in SCALARS and SCALARS[count].kind in "iu" and item in SCALARS
            ):
                _last(elements).append(_Declared(name, SCALARS[item], SCALARS[count]))
            case ["property", item, name] if elements and item in SCALARS:
                _last(elements).append(_Declared(name, SCALARS[item]))
            case _:
                raise bad(f"its header has the line {line[:60]!r}, which is no part of the format")
    if form is None:
        raise bad("its header has no line format")
    for name, (_, properties) in elements.items():
        if len({p.name for p in properties}) < len(properties):
            raise bad(f"element {name} has two properties of one name")
    return form, elements, tuple(comments)


def _last(elements: Mapping[str, tuple[int, list[_Declared]]]) -> list[_Declared]:
    return elements[next(reversed(elements))][1]  # pyright: ignore[reportArgumentType, reportCallIssue]


class _Body:
    """What follows the header, read element by element."""

    def __init__(self, path: Path):
        self.path = path

    def short(self, name: str, count: int) -> InputError:
        return InputError(
            f"{self.path}: its header promises {count} of element {name}, the file ends before: "
            "it is damaged; copy or write it again"
        )

    def negative(self, name: str) -> InputError:
        return InputError(f"{self.path}: element {name} has a list of negative length: copy or write the file again")

    def long(self) -> InputError:
        return InputError(f"{self.path}: more follows than its header promises: it is damaged; copy or write it again")


class _Bytes(_Body):
    """Binary records."""

    def __init__(self, path: Path, body: Shaped[np.ndarray, "bytes"], order: Order):
        super().__init__(path)
        self.order: Order = order
        self.body, self.at = body, 0

    def element(self, name: str, count: int, properties: list[_Declared]) -> Element:
        """The next one."""
        if count and properties:
            lengths = self._lengths_of_first(name, count, properties)
            records = self._records(name, count, properties, lengths)
            if records is None:
                return Element(count, self._row_by_row(name, count, properties))
        else:
            lengths = [0] * len(properties)
            records = np.zeros(0, self._record(properties, lengths))
        columns: dict[str, Column] = {}
        for p in properties:
            values = _native(records[p.name])
            columns[p.name] = values if p.count is None else Lists(_native(records[f"{p.name} count"]), values.ravel())
        return Element(count, columns)

    def end(self) -> None:
        """Nothing may follow."""
        if self.at < len(self.body):
            raise self.long()

    def _record(self, properties: list[_Declared], lengths: list[int]) -> np.dtype:
        """A row whose lists have these lengths."""
        fields: list[tuple] = []
        for p, length in zip(properties, lengths, strict=True):
            if p.count is None:
                fields.append((p.name, p.item.newbyteorder(self.order)))
            else:
                fields.append((f"{p.name} count", p.count.newbyteorder(self.order)))
                fields.append((p.name, p.item.newbyteorder(self.order), (length,)))
        return np.dtype(fields)

    def _lengths_of_first(self, name: str, count: int, properties: list[_Declared]) -> list[int]:
        at, lengths = self.at, []
        for p in properties:
            length = 0
            if p.count is not None:
                length, at = int(self._one(p.count, at, name, count)), at + p.count.itemsize
            lengths.append(length)
            at += p.item.itemsize * (length if p.count is not None else 1)
            if at > len(self.body):
                raise self.short(name, count)
        return lengths

    def _one(self, dtype: np.dtype, at: int, name: str, count: int) -> np.generic:
        if at + dtype.itemsize > len(self.body):
            raise self.short(name, count)
        value = self.body[at : at + dtype.itemsize].view(dtype.newbyteorder(self.order))[0]
        if value < 0:
            raise self.negative(name)
        return value

    def _records(
        self, name: str, count: int, properties: list[_Declared], lengths: list[int]
    ) -> Shaped[np.ndarray, "rows"] | None:
        """All rows at once; None where some list is of another length than in the first."""
        least = sum((p.item if p.count is None else p.count).itemsize for p in properties)
        if self.at + count * least > len(self.body):
            raise self.short(name, count)
        record = self._record(properties, lengths)
        lists = [p.name for p in properties if p.count is not None]
        size = count * record.itemsize
        if self.at + size > len(self.body) and not lists:
            raise self.short(name, count)
        if self.at + size > len(self.body):
            return None
        records = self.body[self.at : self.at + size].view(record)
        for p, length in zip(properties, lengths, strict=True):
            if p.count is not None and not (records[f"{p.name} count"] == length).all():
                return None
        self.at += size
        return records

    def _row_by_row(self, name: str, count: int, properties: list[_Declared]) -> dict[str, Column]:
        starts = self._walk(name, count, properties)
        columns: dict[str, Column] = {}
        for p in properties:
            start, length = next(starts), np.ones(count, np.int64)
            if p.count is not None:
                length = self._gathered(start - p.count.itemsize, p.count).astype(np.int64)
            byte = np.repeat(start, length * p.item.itemsize) + _ramps(length * p.item.itemsize)
            values = _native(self.body[byte].view(p.item.newbyteorder(self.order)))
            columns[p.name] = values if p.count is None else Lists(length.astype(p.count), values)
        return columns

    def _walk(self, name: str, count: int, properties: list[_Declared]) -> Iterator[Int[np.ndarray, "rows"]]:
        """Where the items of each property in turn begin in each row; at the end of the element afterwards.

        Where a row ends is known only once its lists' lengths are read: the one loop over rows that there is.
        """
        # What stands before each list of a row, behind the list before it; the last is what stands behind the last one.
        before, lists = [0], []
        for p in properties:
            if p.count is None:
                before[-1] += p.item.itemsize
            else:
                lists.append((struct.Struct(f"{self.order}{p.count.char}"), p.item.itemsize))
                before.append(0)
        steps = [(ahead, code.unpack_from, code.size, size) for ahead, (code, size) in zip(before, lists, strict=False)]
        behind, data, at = before[-1], self.body.data, self.at
        places = array("q")
        place = places.append
        try:
            if len(lists) == 1 and lists[0][0].size == 1:  # as nearly all files have it, and three times as fast
                (ahead, _, _, size), data = steps[0], self.body.view(lists[0][0].format).data
                for _ in range(count):
                    at += ahead
                    length = data[at]
                    at += 1
                    place(at)
                    at += length * size + behind
                    if length < 0:
                        raise self.negative(name)
            else:
                for _ in range(count):
                    for ahead, unpack, digits, size in steps:
                        at += ahead + digits
                        place(at)
                        (length,) = unpack(data, at - digits)
                        if length < 0:
                            raise self.negative(name)
                        at += length * size
                    at += behind
        except (struct.error, IndexError) as error:
            raise self.short(name, count) from error
        if at > len(self.body):
            raise self.short(name, count)
        self.at = at
        begins = np.frombuffer(places, np.int64).reshape(count, len(steps))
        return self._begins(properties, begins)

    def _begins(
        self, properties: list[_Declared], of_lists: Int[np.ndarray, "rows lists"]
    ) -> Iterator[Int[np.ndarray, "rows"]]:
        """The places of all properties, given those of the lists: scalars stand before or behind one of them."""
        sizes = [p.item.itemsize for p in properties]
        at_lists = [i for i, p in enumerate(properties) if p.count is not None]
        for i, p in enumerate(properties):
            k = next((k for k, j in enumerate(at_lists) if j >= i), None)
            if k is not None:
                head = properties[at_lists[k]].count
                back = 0 if p.count is not None else (head.itemsize if head is not None else 0)
                yield of_lists[:, k] - back - sum(sizes[i : at_lists[k]])
            else:
                last = properties[at_lists[-1]]
                start = of_lists[:, -1]
                length = self._gathered(start - last.count.itemsize, last.count).astype(np.int64)  # pyright: ignore[reportOptionalMemberAccess, reportArgumentType]
                yield start + length * last.item.itemsize + sum(sizes[at_lists[-1] + 1 : i])

    def _gathered(self, at: Int[np.ndarray, "rows"], dtype: np.dtype) -> Shaped[np.ndarray, "rows"]:
        """The numbers of one type that stand at these places."""
        byte = at[:, None] + np.arange(dtype.itemsize)
        return self.body[byte].reshape(-1).view(dtype.newbyteorder(self.order))


class _Words(_Body):
    """Numbers in words, a line for each row.

    What follows the last property on a line is passed over, and a list that a line leaves out at its end is empty: the
    reader that came with the format did so, and files rely on it.
    """

    def __init__(self, path: Path, body: Shaped[np.ndarray, "bytes"]):
        super().__init__(path)
        lines = [words for line in body.tobytes().splitlines() if (words := line.split())]
        words = list(chain.from_iterable(lines))
        try:
            # An array of words has room for the longest in every place.
            if (longest := max(map(len, words), default=0)) > _LONGEST_NUMBER:
                raise ValueError(f"a word of {longest} letters")
            self.numbers = np.array(words, "S").astype(np.float64) if words else np.zeros(0)
        except ValueError as error:
            raise InputError(f"{path}: has something other than numbers after its header: write it again") from error
        self.ends = np.cumsum([0, *map(len, lines)])
        self.line = 0

    def element(self, name: str, count: int, properties: list[_Declared]) -> Element:
        """The next one."""
        if not properties:
            return Element(count)
        ends = self.ends[self.line : self.line + count + 1]
        if len(ends) <= count:
            raise self.short(name, count)
        self.line += count
        columns: dict[str, Column] = {}
        for p, (start, length) in zip(properties, self._places(name, ends, properties), strict=True):
            values = self._cast(name, p.name, self.numbers[np.repeat(start, length) + _ramps(length)], p.item)
            columns[p.name] = values
            if p.count is not None:
                columns[p.name] = Lists(self._cast(name, p.name, length.astype(np.float64), p.count), values)
        return Element(count, columns)

    def end(self) -> None:
        """Nothing may follow."""
        if self.line + 1 < len(self.ends):
            raise self.long()

    def _places(
        self, name: str, ends: Int[np.ndarray, "rows+1"], properties: list[_Declared]
    ) -> list[tuple[Int[np.ndarray, "rows"], Int[np.ndarray, "rows"]]]:
        """Where the items of each property and row begin, and how many there are."""
        at, places = ends[:-1], []
        for p in properties:
            length = np.ones(len(at), np.int64)
            if p.count is not None:
                there = at < ends[1:]
                read = np.where(there, self.numbers[np.where(there, at, 0)] if len(at) else 0.0, 0.0)
                wrong = ~((read >= 0) & (read <= len(self.numbers)) & (read == np.floor(read)))
                if wrong.any():
                    raise InputError(
                        f"{self.path}: a list of property {p.name} of element {name} has the length "
                        f"{read[wrong][0]:g}: write the file again"
                    )
                length, at = read.astype(np.int64), at + there
            places.append((at, length))
            at = at + length
            if (at > ends[1:]).any():
                raise InputError(
                    f"{self.path}: a line of element {name} has fewer numbers than its header promises: "
                    "the file is damaged; copy or write it again"
                )
        return places

    def _cast(
        self, element: str, name: str, values: Shaped[np.ndarray, "items"], dtype: np.dtype
    ) -> Shaped[np.ndarray, "items"]:
        with np.errstate(over="ignore", invalid="ignore"):
            cast = values.astype(dtype)
        if dtype.kind in "iu" and not (cast == values).all():
            raise InputError(
                f"{self.path}: property {name} of element {element} is {WORDS[dtype]}, and "
                f"{values[cast != values][0]:g} is none: write it again"
            )
        return cast


def _native(values: Shaped[np.ndarray, "*any"]) -> Shaped[np.ndarray, "*any"]:
    """The same numbers in this machine's byte order."""
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _ramps(lengths: Int[np.ndarray, "rows"]) -> Int[np.ndarray, "items"]:
    """0, 1, … up to each length, one after the other."""
    ends = np.cumsum(lengths, dtype=np.int64)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - lengths, lengths)
