"""Finding the board in a photograph.

The finders of OpenCV are given the photograph at several sizes and in several normalisations, cheapest first, because
each misses boards that another finds: a board that is too large for its morphology at full size, or so dark beside a
burnt-out laser stripe that a global threshold does not see it. What is found is refined at full size.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt, UInt8

from jaxscan.errors import InputError
from jaxscan.images.board import Board
from jaxscan.images.circles import find_circles, radius_in_pitches, refine_circles
from jaxscan.images.decode import Image, eight_bits, to_grey
from jaxscan.images.order import order_grid
from jaxscan.images.refine import refine_corners

Grey = UInt[np.ndarray, "rows columns"]
Grey8 = UInt8[np.ndarray, "rows columns"]
# Roughly, to a pixel or two, where a board's points are, row by row.
Points = Float[np.ndarray, "points 2"]

# Longer sides, in pixels, at which the board is looked for. Few boards fill so little of a large photograph that more
# is needed, and the search costs its area.
_SIDES = (640, 1280, 2560)
# Levels up to these percentiles are spread over 8 bits: the first leaves out a laser stripe and its halo, the second
# serves a small light board on a dark ground.
_WHITE_PERCENTILES = (90.0, 99.5)
_BLACK_PERCENTILE = 1
# Local levels are compared over this part of the longer side.
_NEIGHBOURHOOD = 1 / 12
# A stripe is taken away before a board is looked for if it is narrower than this part of the longer side: 9 of 640 px.
_LINE = 70
# Four points fix a pose; with fewer a view says nothing.
_LEAST_SEEN = 4


@dataclass(frozen=True)
class BoardView:
    """A board as one photograph shows it.

    Attributes:
        corners: its points in the order of `Board.points`, pixels (u, v); NaN where one was not seen, or is covered.
        sigma: of each corner along an axis, px, from its patch of the photograph; NaN where the corner is.
            None for circles.
        ambiguous: whether half a turn of the board would fit the photograph as well.
        radius: of circles as they are seen, in pitches; None for corners.
    """

    corners: Float[np.ndarray, "points 2"]
    sigma: Float[np.ndarray, "points"] | None
    ambiguous: bool
    radius: float | None = None


def find_board(board: Board, image: Image) -> BoardView | None:
    """The board's points in a photograph; None when the board is not in it.

    Args:
        board: the pattern.
        image: (rows, columns), or (rows, columns, 3) with red, green and blue; 8 or 16 bits.

    Raises:
        InputError: the array is not a photograph.
    """
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise InputError(
            f"the photograph has the shape {image.shape} and numbers of {image.dtype}: give (rows, columns) or (rows, "
            "columns, 3), uint8 or uint16"
        )
    grey = to_grey(image)
    if min(grey.shape) < 2 * max(board.counts):
        return None
    found = _found(board, grey)
    if found is None:
        return None
    columns, rows = board.counts
    grid = found.reshape(rows, columns, 2)
    if board.kind == "circles":
        circles = refine_circles(grey, grid)
        corners, sigma, radius = circles[..., :2], None, radius_in_pitches(circles)
    else:
        # Nearer than its margin, a marker brings edges of its own into a corner's window.
        clear = (1 - board.marker_mm / board.pitch_mm) / 2 if board.kind == "charuco" else 1.0
        corners, sigma = refine_corners(image, grid, clear)
        sigma, radius = sigma.ravel(), None
    corners = corners.reshape(-1, 2)
    if np.isfinite(corners[:, 0]).sum() < _LEAST_SEEN:
        return None
    return BoardView(corners, sigma, board.half_turn_ambiguous, radius)


def shows_checkerboard(counts: tuple[int, int], image: Image) -> bool:
    """Whether a checkerboard with these numbers of inner corners is in the photograph."""
    return _find_checkerboard(counts, to_grey(image)) is not None


def _found(board: Board, grey: Grey) -> Points | None:
    """The board's points in their order, before any is left out for a stripe or a highlight: the order needs them all.

    Markers number the points of a ChArUco board, of which some may be missing.
    """
    if board.kind == "charuco":
        return _find_charuco(board, grey)
    found = (_find_circles if board.kind == "circles" else _find_checkerboard)(board.counts, grey)
    return None if found is None else order_grid(board, found, grey)


def _find_checkerboard(counts: tuple[int, int], grey: Grey) -> Points | None:
    for attempt, reduced, scale in _attempts(grey):
        found, corners = attempt(reduced, counts)
        if found:
            return _full_size(corners, scale)
    return None


def _attempts(grey: Grey) -> Iterator[tuple[Callable[..., Any], Grey8, float]]:
    """Finders of a checkerboard with their photographs, cheapest first.

    On 640 x 480 pixels the first takes 1 ms for a board that it finds, and 15 ms where it finds none; the second 30 ms
    (it bears noise and a stripe across the board, and wants even light); each threshold in turn 200 ms.
    """
    plain = partial(cv2.findChessboardCorners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    sectors = partial(cv2.findChessboardCornersSB, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE)
    thresholds = partial(cv2.findChessboardCorners, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE)
    stretched = _stretched(grey)
    first = next(stretched)
    yield plain, *first
    smallest, *larger = _sizes(_even_light(grey))
    yield sectors, *smallest
    # A stripe across many corners hides them from both.
    yield plain, _without_lines(first[0]), first[1]
    yield sectors, _without_lines(smallest[0]), smallest[1]
    for reduced, scale in chain((first,), stretched):
        yield thresholds, reduced, scale
    for reduced, scale in larger:
        yield sectors, reduced, scale


def _find_circles(counts: tuple[int, int], grey: Grey) -> Points | None:
    for reduced, scale in _stretched(grey):
        centres = find_circles(counts, reduced)
        if centres is not None:
            return _full_size(centres, scale)
    return None


def _find_charuco(board: Board, grey: Grey) -> Points | None:
    columns, rows = board.counts
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    squares = (columns + 1, rows + 1)
    pattern = cv2.aruco.CharucoBoard(squares, float(board.pitch_mm), float(board.marker_mm), dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(_stretch(grey, _WHITE_PERCENTILES[-1]))
    if ids is None or len(ids) < _LEAST_SEEN:
        return None
    grid = np.full((rows * columns, 2), np.nan)
    grid[ids.ravel().astype(int)] = corners.reshape(-1, 2)
    return grid


def _stretched(grey: Grey) -> Iterator[tuple[Grey8, float]]:
    """The photograph at each size: at each white level, then as it is, for either may cut off too much."""
    for white in _WHITE_PERCENTILES:
        yield from _sizes(_stretch(grey, white))
    yield from _sizes(eight_bits(grey))


def _stretch(grey: Grey, white: float) -> Grey8:
    """The photograph's levels up to a percentile, spread over 8 bits."""
    low, high = np.percentile(grey[::4, ::4], (_BLACK_PERCENTILE, white))
    return _clipped((grey.astype(np.float32) - low) * (255 / max(high - low, 1)))


