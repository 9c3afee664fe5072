"""Whether a photograph has been a JPEG: its noise ends at the borders of blocks.

A JPEG keeps each block of 8 x 8 pixels by its cosine transform, in steps that are longer the higher the frequency
(ITU-T T.81). Of noise little is left at high frequencies in a block of the JPEG's own; in a block that lies across
four of them their borders show there. Noise of a sensor, whatever a program has made of it, is the same in both.
"""

from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float, Int, UInt
from scipy.fft import dct

from jaxscan.images.stripe_settings import StripeSettings
from jaxscan.images.stripes.response import LUMA

_SIZE: Final = 8
# Blocks are taken from this number of rows and columns of them, evenly spread; at most this number of those that come
# no nearer to the stripe than this number of pixels is looked at: the quotient is then known to 6 %.
_MOST, _SPREAD, _AWAY_PX = 64, 12, 16
_FEWEST: Final = 24
# Frequencies (u, v) with u + v from this on are high.
_HIGH: Final = 8
# A JPEG's own blocks have less than this part of the squares at high frequencies that shifted blocks have.
_LESS: Final = 0.75


@cache
def _cosines() -> Float[np.ndarray, "8 8"]:
    return np.asarray(dct(np.eye(_SIZE), axis=0, norm="ortho"), np.float32)


@cache
def _high() -> np.ndarray:
    return np.add.outer(np.arange(_SIZE), np.arange(_SIZE)) >= _HIGH


def has_blocks(
    image: UInt[np.ndarray, "rows columns *rgb"], settings: StripeSettings, peak: Int[np.ndarray, "lines"]
) -> bool:
    """Whether high frequencies are weaker in blocks of the JPEG's own than in blocks that lie across them.

    Args:
        image: the photograph.
        settings: which way lines run.
        peak: about where the stripe is in each line.
    """
    if not settings.columns:
        image = np.swapaxes(image, 0, 1)
    last = [n // _SIZE - 2 for n in image.shape[:2]]
    if min(last) < 0:
        return False
    places = (np.linspace(0, n, min(n + 1, _SPREAD)).astype(int) * _SIZE for n in last)
    row, column = np.meshgrid(*places, indexing="ij")
    near = np.stack([peak[column + k] for k in (0, _SIZE - 1)])
    away = (np.abs(near - (row + _SIZE)) > _AWAY_PX + _SIZE).all(axis=0)
    row, column = row[away], column[away]
    if len(row) < _FEWEST:
        return False
    some = np.linspace(0, len(row) - 1, min(len(row), _MOST)).astype(int)
    own, shifted = (_at_high_frequencies(image, row[some] + by, column[some] + by) for by in (0, _SIZE // 2))
    return bool(np.median(own) < _LESS * np.median(shifted))


def _at_high_frequencies(
    image: UInt[np.ndarray, "rows columns *rgb"], row: Int[np.ndarray, "some"], column: Int[np.ndarray, "some"]
) -> Float[np.ndarray, "some"]:
    """The squares of each block of luma at high frequencies."""
    k = np.arange(_SIZE)
    pixels = image[row[:, None, None] + k[:, None], column[:, None, None] + k].astype(np.float32)
    luma = pixels if image.ndim == 2 else pixels @ np.array(LUMA, np.float32)
    D = _cosines()
    return ((D @ luma @ D.T)[:, _high()] ** 2).sum(axis=1)
