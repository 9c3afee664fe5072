"""Speckle whose grains are as large as the stripe is wide: seen along the stripe, not across it.

A grain that is wider than the stripe moves the whole of it, and a fit leaves nothing of it in its line. But it makes
that line brighter or darker, and those beside it with it, as far as it goes, for grains are round (J. Goodman 2007,
chapter 4: their size is that of the lens's aperture, wavelength times f-number). With F the light of a line, half the
mean square of the difference of ln F between lines k apart (`variogram`) is

    γ_k = n + V (1 − ρ^(k²)) + t k + t′ k²,      V = C² Σ_ij P_i P_j ρ^((i − j)²) / (Σ P_i)²

n is what the sensor's noise makes of ln F, ρ the correlation of the speckle of neighbouring pixels, C its contrast, P
the stripe's profile; t and t′ are what the surface's reflectance adds over longer distances.
"""

from dataclasses import replace
from itertools import product
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.likelihood import REACH, REACH_PX
from jaxscan.images.stripes.ranks import ranked
from jaxscan.images.stripes.variogram import variogram
from jaxscan.images.stripes.windows import Sensor, smoothed_speckle

# Distances, in lines: the largest grain that the filter of `grain` holds is gone at the last.
_DISTANCES: Final = np.arange(1, 9)
# ρ is one of these: less cannot be distinguished from speckle of single pixels, and need not be.
_CORRELATIONS: Final = np.linspace(0.3, 0.9, 31)
# Lines that are next to one another, at the least.
_FEWEST = 100
# Neighbours differ by less than this part of what lines far apart do, at first sight.
_LESS = 0.93
# The relative scatter of the median of n squares of normal numbers is this over √n. Correlation is significant from
# `_SURE` times that; a grain is needed, beside the variation that the surface may have, from `_NEEDED` times that.
_SCATTER, _SURE, _NEEDED = 1.65, 3.0, 1.5
# Of the second differences of burnt-out lines this quantile is read; of a normal number it is this number of σ, and the
# result scatters by this part of itself over the same root.
_USUAL, _USUAL_OVER_SIGMA, _SCATTER_OF_SIGMA = 0.8, 1.2816, 1.4
# Speckle of contrast 0.7 scatters burnt-out stripes of σ from 0.7 to 4 px by up to this times √σ, px.
_MOST_OF_SPECKLE = 0.2
# ln of the standard deviation of the narrowest stripe whose width its pixels determine, px.
_NARROW: Final = float(np.log(0.9))
_TINY = 1e-12

Lines = Float[np.ndarray, "frames lines"]
Frames = Float[np.ndarray, "frames"]


def with_grain(sensor: Sensor, ln_light: Lines, seen: Bool[np.ndarray, "frames lines"]) -> Sensor:
    """The sensor with contrast and grain of the speckle as they are along the stripe, in frames where they are seen.

    Args:
        sensor: as the survey gives it.
        ln_light: ln of A s of each line.
        seen: which lines have a whole stripe that is not burnt out.
    """
    speckle, grain = (np.array(x) for x in (sensor.speckle, sensor.grain))
    ln_s, read, shot = (np.asarray(x) for x in (sensor.ln_s, sensor.read, sensor.shot))
    smooth = np.zeros(len(ln_s), bool) if sensor.smooth is None else np.asarray(sensor.smooth)
    ln_light = np.where(seen, ln_light, 0.0)
    near, far = (_usual_difference(ln_light, seen, int(k)) for k in _DISTANCES[[0, -1]])
    some = np.flatnonzero(near < _LESS * far)
    s = np.exp(ln_s[some].astype(np.float64))
    height = np.exp(ranked(ln_light[some], seen[some], 0.5)) / s
    noise = [_noise_of_ln_light(*of) for of in zip(s, height, read[some], shot[some], strict=True)]
    for frame, width, V, rho in zip(some, s, *_told(ln_light[some], seen[some], np.array(noise)), strict=True):
        C2 = V / _of_profile(width, rho)
        if smooth[frame]:
            C2, rho = smoothed_speckle(C2, rho)
        # No speckle has more contrast than 1: that is a surface whose reflectance changes. And a grain that is seen
        # across the stripe as well is known better from there.
        if 0 < C2 < 1 and (speckle[frame] < C2 or not grain[frame]):
            speckle[frame], grain[frame] = max(C2, speckle[frame]), rho
    return replace(sensor, speckle=jnp.asarray(speckle), grain=jnp.asarray(grain))


