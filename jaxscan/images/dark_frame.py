"""Whether a photograph with the laser off shows a scene, or only what the sensor reads in the dark."""

import numpy as np

from jaxscan.images.decode import Image

# Levels are compared over squares of this side, px, of each of which the middle half of its pixels counts: single
# bright ones, which are the sensor's own, do not.
_SIDE = 16
# The noise of a pixel is read off differences of neighbours, of which this part counts; σ for each mean of these.
_USUAL, _SIGMA = 0.99, 0.886
# Means of squares of noise alone are within half a σ of each other; a scene is what exceeds this number of σ.
_SIGMAS = 2.0


def is_dark_frame(image: Image) -> bool:
    """Whether levels differ from place to place by no more than the noise of a pixel hides."""
    grey = image.mean(axis=2, dtype=np.float32) if image.ndim == 3 else image.astype(np.float32)
    rows, columns = (count // _SIDE for count in grey.shape)
    if not rows or not columns:
        return False
    squares = grey[: rows * _SIDE, : columns * _SIDE].reshape(rows, _SIDE, columns, _SIDE).swapaxes(1, 2)
    ranked = np.sort(squares.reshape(rows * columns, -1), axis=1)
    quarter = ranked.shape[1] // 4
    levels = ranked[:, quarter:-quarter].mean(axis=1)
    change = np.abs(np.diff(grey, axis=1)).ravel()
    sigma = _SIGMA * float(change[change <= np.quantile(change, _USUAL)].mean())
    return float(np.ptp(levels)) <= _SIGMAS * sigma
