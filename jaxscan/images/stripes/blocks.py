"""Whether a photograph has been a JPEG: its noise ends at the borders of blocks, or its blocks are on a lattice.

A JPEG keeps each block of 8 x 8 pixels by its cosine transform, in steps that are longer the higher the frequency
(ITU-T T.81). Of noise little is left at high frequencies in a block of the JPEG's own; in a block that lies across
four of them their borders show there. Noise of a sensor, whatever a program has made of it, is the same in both.

Where a JPEG has left no noise beside the stripe, as where there was none, only the blocks of the stripe itself say
anything: their coefficients are multiples of those steps. With steps q of a quality and coefficients C of luma

    z = √(2 / n) Σ cos(2π C / q)

is that of a standard normal number where C is anything, and near √(2 n) where it is a multiple, ITU-T T.81's table
K.1 in the way of the Independent JPEG Group: nearly all cameras and programs scale it by a quality.
"""

from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt

from jaxscan.images.stripe_settings import StripeSettings
from jaxscan.images.stripes.response import LUMA

_SIZE: Final = 8
# Blocks are taken from this number of rows and columns of them, evenly spread; at most this number of those that come
# no nearer to the stripe than this number of pixels is looked at: the quotient is then known to 6 %.
_MOST, _SPREAD, _AWAY_PX = 64, 12, 16
_FEWEST: Final = 24
# Frequencies (u, v) with u + v from this on are high.
_HIGH: Final = 8
# A JPEG's own blocks have less than this part of the squares at high frequencies that shifted blocks have, at both of
# these quantiles.
_LESS, _USUAL = 0.75, (0.5, 0.75)
# Where its own blocks have less than this, no noise is left: that of a sensor of 0.6 grey levels.
_NO_NOISE: Final = 5.0
# Where shifted blocks have less than this, a few pixels are one level off the others, and their number is chance.
_FEW: Final = 2.0
# Steps of luma at quality 50, of the vertical and the horizontal frequency.
_TABLE: Final = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)
_QUALITIES: Final = np.arange(25, 99)
# A step shorter than this is hidden by rounding, and a coefficient that is 0 is one of anything.
_LEAST_STEP, _LEAST_VALUE = 2.0, 1.0
# Coefficients of one frequency that are nearer to one another than this count once, for a drawn stripe may be the same
# in all blocks.
_SAME: Final = 2.5
# At most this number of coefficients is looked at, of this number of blocks without those that have a full pixel.
_MOST_VALUES, _MOST_TRIED = 128, 128
# From this z on, of at least this number of them, they are multiples: the greatest of all qualities is 4.2 of drawings.
_MULTIPLES, _FEWEST_VALUES = 5.0, 12


@cache
def _transform() -> Float[np.ndarray, "64 64"]:
    """The cosine transform of a block, from pixels to frequencies, both in rows."""
    k = np.arange(_SIZE)
    D = np.sqrt(np.where(k, 2, 1) / _SIZE)[:, None] * np.cos(np.pi * np.outer(k, k + 0.5) / _SIZE)
    return np.kron(D, D).T.astype(np.float32)


@cache
def _high() -> Bool[np.ndarray, "64"]:
    return (np.add.outer(np.arange(_SIZE), np.arange(_SIZE)) >= _HIGH).ravel()


@cache
def _steps() -> Float[np.ndarray, "qualities 8 8"]:
    by = np.where(_QUALITIES < 50, 5000 / _QUALITIES, 200 - 2 * _QUALITIES)[:, None, None]
    return np.clip(np.floor((np.array(_TABLE) * by + 50) / 100), 1, 255).astype(np.float32)