def widened_by_flanks(sigma: Lines, breadth: Lines, burnt: Bool[np.ndarray, "frames lines"], sensor: Sensor) -> Lines:
    """σ of burnt-out stripes whose flanks are moved by grains that the survey has not seen.

    Of a stripe that is burnt out its two flanks alone are seen. Speckle moves each by itself, so that the centre
    scatters by half as much as the breadth does, whatever profile and halo are. Of the breadth's variogram the part of
    single pixels is left out: a fit averages over more of them than an outline does, and σ has it.

    Args:
        sigma: of each line's centre, px; NaN where there is none.
        breadth: of what is seen of each line's stripe, full at half height, px.
        burnt: which lines are burnt out.
        sensor: the noise.
    """
    sigma = sigma.copy()
    burnt = burnt & np.isfinite(sigma)
    ln_s, grain = (np.asarray(x)[: len(sigma)] for x in (sensor.ln_s, sensor.grain))
    some = np.flatnonzero((burnt.sum(axis=1) >= _FEWEST) & (ln_s > _NARROW) & (grain == 0))
    V, _ = _told(breadth[some], burnt[some], None)
    sigma[some] = np.where(
        burnt[some], np.hypot(sigma[some], (np.sqrt(V) / 2).astype(np.float32)[:, None]), sigma[some]
    )
    return sigma


def widened_by_scatter(sigma: Lines, position: Lines, burnt: Bool[np.ndarray, "frames lines"], sensor: Sensor) -> Lines:
    """σ of burnt-out lines by how much they scatter about their neighbours, where this is more than was predicted.

    Of a narrow stripe that is burnt out only a pixel or two of each flank are seen, too few to read their speckle from
    with certainty: this is asked in frames of such stripes, and where none was read.
    On an even surface the second differences of the centre have the variance σ₋² + 4 σ² + σ₊². What four in five lines
    of a frame stay below, in these units, says by how much σ is too small: as the error changes with the flanks' place
    in the pixels, the median says too little. What is missing is added to each line alike. More than speckle can
    do is the surface's own unevenness, and adds nothing; less of that makes σ too large.

    Args:
        sigma: of each line's centre, px; NaN where there is none.
        position: the centre, px.
        burnt: which lines are burnt out.
        sensor: the noise.
    """
    known = burnt & np.isfinite(sigma) & np.isfinite(position)
    variance = np.where(known, sigma, 0.0) ** 2
    expected = np.sqrt(variance[:, :-2] + 4 * variance[:, 1:-1] + variance[:, 2:])
    whole = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    bends = np.abs(np.diff(np.where(known, position, 0.0), 2, axis=1))
    sigma = sigma.copy()
    speckle, ln_s = (np.asarray(x)[: len(sigma)] for x in (sensor.speckle, sensor.ln_s))
    unread = (speckle == 0) | (ln_s < _NARROW)
    few, most = np.maximum(whole.sum(axis=1), 1), _MOST_OF_SPECKLE * np.exp(ln_s / 2)
    by = ranked(bends / np.maximum(expected, _TINY), whole, _USUAL) / _USUAL_OVER_SIGMA
    usual = ranked(sigma, known, 0.5)
    with np.errstate(invalid="ignore"):
        needed = (by > 1 + _SURE * _SCATTER_OF_SIGMA / np.sqrt(few)) & (by * usual < most)
    for frame in np.flatnonzero(unread & (few >= _FEWEST) & needed):
        missing = np.sqrt(by[frame] ** 2 - 1) * usual[frame]
        sigma[frame, known[frame]] = np.hypot(sigma[frame, known[frame]], np.float32(missing))
    return sigma


def _usual_difference(
    ln_light: Lines, seen: Bool[np.ndarray, "frames lines"], apart: int
) -> Float[np.ndarray, "frames"]:
    """The mean difference of lines so far apart; infinite where there are few."""
    both = seen[:, apart:] & seen[:, :-apart]
    total = np.where(both, np.abs(ln_light[:, apart:] - ln_light[:, :-apart]), 0.0).sum(axis=1)
    count = both.sum(axis=1)
    return np.where(count >= _FEWEST, total / np.maximum(count, 1), np.inf)


