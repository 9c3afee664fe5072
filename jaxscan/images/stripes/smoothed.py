"""Noise that neighbouring pixels have in common, as where a camera has denoised or enlarged its photographs.

A detector takes the noise of pixels for independent. Where a program has smoothed it, a fit averages over fewer
independent numbers than it has pixels, so that σ comes out too small. With ρ_k the correlation of pixels k apart in a
line, D their standard deviations and a_k = ∂c / ∂r_k, a centre has the variance

    σ² = aᵀ D R D a,    R_ij = ρ_|i − j|        in place of aᵀ D² a

ρ is read off the quietest stretches of a photograph's lines, away from the stripe. A JPEG keeps each 8 × 8 block by
itself, and what it leaves is alike within the block whatever the camera did: pixels that are neighbours across a
border of two blocks show whether there is more to it.
"""

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float, Int, UInt

from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.likelihood import FREEDOM_OF_NOISE, REACH, REACH_PX
from jaxscan.images.stripes.response import LUMA, ROUNDING
from jaxscan.images.stripes.windows import Sensor

# Correlations of pixels up to this distance are estimated; beyond, there are none.
DISTANCES: Final = 4
# Noise is white below this correlation of neighbours.
LEAST: Final = 0.15
# About this number of stretches of a photograph are looked at.
_MOST_LOOKED_AT = 512
# Two blocks of a JPEG make a stretch.
_BLOCK: Final = 8
# A stretch is this far away from the stripe, px; its trend is a parabola.
_AWAY_PX, _TREND = 16, 2
# Stretches are read if their squares are at most this multiple of those at the lower quartile, if there are at least
# this number: louder ones have a pattern.
_QUIET, _QUIETEST, _FEWEST = 5.0, 0.25, 100
# Of a JPEG of white noise neighbours across a border have less than this part of what all neighbours have in common.
_OF_BLOCKS = 0.5
# Noise is visible if its variance is this multiple of the variance of rounding.
_SEEN = 2.5
# Widths and heights of stripes at which σ is worked out, in each photograph.
_WIDTHS, _HEIGHTS, _PHASES = 5, 4, (0.0, 0.5)


@cache
def _projection(size: int, degree: int) -> Float[np.ndarray, "size size"]:
    """What takes a polynomial trend out of a stretch."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, size), degree + 1))
    return np.eye(size) - basis @ basis.T


def _pairs(apart: int, first: int = 0, last: int = 2 * _BLOCK) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of a stretch that are so far apart; the earlier one is from `first` on, and before `last`."""
    at = np.arange(first, min(last, 2 * _BLOCK - apart))
    return at, at + apart


# Pairs of pixels whose products are summed: of each distance all; and those across the border of two blocks.
_SUMS: Final = (*(_pairs(k) for k in range(DISTANCES + 1)), _pairs(1, _BLOCK - 1, _BLOCK))


@cache
def _summed() -> Float[np.ndarray, "sums products"]:
    """Which products of two pixels of a stretch each sum takes."""
    masks = np.zeros((len(_SUMS), 2 * _BLOCK, 2 * _BLOCK))
    for mask, pair in zip(masks, _SUMS, strict=True):
        mask[pair] = 1.0
    return masks.reshape(len(_SUMS), -1)


@cache
def _equations() -> Float[np.ndarray, "sums distances"]:
    """What a covariance of 1 at each distance adds to each sum of products of a stretch."""
    size = 2 * _BLOCK
    P, apart = _projection(size, _TREND), np.abs(np.subtract.outer(np.arange(size), np.arange(size)))
    left = [P @ (apart == k) @ P for k in range(DISTANCES + 1)]
    return np.stack([_summed() @ one.ravel() for one in left], axis=1)