def has_blocks(
    image: UInt[np.ndarray, "rows columns *rgb"], settings: StripeSettings, peak: Int[np.ndarray, "lines"]
) -> bool:
    """Whether a photograph has the blocks of a JPEG.

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
    row, column = _spread(row, _MOST), _spread(column, _MOST)
    own, shifted = (_at_high_frequencies(image, row + by, column + by) for by in (0, _SIZE // 2))
    if shifted[0] > _FEW and (own < _LESS * shifted).all():
        return True
    return bool(own[0] < _NO_NOISE) and _on_a_lattice(image, settings, peak)


def _at_high_frequencies(
    image: UInt[np.ndarray, "rows columns *rgb"], row: Int[np.ndarray, "some"], column: Int[np.ndarray, "some"]
) -> Float[np.ndarray, "2"]:
    """The squares of luma at high frequencies: what half of the blocks, and three in four, stay below."""
    squares = ((_luma(_blocks(image, row, column)) @ _transform()[:, _high()]) ** 2).sum(axis=1)
    at = [int(share * len(squares)) for share in _USUAL]
    return np.partition(squares, at)[at]


def _on_a_lattice(
    image: UInt[np.ndarray, "rows columns *rgb"], settings: StripeSettings, peak: Int[np.ndarray, "lines"]
) -> bool:
    """Whether coefficients of the stripe's blocks, and of those on either side, are multiples of a quality's steps."""
    column = np.arange(image.shape[1] // _SIZE) * _SIZE
    row = np.concatenate([(peak[column + _SIZE // 2] // _SIZE + by) * _SIZE for by in (-1, 0, 1)])
    column = np.tile(column, 3)
    inside = np.flatnonzero((row >= 0) & (row + _SIZE <= image.shape[0]))
    inside = _spread(inside, _MOST_TRIED)
    pixels = _blocks(image, row[inside], column[inside])
    # What was full when it was decoded was cut off, and by much; what was black, by little.
    pixels = pixels[(pixels < np.iinfo(image.dtype).max).reshape(len(pixels), -1).all(axis=1)]
    if not len(pixels):
        return False
    C = _luma(_spread(pixels, _MOST)) @ _transform()
    if not settings.columns:
        C = C.reshape(-1, _SIZE, _SIZE).swapaxes(1, 2).reshape(len(C), -1)
    block, frequency = np.nonzero(np.abs(C) > _LEAST_VALUE)
    block, frequency = block[frequency > 0], frequency[frequency > 0]
    C = C[block, frequency]
    once = np.unique(np.rint(C / _SAME).astype(int) * _SIZE**2 + frequency, return_index=True)[1]
    once = _spread(once, _MOST_VALUES)
    C, q = np.abs(C[once]), _steps().reshape(len(_QUALITIES), -1)[:, frequency[once]]
    told = (q >= _LEAST_STEP) & (q / 2 < C)
    n = told.sum(axis=1)
    z = np.sqrt(2 / np.maximum(n, 1)) * np.where(told, np.cos(2 * np.pi * C / q), 0.0).sum(axis=1)
    return bool((z[n >= _FEWEST_VALUES] > _MULTIPLES).any())


def _spread(values: Shaped[np.ndarray, "all *of"], most: int) -> Shaped[np.ndarray, "some *of"]:
    """Evenly spread ones of them, at most this number."""
    return values[np.linspace(0, len(values) - 1, min(len(values), most)).astype(int)]


def _blocks(
    image: UInt[np.ndarray, "rows columns *rgb"], row: Int[np.ndarray, "some"], column: Int[np.ndarray, "some"]
) -> UInt[np.ndarray, "some 8 8 *rgb"]:
    every = np.lib.stride_tricks.sliding_window_view(image, (_SIZE, _SIZE), axis=(0, 1))
    blocks = every[row, column]
    return blocks if image.ndim == 2 else np.moveaxis(blocks, 1, -1)


def _luma(pixels: UInt[np.ndarray, "some 8 8 *rgb"]) -> Float[np.ndarray, "some 64"]:
    levels = pixels.astype(np.float32)
    return (levels if pixels.ndim == 3 else levels @ np.array(LUMA, np.float32)).reshape(len(pixels), -1)