def _even_light(grey: Grey) -> Grey8:
    """Each level against the mean about it, on a scale of logarithms, so that neither lamp nor stripe matters."""
    level = np.log1p(grey.astype(np.float32))
    size = int(max(grey.shape) * _NEIGHBOURHOOD) | 1
    return _clipped(128 + 64 * (level - cv2.blur(level, (size, size))))


def _without_lines(image: Grey8) -> Grey8:
    """The image without bright lines that are narrower than a square of a board."""
    side = max(max(image.shape) // _LINE, 3)
    return np.asarray(cv2.morphologyEx(image, cv2.MORPH_OPEN, np.ones((side, side), np.uint8)))


def _clipped(levels: Float[np.ndarray, "rows columns"]) -> Grey8:
    return levels.clip(0, 255).astype(np.uint8)


def _sizes(image: Grey8) -> Iterator[tuple[Grey8, float]]:
    """The image reduced to each of the longer sides that it has, and by how much; a small image as it is."""
    longer = max(image.shape)
    for side in _SIDES:
        scale = min(side / longer, 1.0)
        yield (
            (image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)),
            scale,
        )
        if scale == 1:
            return


def _full_size(points: np.ndarray, scale: float) -> Float[np.ndarray, "points 2"]:
    """Pixels of a reduced image to those of the photograph: sizes change about the image's edge, which is at -0.5."""
    return (points.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5
