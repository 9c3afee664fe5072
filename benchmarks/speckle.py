"""Stripe detectors under speckle: error against the bound and the best detector, σ, edges of reflectance, by contrast.

Each pixel's laser light is multiplied by a gamma variable of mean 1, whose standard deviation is the contrast. Where
speckle is correlated, a Gaussian field smoothed to the correlation length (covariance e^(−r² / 2 l²)) is taken to
gamma variables through its quantiles. The bound is that of independent pixels of the variance that they have.
"""

import itertools
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr
from scipy.stats import gamma

from benchmarks.metric import Metric
from benchmarks.stripes import profile
from jaxscan.detectors import DEFAULT, DETECTORS, Detector
from jaxscan.images import StripeSettings, detect_stripe

_GREY, _ROWS, _GROUND, _HEIGHT, _TOP = StripeSettings("grey"), 64, 12000.0, 20000.0, 65535
_COLUMNS: Final = 4000
_WIDTHS, _SIGNALS = (0.7, 1.0, 1.5, 2.0, 3.0, 4.0), (10, 30, 100)
_CONTRASTS, _GRAINS = (0.0, 0.1, 0.2, 0.4, 0.7), (0.0, 1.0, 2.0)
_QUICK: Final = ((0.7, 1.5, 3.0), (30, 100), (0.0, 0.2), (0.0, 1.0))

Image = Float[np.ndarray, "rows columns"]


def measure(quick: bool) -> list[Metric]:
    """The grid, and an edge of 10:1 along the stripe; in the short form fewer cells and detectors."""
    return grid(quick) + edge()


def grid(quick: bool) -> list[Metric]:
    """RMS over the bound and over the best detector's, and predicted σ over the actual, in each cell."""
    widths, signals, contrasts, grains = _QUICK if quick else (_WIDTHS, _SIGNALS, _CONTRASTS, _GRAINS)
    names: tuple[Detector, ...] = ("likelihood", "gravity", "ridge") if quick else tuple(DETECTORS)
    random = np.random.default_rng(0)
    centre = _ROWS / 2 + 4 * np.sin(np.arange(_COLUMNS) / 40) + random.uniform(-0.5, 0.5, _COLUMNS)
    print("  RMS error over the bound (predicted σ over the actual)")
    print("    σ px, signal/noise, contrast, grain px    " + "".join(f"{name:>14}" for name in names))
    worst: dict[tuple[float, float], list[tuple[float, float, float]]] = {}
    for s, signal, contrast, grain in itertools.product(widths, signals, contrasts, grains):
        if not contrast and grain:
            continue
        light = _HEIGHT * profile(centre, s)
        image = _photograph(light, contrast, grain, signal, random)
        least = _bound(centre, s, contrast, signal)
        found = {name: _error(image, centre, name) for name in names}
        best = min(rms for rms, _ in found.values())
        rms, sigma = found[DEFAULT]
        worst.setdefault((contrast, grain), []).append((rms / least, rms / best, abs(np.log(sigma / rms))))
        cells = "".join(f"{rms / least:7.2f} ({sigma / rms:4.2f})" for rms, sigma in found.values())
        print(f"    {s:4} {signal:5} {contrast:5} {grain:5}                  {cells}", flush=True)
    metrics = []
    for (contrast, grain), cells in worst.items():
        over_bound, over_best, off = np.max(cells, axis=0)
        which = f"speckle.contrast_{contrast:g}" + (f".grain_{grain:g}" if contrast else "")
        if not grain:
            goal = 1.15 if contrast else 1.03
            metrics.append(Metric(f"{which}.rms_over_bound", over_bound, "", "lower", goal))
        metrics.append(Metric(f"{which}.rms_over_best", over_best, "", "lower", 1.05))
        metrics.append(Metric(f"{which}.sigma_off", float(np.expm1(off)), "", "lower", 0.10, floor=0.03))
    return metrics


def edge() -> list[Metric]:
    """A stripe of σ 1.5 px that an edge of 10:1 crosses lengthwise: error over the centre of gravity's, by contrast."""
    s, fine, random = 1.5, 25, np.random.default_rng(1)
    at = np.linspace(-3, 3, _COLUMNS)
    centre = np.full(_COLUMNS, _ROWS / 2 + 0.3) + random.uniform(-0.5, 0.5, _COLUMNS)
    v = (np.arange(_ROWS * fine) + 0.5)[:, None] / fine - 0.5
    light = np.exp(-0.5 * ((v - centre) / s) ** 2) * np.where(v - centre < at, 1.0, 0.1)
    light = _HEIGHT * light.reshape(_ROWS, fine, _COLUMNS).mean(axis=1)
    metrics = []
    for contrast, grain, goal in ((0.0, 0.0, 0.5), (0.2, 0.0, 0.7), (0.2, 1.0, 0.7), (0.2, 2.0, 0.7)):
        image = _photograph(light, contrast, grain, 100, random)
        share = _error(image, centre, DEFAULT)[0] / _error(image, centre, "gravity")[0]
        name = f"speckle.edge.contrast_{contrast:g}" + (f".grain_{grain:g}" if contrast else "")
        metrics.append(Metric(f"{name}.over_gravity", share, "", "lower", goal))
    return metrics


def _photograph(light: Image, contrast: float, grain: float, signal: float, random: np.random.Generator) -> np.ndarray:
    noise = _HEIGHT / signal * random.standard_normal(light.shape)
    return np.rint((_GROUND + light * _speckle(light.shape, contrast, grain, random) + noise).clip(0, _TOP)).astype(
        np.uint16
    )


def _speckle(shape: tuple[int, ...], contrast: float, grain: float, random: np.random.Generator) -> Image:
    """Factors of mean 1 and of this standard deviation, correlated over so many pixels both ways."""
    if not contrast:
        return np.ones(shape)
    k = contrast**-2
    if not grain:
        return random.gamma(k, 1 / k, shape)
    field = gaussian_filter(random.standard_normal(shape), grain / np.sqrt(2), mode="wrap")
    return gamma.ppf(ndtr(field / field.std()), k, scale=1 / k)


def _bound(centre: Float[np.ndarray, "columns"], s: float, contrast: float, signal: float) -> float:
    """Cramér and Rao's, px, for independent normal pixels of this variance; background, height and width unknown."""
    some, h = centre[:400], 1e-4
    light = _HEIGHT * profile(some, s)
    by_s = _HEIGHT * (profile(some, s + h) - profile(some, s - h)) / (2 * h)
    by_centre = _HEIGHT * (profile(some + h, s) - profile(some - h, s)) / (2 * h)
    J = np.stack([np.ones_like(light), light / _HEIGHT, by_s, by_centre], axis=-1)
    variance = (_HEIGHT / signal) ** 2 + (contrast * light) ** 2
    information = np.einsum("kni,kn,knj->nij", J, 1 / variance, J)
    return float(np.sqrt(np.linalg.inv(information)[:, 3, 3].mean()))


def _error(image: np.ndarray, centre: Float[np.ndarray, "columns"], name: Detector) -> tuple[float, float]:
    """RMS error and RMS predicted σ, px, each without the worst in five hundred, which are lost stripes."""
    stripe = detect_stripe(image, _GREY, detector=name)
    valid = np.asarray(stripe.valid[0])
    error = np.abs(np.asarray(stripe.position[0], np.float64)[valid] - centre[valid])
    sigma = np.asarray(stripe.sigma[0], np.float64)[valid]
    near = error <= np.quantile(error, 0.998)
    return float(np.sqrt((error[near] ** 2).mean())), float(np.sqrt((sigma[near] ** 2).mean()))
