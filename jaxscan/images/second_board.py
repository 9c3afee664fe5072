"""Is there another board in the photograph? Then which one was found is chance, and may change from one to the next."""

import cv2
import numpy as np
from jaxtyping import Float

from jaxscan.images.board import Board
from jaxscan.images.decode import Image, to_grey
from jaxscan.images.find import shows_checkerboard

# Longer side, in pixels, at which it is looked for: a board that is not seen there is not mistaken for the first.
_SIDE = 640
# The board that was found is covered, together with a border of this number of squares around its points.
_MARGIN = 1.5


def shows_second_board(board: Board, image: Image, corners: Float[np.ndarray, "points 2"]) -> bool:
    """Whether a checkerboard of the same counts is in the photograph in addition to the one that was found.

    Args:
        board: what was looked for; only a checkerboard can be recognised.
        image: the photograph.
        corners: those of the board that was found, pixels; NaN where one was not seen.
    """
    seen = np.isfinite(corners).all(axis=1)
    if board.kind != "checkerboard" or seen.sum() < 4:  # a homography needs four
        return False
    grey = to_grey(image)
    scale = min(_SIDE / max(grey.shape), 1.0)
    low, high = np.percentile(grey[::4, ::4], (1, 99))
    levels = ((grey.astype(np.float32) - low) * (255 / max(high - low, 1))).clip(0, 255).astype(np.uint8)
    reduced = cv2.resize(levels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else levels
    H = cv2.findHomography(board.points()[seen, :2], (corners[seen] + 0.5) * scale - 0.5)[0]
    reach = _MARGIN * board.pitch_mm
    (x0, y0), (x1, y1) = -np.full(2, reach), (np.array(board.counts) - 1) * board.pitch_mm + reach
    outline = np.array([[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]], np.float64)
    covered = cv2.perspectiveTransform(outline, H)
    cv2.fillConvexPoly(reduced, np.rint(covered[0]).astype(np.int32), float(np.median(reduced)))
    # Most photographs have none, and the first of the two says so at once.
    return cv2.checkChessboard(reduced, board.counts) and shows_checkerboard(board.counts, reduced)
