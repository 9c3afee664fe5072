"""The calibration board: what is printed on it, and where its points are.

The points are the inner corners of a checkerboard or ChArUco board, or the centres of a grid of circles, counted row by
row from the first one, which is the origin of the board frame: x along the columns, y along the rows, z = x × y, away
from a camera that sees the board's front. So on a photograph the turn from x to y is clockwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError

# OpenCV's finders need a grid of three by three.
LEAST_POINTS = 3
# From what a line of light is thick to a hundred metres: what lies outside was written in other units.
_LENGTHS_MM = (0.1, 1e5)


@dataclass(frozen=True)
class Board:
    """A calibration board; made by `checkerboard`, `circles` or `charuco`, which check what they are given.

    Attributes:
        kind: what its points are.
        counts: columns and rows of points.
        pitch_mm: distance between neighbouring points, mm.
        marker_mm: side of a ChArUco board's markers, mm; 0 for the others.
        dictionary: name of OpenCV's dictionary of markers; empty for the others.
        diameter_mm: of circles, mm; 0 where it is to be measured in the photographs, and for the others.
    """

    kind: Literal["checkerboard", "circles", "charuco"]
    counts: tuple[int, int]
    pitch_mm: float
    marker_mm: float = 0.0
    dictionary: str = ""
    diameter_mm: float = 0.0

    @staticmethod
    def checkerboard(inner_corners: Sequence[int], square_mm: float) -> "Board":
        """A checkerboard, from its numbers of inner corners in a row and in a column.

        Raises:
            InputError: not two whole numbers of 3 or more, or a size that is not positive.
        """
        counts = _counts("inner_corners", inner_corners, LEAST_POINTS)
        return Board("checkerboard", counts, _length("square_mm", square_mm))

    @staticmethod
    def circles(circles: Sequence[int], pitch_mm: float, diameter_mm: float | None = None) -> "Board":
        """A rectangular grid of circles, from its numbers in a row and in a column; their diameter where it is known.

        Raises:
            InputError: as `checkerboard`; circles that touch each other.
        """
        counts, pitch = _counts("circles", circles, LEAST_POINTS), _length("pitch_mm", pitch_mm)
        if diameter_mm is None:
            return Board("circles", counts, pitch)
        diameter = _length("diameter_mm", diameter_mm)
        if diameter >= pitch:
            raise InputError(
                f"diameter_mm = {diameter}: circles {pitch} mm apart would touch: measure one across, or leave it out"
            )
        return Board("circles", counts, pitch, diameter_mm=diameter)

    @staticmethod
    def charuco(squares: Sequence[int], square_mm: float, marker_mm: float, dictionary: str) -> "Board":
        """A ChArUco board, from its numbers of *squares* in a row and in a column, as in OpenCV 4.6 and later.

        Raises:
            InputError: as `checkerboard`; a marker no smaller than its square; a dictionary that OpenCV does not have
                or that has too few markers.
        """
        columns, rows = _counts("squares", squares, LEAST_POINTS)
        square, marker = _length("square_mm", square_mm), _length("marker_mm", marker_mm)
        if marker >= square:
            raise InputError(f"marker_mm = {marker}: a marker stands inside a square of {square} mm: measure it again")
        known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        if dictionary not in known:
            raise InputError(f'dictionary = "{dictionary}": there is none of this name: use one of {", ".join(known)}')
        size = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)
        if columns * rows // 2 > size:
            raise InputError(
                f'dictionary = "{dictionary}": it has {size} markers, '
                f"a board of {columns} x {rows} squares needs {columns * rows // 2}: name the one that was printed"
            )
        return Board("charuco", (columns - 1, rows - 1), square, marker, dictionary)

    def points(self) -> Float[np.ndarray, "points 3"]:
        """The points in the board frame, mm: row by row, x fastest, z = 0."""
        columns, rows = self.counts
        y, x = np.mgrid[:rows, :columns]
        return self.pitch_mm * np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float64)

    @property
    def half_turn_ambiguous(self) -> bool:
        """Whether the board looks the same after half a turn, so that one photograph does not show which end is which.

        A half turn changes the colours of a checkerboard only where exactly one of the counts is even.
        """
        if self.kind == "checkerboard":
            return sum(self.counts) % 2 == 0
        return self.kind == "circles"


def _counts(key: str, value: Sequence[int], least: int) -> tuple[int, int]:
    whole = len(value) == 2 and all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in value)
    if not whole or min(value) < least:
        raise InputError(
            f"{key} = {list(value)}: give two whole numbers, in a row and in a column, each {least} or more"
        )
    return int(value[0]), int(value[1])


def _length(key: str, value: float) -> float:
    least, most = _LENGTHS_MM
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        metres = isinstance(value, float) and least <= 1000 * value <= most
        meant = f"; {value:g} m are {1000 * value:g}" if metres else ""
        raise InputError(f"{key} = {value}: give a positive number of millimetres, from {least:g} to {most:g}{meant}")
    return float(value)
