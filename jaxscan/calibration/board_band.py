"""Where in a photograph the board can be: beyond it, a stripe on a wall or a table says nothing."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.initial import homographies
from jaxscan.images import Board
from jaxscan.images.stripes.settle import Band

# How far beyond the outermost points a stripe is still looked for, in pitches: a lens bends the board's outline.
_MARGIN: Final = 3.0
# A homography that is further off its own corners than this part of a pitch, RMS, does not say where the board ends.
_FITS: Final = 0.5


def board_band(
    board: Board, corners: Float[np.ndarray, "corners 2"], size: tuple[int, int], *, columns: bool
) -> Band | None:
    """The first and the last row of each column (or column of each row) that the board and its margin cover.

    Args:
        board: for its points.
        corners: where they were found, px; NaN for one that was not.
        size: columns and rows of the photograph.
        columns: whether stripes are looked for column by column.

    Returns:
        None where the corners do not say where the board ends: a lens that no homography follows, or a board that
        reaches behind the camera.
    """
    points = board.points()[:, :2]
    seen = np.isfinite(corners[:, 0]) & np.isfinite(corners[:, 1])
    H = homographies(points, corners[None], seen[None])[0]
    again = _mapped(H, points[seen])
    side = np.linalg.norm(_mapped(H, points[seen] + [board.pitch_mm, 0.0]) - again, axis=1)
    if not np.sqrt(((again - corners[seen]) ** 2).sum(axis=1).mean()) < _FITS * np.median(side):
        return None
    low, high = points.min(axis=0) - _MARGIN * board.pitch_mm, points.max(axis=0) + _MARGIN * board.pitch_mm
    outline = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    middle = np.append(points[seen].mean(axis=0), 1.0) @ H[2]
    if not ((outline @ H[2, :2] + H[2, 2]) * middle > 0).all():
        return None
    ends: Float[np.ndarray, "4 2"] = _mapped(H, outline)
    along, across = (ends[:, 0], ends[:, 1]) if columns else (ends[:, 1], ends[:, 0])
    lines = np.arange(size[0] if columns else size[1], dtype=np.float64)
    # Where each side of the outline crosses each line.
    first, last = (along, across), (np.roll(along, -1), np.roll(across, -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (lines[:, None] - first[0]) / (last[0] - first[0])
        crossing = np.where((t >= 0) & (t <= 1), first[1] + t * (last[1] - first[1]), np.nan)
    crosses = np.isfinite(crossing)
    low_edge = np.where(crosses, crossing, np.inf).min(axis=1)
    high_edge = np.where(crosses, crossing, -np.inf).max(axis=1)
    return low_edge.astype(np.float32), high_edge.astype(np.float32)


def _mapped(H: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
    ends = np.column_stack([points, np.ones(len(points))]) @ H.T
    return ends[:, :2] / ends[:, 2:]
