"""Speckle whose grains are as large as the stripe is wide: seen along the stripe, not across it.

A grain that is wider than the stripe moves the whole of it, and a fit leaves nothing of it in its line. But it makes that
line brighter or darker, and those beside it with it, as far as it goes: grains are round (J. Goodman 2007, chapter 4:
their size is that of the lens's aperture, wavelength times f-number). With F the light of a line, and half the mean
square of the difference of ln F between lines k apart (G. Matheron's variogram, 1963),

    γ_k = n + V (1 − ρ^(k²)) + t k,      V = C² Σ_ij P_i P_j ρ^((i − j)²) / (Σ P_i)²

n is what the sensor's noise makes of ln F, ρ the correlation of the speckle of neighbouring pixels, C its contrast, P
the stripe's profile, and t what the surface's reflectance adds over longer distances.
"""

from dataclasses import replace
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.images.stripes.likelihood import FWHM, REACH, REACH_PX
from jaxscan.images.stripes.windows import Sensor

# Distances, in lines: the largest grain that the filter of `grain` holds is gone at the last.
_DISTANCES: Final = np.arange(1, 9)
# ρ is one of these: less is not told from speckle of single pixels, and needs not be.
_CORRELATIONS: Final = np.linspace(0.3, 0.9, 31)
# Lines that are next to one another, at the least.
_FEWEST = 100
# Neighbours differ by less than this part of what lines far apart do, at first sight.
_LESS = 0.93
# The median of a normal number's square scatters by so much of itself over the root of how many there are; what is seen
# is no chance from so many times that.
_SCATTER, _SURE = 1.65, 3.0
# The median of the square of a normal number is this part of its mean.
_MEDIAN_OF_SQUARE = 0.455

Lines = Float[np.ndarray, "frames lines"]


def with_grain(sensor: Sensor, ln_light: Lines, seen: Bool[np.ndarray, "frames lines"]) -> Sensor:
    """The sensor with contrast and grain of the speckle as they are along the stripe, in frames where they are seen.

    Args:
        sensor: as the survey gives it.
        ln_light: ln of A s of each line.
        seen: which lines have a whole stripe that is not full.
    """
    speckle, grain = (np.array(x) for x in (sensor.speckle, sensor.grain))
    ln_light = np.where(seen, ln_light, 0.0)
    near, far = (_usual_difference(ln_light, seen, int(k)) for k in _DISTANCES[[0, -1]])
    # Where it is seen across the stripe it is known better.
    for frame in np.flatnonzero((near < _LESS * far) & (grain[: len(near)] == 0)):
        usual = [float(np.asarray(x)[frame]) for x in (sensor.ln_s, sensor.read, sensor.shot)]
        told = _told(ln_light[frame], seen[frame], *usual)
        if told is not None:
            speckle[frame], grain[frame] = told
    return replace(sensor, speckle=jnp.asarray(speckle), grain=jnp.asarray(grain))


def _usual_difference(
    ln_light: Lines, seen: Bool[np.ndarray, "frames lines"], apart: int
) -> Float[np.ndarray, "frames"]:
    """The mean difference of lines so far apart; infinite where there are few."""
    both = seen[:, apart:] & seen[:, :-apart]
    total = np.where(both, np.abs(ln_light[:, apart:] - ln_light[:, :-apart]), 0.0).sum(axis=1)
    count = both.sum(axis=1)
    return np.where(count >= _FEWEST, total / np.maximum(count, 1), np.inf)


def _told(
    ln_light: Float[np.ndarray, "lines"], seen: Bool[np.ndarray, "lines"], ln_s: float, read: float, shot: float
) -> tuple[float, float] | None:
    """C² and ρ of one frame; None where there is no such speckle."""
    differences = [(ln_light[k:] - ln_light[:-k])[seen[k:] & seen[:-k]] for k in _DISTANCES]
    gamma = np.array([np.median(d * d) / (2 * _MEDIAN_OF_SQUARE) for d in differences])
    few = min(len(d) for d in differences)
    if few < _FEWEST or not gamma.min() > 0:
        return None
    # Pairs that share lines are not independent: those of one distance tell about as much as half of them would.
    far = gamma[len(gamma) // 2 :].mean()
    if far - gamma[0] < _SURE * _SCATTER / np.sqrt(few) * far:
        return None
    s = np.exp(ln_s)
    height = np.exp(np.median(ln_light[seen])) / s
    noise = _noise_of_ln_light(s, height, read, shot)
    best = np.inf
    found = None
    for rho in _CORRELATIONS:
        by = np.stack([1 - rho ** (_DISTANCES**2.0), _DISTANCES / len(_DISTANCES)], axis=1) / gamma[:, None]
        left = (gamma - noise) / gamma
        V, t = np.linalg.lstsq(by, left, rcond=None)[0]
        if t < 0:
            V, t = by[:, 0] @ left / (by[:, 0] @ by[:, 0]), 0.0
        need = ((left - by @ [V, t]) ** 2).sum()
        if V > 0 and need < best:
            best, found = need, (V / _of_profile(s, rho), rho)
    # No speckle has more contrast than 1: that is a surface whose reflectance changes.
    return None if found is None or found[0] > 1 else (float(found[0]), float(found[1]))


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
