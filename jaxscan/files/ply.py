"""What a PLY file holds: any elements, any properties, lists (G. Turk, The PLY Polygon File Format, 1994).

An element is a table: a column for each property, and for a list property the lists' lengths and their items one after
the other. `ply_read` and `ply_write` are its reader and its writer.
"""

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from jaxtyping import Int, Shaped

Format = Literal["ascii", "binary_little_endian", "binary_big_endian"]
Order = Literal["<", ">"]

SCALARS: Final = {
    **dict.fromkeys(("char", "int8"), np.dtype("i1")),
    **dict.fromkeys(("uchar", "uint8"), np.dtype("u1")),
    **dict.fromkeys(("short", "int16"), np.dtype("i2")),
    **dict.fromkeys(("ushort", "uint16"), np.dtype("u2")),
    **dict.fromkeys(("int", "int32"), np.dtype("i4")),
    **dict.fromkeys(("uint", "uint32"), np.dtype("u4")),
    **dict.fromkeys(("float", "float32"), np.dtype("f4")),
    **dict.fromkeys(("double", "float64"), np.dtype("f8")),
}
# The older of the two names of each type: what every reader knows.
WORDS: Final = {dtype: word for word, dtype in reversed(SCALARS.items()) if not word[-1].isdigit()}


@dataclass(frozen=True)
class Lists:
    """A list for each row.

    Attributes:
        counts: the length of each, in the type that the file has for it.
        values: the items of all of them, one after the other.
    """

    counts: Int[np.ndarray, "rows"]
    values: Shaped[np.ndarray, "items"]

    @classmethod
    def equal(cls, rows: Shaped[np.ndarray, "rows length"], count: np.dtype | type = np.uint8) -> "Lists":
        """Lists of one length, each a row."""
        return cls(np.full(len(rows), rows.shape[1], count), rows.reshape(-1))

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def length(self) -> int | None:
        """The length, where all have one."""
        first = int(self.counts[0]) if len(self.counts) else 0
        return first if (self.counts == first).all() else None


Column = Shaped[np.ndarray, "rows"] | Lists


@dataclass(frozen=True)
class Element:
    """One table of a file.

    Attributes:
        count: how many rows.
        columns: by name, in the file's order.
    """

    count: int
    columns: dict[str, Column] = field(default_factory=dict)


@dataclass(frozen=True)
class Ply:
    """What a PLY file holds.

    Attributes:
        elements: by name, in the file's order.
        format: how it is written.
        comments: whole lines, `comment …` and `obj_info …`.
    """

    elements: dict[str, Element]
    format: Format = "binary_little_endian"
    comments: tuple[str, ...] = ()


def byte_order(form: Format) -> Order:
    """The byte order of a binary format, as NumPy writes it."""
    return "<" if form == "binary_little_endian" else ">"
