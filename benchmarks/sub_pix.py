"""The corners of OpenCV's `cornerSubPix`, for comparison."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt

from jaxscan.calibration import Observations, View
from jaxscan.images import read_image, to_grey

# Half of the window that a calibration usually gives it.
USUAL = 5
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


def corner_sub_pix(
    grey: UInt[np.ndarray, "rows columns"], start: Float[np.ndarray, "corners 2"], half: int = USUAL
) -> Float[np.ndarray, "corners 2"]:
    """Corners refined in windows of 2 · half + 1 pixels."""
    points = start.astype(np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(grey, points, (half, half), (-1, -1), _STOP).reshape(-1, 2)


def with_sub_pix(observations: Observations, folder: Path) -> Observations:
    """The same photographs with the corners of `cornerSubPix`, of equal weight.

    Args:
        observations: of a session.
        folder: where its photographs are.
    """

    def again(view: View) -> View:
        grey = to_grey(read_image(folder / view.name))
        seen = np.isfinite(view.corners).all(axis=1)
        corners = np.full_like(view.corners, np.nan)
        corners[seen] = corner_sub_pix(grey, view.corners[seen])
        return replace(view, corners=corners, weights=None)

    return replace(
        observations,
        views=tuple(again(view) for view in observations.views),
        sequences=tuple(
            replace(stage, views=tuple(again(view) for view in stage.views)) for stage in observations.sequences
        ),
    )