def _told(values: Lines, used: Bool[np.ndarray, "frames lines"], noise: Frames | None) -> tuple[Frames, Frames]:
    """V and ρ of each frame, n given or not; V is 0 where it is not needed to explain what is seen."""
    V, rho = np.zeros((2, len(values)))
    gamma = np.stack([variogram(values, used, int(k), _FEWEST) for k in _DISTANCES], axis=1)
    few = np.maximum((used[:, _DISTANCES[-1] :] & used[:, : -_DISTANCES[-1]]).sum(axis=1), 1)
    far = gamma[:, len(_DISTANCES) // 2 :].mean(axis=1)
    sure = (gamma > 0).all(axis=1) & (far - gamma[:, 0] > _SURE * _SCATTER / np.sqrt(few) * far)
    if not sure.any():
        return V, rho
    gamma, few = gamma[sure, :, None], few[sure]
    k = _DISTANCES / _DISTANCES[-1]
    surface = np.stack([k, k**2, np.ones_like(k)], axis=1) / gamma
    left = 1 - (0.0 if noise is None else noise[sure, None, None]) / gamma
    # Speckle of single pixels is alike at all distances, as noise is.
    _, without = _least_squares(surface, left, np.zeros_like(gamma))
    by = (1 - _CORRELATIONS ** (_DISTANCES[:, None] ** 2.0)) / gamma
    every, need = _least_squares(surface if noise is None else surface[..., :2], left, by)
    best = need.argmin(axis=1, keepdims=True)
    need, found = (np.take_along_axis(x, best, axis=1)[:, 0] for x in (need, every))
    V[sure] = np.where(without[:, 0] - need > (_NEEDED * _SCATTER) ** 2 / few, found, 0.0)
    rho[sure] = _CORRELATIONS[best[:, 0]]
    return V, rho


def _least_squares(
    surface: Float[np.ndarray, "frames distances numbers"],
    left: Float[np.ndarray, "frames distances 1"],
    by: Float[np.ndarray, "frames distances grains"],
) -> tuple[Float[np.ndarray, "frames grains"], Float[np.ndarray, "frames grains"]]:
    """V of each grain and the sum of squares that stays, V and the surface's numbers none of them negative.

    Of each set of the surface's numbers that are not zero the solution is written down; the least possible one counts.
    """
    chosen = np.array(list(product((False, True), repeat=surface.shape[-1])))[:, None]
    columns = surface * chosen[..., None, :]
    turned = np.swapaxes(columns, 2, 3)
    # A number that is not chosen is 0.
    inverse = np.linalg.solve(turned @ columns + np.eye(chosen.shape[-1]) * ~chosen[..., None], turned)
    own, rest = (x - columns @ (inverse @ x) for x in (by, left))
    V = np.maximum((own * rest).sum(axis=2), 0.0) / np.maximum((own**2).sum(axis=2), _TINY)
    squares = ((rest - V[:, :, None] * own) ** 2).sum(axis=2)
    possible = (inverse @ (left - V[:, :, None] * by) >= 0).all(axis=2)
    squares = np.where(possible, squares, np.inf)
    best = squares.argmin(axis=0)[None]
    V, need = (np.take_along_axis(x, best, axis=0)[0] for x in (V, squares))
    return V, need


def _of_profile(s: float, rho: float) -> float:
    """Σ P P ρ^((i − j)²) / (Σ P)²."""
    k = np.arange(-np.ceil(4 * s), np.ceil(4 * s) + 1)
    P = np.exp(-0.5 * (k / s) ** 2)
    return float(P @ rho ** (np.subtract.outer(k, k) ** 2) @ P / P.sum() ** 2)


def _noise_of_ln_light(s: float, height: float, read: float, shot: float) -> float:
    """The variance of ln (A s) that a fit of background, height, width and centre has of the sensor's noise."""
    reach = FWHM / 2 * s + REACH * s + REACH_PX
    k = np.arange(-np.floor(reach), np.floor(reach) + 1)
    z = k / s
    light = height * np.exp(-0.5 * z * z)
    J = np.stack([np.ones_like(z), light, light * z * z], axis=1) / np.sqrt(read**2 + shot * light)[:, None]
    covariance = np.linalg.inv(J.T @ J)
    return float(covariance[1:, 1:].sum())
