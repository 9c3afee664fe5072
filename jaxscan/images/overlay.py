"""Pictures of what was detected, drawn over the photograph: for a person to look at, not to compute with."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.images.decode import Image

Picture = UInt8[np.ndarray, "rows columns 3"]

_STRIPE_COLOUR = (0, 255, 80)
_FIRST_COLOUR, _CORNER_COLOUR, _ORDER_COLOUR = (255, 220, 0), (0, 200, 255), (255, 0, 160)
# OpenCV draws at fractions of a pixel: number of bits of the fraction.
_BITS = 4
# A photograph whose levels are this far down the scale at this percentile is brightened until they are half way up,
# by at most this factor; its stripe may burn out for that.
_PERCENTILE = 90
_DARK = 0.25
_MOST_GAIN = 6.0


def draw_stripe(image: Image, stripe: Float[np.ndarray, "lines"], columns: bool) -> Picture:
    """The photograph with a dot at each stripe point.

    Args:
        image: grey or RGB, 8 or 16 bits.
        stripe: the row of each column, or, with `columns` false, the column of each row; NaN where there is none.
        columns: which of the two.
    """
    picture = _for_display(image)
    index = np.arange(len(stripe), dtype=np.float64)
    points = np.stack([index, stripe] if columns else [stripe, index], axis=-1)
    radius = _thickness(picture) / 2
    for point in points[np.flatnonzero(np.isfinite(stripe))]:
        _dot(picture, point, radius, _STRIPE_COLOUR)
    return picture


def draw_board(image: Image, corners: Float[np.ndarray, "points 2"], counts: tuple[int, int]) -> Picture:
    """The photograph with the board's points, ringed, the first one yellow, and the rows in their order.

    Args:
        image: grey or RGB, 8 or 16 bits.
        corners: row by row, NaN where one was not seen.
        counts: columns and rows of points.
    """
    picture = _for_display(image)
    thickness = _thickness(picture)
    seen = np.isfinite(corners[:, 0] + corners[:, 1])
    for i in range(len(corners) - 1):
        # The line runs through each row and on to the next, so that a wrong order shows.
        if seen[i] and seen[i + 1]:
            ends = (_fixed(corners[i]), _fixed(corners[i + 1]))
            cv2.line(picture, *ends, _ORDER_COLOUR, max(1, thickness // 2), cv2.LINE_AA, _BITS)
    for i in np.flatnonzero(seen):
        colour = _FIRST_COLOUR if i == 0 else _CORNER_COLOUR
        cv2.circle(picture, _fixed(corners[i]), 4 * thickness << _BITS, colour, thickness, cv2.LINE_AA, _BITS)
        _dot(picture, corners[i], thickness / 2, colour)
    if seen[0] and seen[counts[0] - 1]:
        end = corners[0] + (corners[counts[0] - 1] - corners[0]) / max(counts[0] - 1, 1)
        ends = tuple(int(x) for x in np.rint(corners[0])), tuple(int(x) for x in np.rint(end))
        cv2.arrowedLine(picture, *ends, _FIRST_COLOUR, thickness, cv2.LINE_AA, tipLength=0.3)
    return picture


def _for_display(image: Image) -> Picture:
    """Eight bits, three channels, dark photographs brightened; always a copy."""
    full = np.iinfo(image.dtype).max
    levels = image.astype(np.float32) / full
    usual = float(np.percentile(levels[::4, ::4], _PERCENTILE))
    if usual < _DARK:
        # A sensor of 10 or 12 bits leaves the upper end of 16 empty: there is no bound to how dark that looks.
        most = _MOST_GAIN if image.dtype == np.uint8 else np.inf
        levels *= min(0.5 / max(usual, 1 / full), most)
    picture = np.ascontiguousarray(np.rint(255 * levels.clip(0, 1)), dtype=np.uint8)
    return picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)


def _thickness(picture: Picture) -> int:
    return max(2, round(max(picture.shape) / 640))


def _dot(picture: Picture, point: Float[np.ndarray, "2"], radius: float, colour: tuple[int, int, int]) -> None:
    cv2.circle(picture, _fixed(point), round(radius * (1 << _BITS)), colour, cv2.FILLED, cv2.LINE_AA, _BITS)


def _fixed(point: Float[np.ndarray, "2"]) -> tuple[int, int]:
    u, v = np.rint(point * (1 << _BITS)).astype(int)
    return int(u), int(v)
