"""The floor that an object stood on, as a note in the file of its mesh: the mesh itself has no floor any more.

It stands in the 80 bytes before the triangles of an STL, and in a comment of PLY and OBJ: `floor a b c d`. At a point
(x, y, z) of the file the height over the floor is a x + b y + c z + d (mm), and (a, b, c) is a unit vector, up.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

# Bytes before the triangles of an STL. One that begins with "solid" would be taken for text.
_STL_HEADER: Final = 80
# How much of an OBJ is looked at: the note is its first line.
_OBJ_START: Final = 200
_NUMBER: Final = r"(-?\d+\.?\d*(?:e-?\d+)?)"
_NOTE: Final = re.compile(rf"\bfloor {_NUMBER} {_NUMBER} {_NUMBER} {_NUMBER}")


class FloorNote(NamedTuple):
    """A floor in the frame of a file.

    Attributes:
        up: its unit normal.
        offset_mm: the height of the frame's origin over it.
    """

    up: Float[np.ndarray, "3"]
    offset_mm: float

    def height(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
        """How far points are above the floor, mm."""
        return points @ self.up + self.offset_mm

    def words(self) -> str:
        """The note as it is written: at most 80 bytes with what stands before it in an STL."""
        return "floor " + " ".join(f"{number:.7f}" for number in self.up) + f" {self.offset_mm:.4f}"


def stl_with_floor(content: bytes, floor: FloorNote) -> bytes:
    """A binary STL with the note in its header."""
    return f"jaxscan, mm, {floor.words()}".encode().ljust(_STL_HEADER)[:_STL_HEADER] + content[_STL_HEADER:]


def floor_of_lines(lines: Iterable[str]) -> FloorNote | None:
    """The floor that one of some comments notes; None where none does, or what it notes is no floor."""
    for found in filter(None, map(_NOTE.search, lines)):
        numbers = np.array([float(number) for number in found.groups()])
        length = float(np.linalg.norm(numbers[:3]))
        if np.isfinite(numbers).all() and abs(length - 1) < 1e-3:
            return FloorNote(numbers[:3] / length, float(numbers[3]))
    return None


def floor_of_file(path: Path) -> FloorNote | None:
    """The floor that an STL or an OBJ notes."""
    length = {".stl": _STL_HEADER, ".obj": _OBJ_START}.get(path.suffix.lower(), 0)
    with path.open("rb") as file:
        return floor_of_lines([file.read(length).decode("latin-1")])
