"""What is printed on a calibration board: dark and light rectangles, and circles, in millimetres.

Coordinates are those of paper: x to the right, y down, the origin at the top left corner of the pattern.
"""

from typing import Final, NamedTuple

import cv2
import numpy as np

from jaxscan.images.board import Board

# Diameter of circles in parts of their pitch, where the board does not say.
_CIRCLES: Final = 0.5


class Rectangle(NamedTuple):
    """A filled rectangle, mm: its top left corner, its size, and whether it is dark."""

    x: float
    y: float
    width: float
    height: float
    dark: bool = True


class Disc(NamedTuple):
    """A dark filled circle, mm: its centre and its radius."""

    x: float
    y: float
    radius: float


Mark = Rectangle | Disc


def pattern_size(board: Board) -> tuple[float, float]:
    """Width and height of what is printed, mm: with the outer squares, or from edge to edge of the circles."""
    columns, rows = board.counts
    beyond = 1.0 if board.kind != "circles" else circle_diameter(board) / board.pitch_mm - 1.0
    return board.pitch_mm * (columns + beyond), board.pitch_mm * (rows + beyond)


def circle_diameter(board: Board) -> float:
    """The diameter of a grid's circles, mm; half their pitch where the board does not say."""
    return board.diameter_mm or _CIRCLES * board.pitch_mm


def board_marks(board: Board) -> list[Mark]:
    """What is printed, in the order in which it is drawn: light lies on dark."""
    columns, rows = board.counts
    pitch = board.pitch_mm
    if board.kind == "circles":
        radius = circle_diameter(board) / 2
        return [Disc(radius + pitch * i, radius + pitch * j, radius) for j in range(rows) for i in range(columns)]
    # The first square is dark; so has OpenCV's pattern of ChArUco boards it from version 4.6 on.
    squares: list[Mark] = [
        Rectangle(pitch * i, pitch * j, pitch, pitch)
        for j in range(rows + 1)
        for i in range(columns + 1)
        if (i + j) % 2 == 0
    ]
    return squares + (_markers(board) if board.kind == "charuco" else [])


def _markers(board: Board) -> list[Mark]:
    """The markers of a ChArUco board: each a dark square, with its light cells on it."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    squares = board.counts[0] + 1, board.counts[1] + 1
    pattern = cv2.aruco.CharucoBoard(squares, float(board.pitch_mm), float(board.marker_mm), dictionary)
    cells = dictionary.markerSize + 2
    cell = board.marker_mm / cells
    marks: list[Mark] = []
    for number, corners in zip(np.ravel(pattern.getIds()), pattern.getObjPoints(), strict=True):
        x, y = (float(value) for value in np.asarray(corners)[0][:2])
        marks.append(Rectangle(x, y, board.marker_mm, board.marker_mm))
        light = dictionary.generateImageMarker(int(number), cells) > 0
        for j, row in enumerate(light):
            # Light cells that touch are one rectangle: no hairline of dark shows between them.
            ends = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
            marks += [
                Rectangle(x + cell * a, y + cell * j, cell * (b - a), cell, dark=False)
                for a, b in zip(ends[::2], ends[1::2], strict=True)
            ]
    return marks