def noise_correlation(
    image: UInt[np.ndarray, "rows columns *rgb"],
    dark: UInt[np.ndarray, "rows columns *rgb"] | None,
    settings: StripeSettings,
    weights: tuple[float, float],
    peak: Int[np.ndarray, "lines"],
) -> Float[np.ndarray, "distances"] | None:
    """The correlation of noise 1, 2, … pixels apart in a line; None where it is white or not seen.

    Args:
        image: the photograph.
        dark: the same with the laser off, or None.
        settings: the laser's colour, and which way lines run.
        weights: m and n of the response.
        peak: about where the stripe is in each line.
    """
    if not settings.columns:
        image, dark = np.swapaxes(image, 0, 1), None if dark is None else np.swapaxes(dark, 0, 1)
    rows = len(image) // _BLOCK * _BLOCK
    begin = np.arange(0, rows - 2 * _BLOCK + 1, _BLOCK)[:, None]
    some = np.linspace(0, len(peak) - 1, min(len(peak), -(-_MOST_LOOKED_AT // max(len(begin), 1)))).astype(int)
    pixels = image[:rows, some]
    # What is cut off at either end of the scale has no noise.
    cut = (pixels == 0) | (pixels == np.iinfo(pixels.dtype).max)
    in_block = np.moveaxis(cut, 1, -1).reshape(rows // _BLOCK, -1, len(some)).any(axis=1)
    away = np.abs(begin + _BLOCK - peak[some]) > _AWAY_PX + _BLOCK
    read = away & ~(in_block[1:] | in_block[:-1])
    if read.sum() < _FEWEST:
        return None
    levels, rounding = pixels.astype(np.float32), ROUNDING
    if dark is not None:
        levels -= dark[:rows, some]
        rounding *= 2
    by = _channel_weights(settings.color, weights, image.ndim)
    r = levels if by is None else levels @ by
    rounding *= 1.0 if by is None else float(by @ by)
    # Two blocks of each line together, from every block on.
    stretches = np.lib.stride_tricks.sliding_window_view(r, 2 * _BLOCK, axis=0)[::_BLOCK]
    z = stretches[read] @ _projection(2 * _BLOCK, _TREND).astype(np.float32)
    squares = (z * z).sum(axis=1)
    quiet = z[squares <= _QUIET * np.quantile(squares, _QUIETEST)]
    *seen, across = _summed() @ (quiet.T @ quiet / len(quiet)).ravel()
    *equations, of_border = _equations()
    covariance = np.linalg.solve(equations, seen)
    if covariance[0] < _SEEN * rounding or covariance[1] < LEAST * covariance[0]:
        return None
    white, expected = of_border[0] * covariance[0], of_border @ covariance
    if across - white < _OF_BLOCKS * (expected - white):
        return None
    return np.clip(covariance[1:] / covariance[0], -1.0, 1.0)


def _channel_weights(color: str, weights: tuple[float, float], axes: int) -> Float[np.ndarray, "rgb"] | None:
    """The weights of red, green and blue in the response; of luma where that is measured, which has its own pixels."""
    if axes == 2:
        return None
    if color == "grey" or min(weights) < 0:
        return np.array(LUMA, np.float32)
    laser, *others = CHANNELS[color]
    by = np.zeros(3, np.float32)
    by[laser], by[others] = 2.0, -np.asarray(weights)
    return by


def widening(
    correlation: Float[np.ndarray, "distances"],
    sensor: Sensor,
    frame: int,
    width: Float[np.ndarray, "lines"],
    height: Float[np.ndarray, "lines"],
) -> Float[np.ndarray, "lines"]:
    """How much larger σ of the stripe of each line is than for white noise of the same variance.

    Args:
        correlation: as `noise_correlation` gives it.
        sensor: the noise.
        frame: of which of its frames.
        width: full width of the stripe at half its height, px.
        height: its peak above the background, grey levels of the response.
    """
    noise = [
        float(np.asarray(x)[frame]) for x in (sensor.read, sensor.shot, sensor.speckle, sensor.ln_s_spread, sensor.even)
    ]
    known = np.isfinite(width) & (height > 0)
    by = np.ones(len(width), np.float32)
    if not known.any():
        return by
    ln_s, ln_A = np.log(width[known] / FWHM), np.log(height[known])
    widths, heights = (_nodes(x, n) for x, n in ((ln_s, _WIDTHS), (ln_A, _HEIGHTS)))
    table = np.array([[_widening(np.exp(a), np.exp(b), correlation, noise) for b in heights] for a in widths])
    places = ((x - nodes[0]) / (nodes[1] - nodes[0]) for x, nodes in ((ln_s, widths), (ln_A, heights)))
    by[known] = _between(table, *places)
    return by


def _nodes(values: Float[np.ndarray, "some"], count: int) -> Float[np.ndarray, "count"]:
    """From the least to the greatest, all but a few."""
    low, high = np.quantile(values, (0.02, 0.98))
    return np.linspace(low, max(high, low + 1e-3), count)


def _between(
    table: Float[np.ndarray, "widths heights"], i: Float[np.ndarray, "lines"], k: Float[np.ndarray, "lines"]
) -> Float[np.ndarray, "lines"]:
    """Bilinear interpolation, the ends held."""

    def split(place: Float[np.ndarray, "lines"], count: int) -> tuple[np.ndarray, np.ndarray]:
        held = np.clip(place, 0, count - 1)
        first = np.minimum(held.astype(int), count - 2)
        return first, held - first

    (i0, x), (k0, y) = split(i, table.shape[0]), split(k, table.shape[1])
    return (
        table[i0, k0] * (1 - x) * (1 - y)
        + table[i0 + 1, k0] * x * (1 - y)
        + table[i0, k0 + 1] * (1 - x) * y
        + table[i0 + 1, k0 + 1] * x * y
    )


def _widening(s: float, height: float, correlation: Float[np.ndarray, "distances"], noise: Sequence[float]) -> float:
    """The same of one stripe, at the mean over its place in the pixel."""
    read, shot, speckle, spread, even = noise
    reach = FWHM / 2 * s + REACH * s + REACH_PX
    k = np.arange(-np.ceil(reach) - 1, np.ceil(reach) + 2)
    rho = np.array([1.0, *correlation])
    apart = np.abs(np.subtract.outer(k, k)).astype(int)
    by = []
    for c in _PHASES:
        used = np.abs(k - c) <= reach
        x = (k[used] - c) / s
        light = height * np.exp(-0.5 * x * x)
        own = shot * light + speckle * light**2
        d = np.sqrt(read**2 + own)
        J = np.stack([np.ones_like(x), light, light * x * x, light * x / s], axis=1) / d[:, None]
        R = np.where(apart <= DISTANCES, rho[np.minimum(apart, DISTANCES)], 0.0)[np.ix_(used, used)]
        if not even:
            R = (read**2 * R + np.diag(own)) / np.outer(d, d)
        inverse = np.linalg.inv(J.T @ J + np.diag([0.0, 0.0, spread**-2, 0.0]))
        a = inverse[3] @ J.T
        basis, _ = np.linalg.qr(J)
        # What the line's own residuals say of σ, they say of white noise.
        squares = len(x) - np.trace(basis.T @ R @ basis)
        scatter = (FREEDOM_OF_NOISE + squares) / (FREEDOM_OF_NOISE + len(x) - J.shape[1])
        by.append(a @ R @ a / inverse[3, 3] / scatter)
    return float(np.sqrt(np.mean(by)))
