"""Stripe detectors under speckle: error against the bound and the best detector, σ, edges of reflectance, by contrast.

Each pixel's laser light is multiplied by a gamma variable of mean 1, whose standard deviation is the contrast. Where
speckle is correlated, a Gaussian field smoothed to the correlation length (covariance e^(−r² / 2 l²)) is taken to
gamma variables through its quantiles. The bound is that of normal pixels with the covariance that they have.

The surface is smooth: the stripe winds over all places in a pixel. On one that is rough by as much as the error, σ has
a part of the roughness in it, for no photograph tells the two apart: `rough` says how much.
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
    """The grid, burnt-out stripes, an edge of 10:1 along the stripe; in the short form fewer cells and detectors."""
    return grid(quick) + burnt(quick) + ([] if quick else rough() + burnt_and_narrow()) + edge()


def grid(quick: bool) -> list[Metric]:
    """RMS over the bound and over the best detector's, and predicted σ over the actual, in each cell."""
    widths, signals, contrasts, grains = _QUICK if quick else (_WIDTHS, _SIGNALS, _CONTRASTS, _GRAINS)
    names: tuple[Detector, ...] = ("likelihood", "gravity", "ridge") if quick else tuple(DETECTORS)
    random = np.random.default_rng(0)
    centre = _winding()
    print("  RMS error over the bound (predicted σ over the actual)")
    print("    σ px, signal/noise, contrast, grain px    " + "".join(f"{name:>14}" for name in names))
    worst: dict[tuple[float, float], list[tuple[float, float, float]]] = {}
    for s, signal, contrast, grain in itertools.product(widths, signals, contrasts, grains):
        if not contrast and grain:
            continue
        light = _HEIGHT * profile(centre, s)
        image = _photograph(light, contrast, grain, signal, random)
        least = _bound(centre, s, contrast, grain, signal)
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
        goal = 1.15 if contrast else 1.03
        metrics.append(Metric(f"{which}.rms_over_bound", over_bound, "", "lower", goal))
        metrics.append(Metric(f"{which}.rms_over_best", over_best, "", "lower", 1.05))
        metrics.append(Metric(f"{which}.sigma_off", float(np.expm1(off)), "", "lower", 0.10, floor=0.03))
    return metrics


def rough() -> list[Metric]:
    """Predicted σ over the actual error on a surface that is rough by half a pixel either way from line to line."""
    random = np.random.default_rng(3)
    centre = _winding() + random.uniform(-0.5, 0.5, _COLUMNS)
    ratios = []
    widths, _, contrasts, grains = _QUICK
    for s, signal, contrast, grain in itertools.product(widths, _SIGNALS, contrasts, grains):
        if contrast or not grain:
            image = _photograph(_HEIGHT * profile(centre, s), contrast, grain, signal, random)
            rms, sigma = _error(image, centre, DEFAULT)
            ratios.append(sigma / rms)
    print(f"  on a rough surface: predicted σ over the actual {min(ratios):.2f} to {max(ratios):.2f}", flush=True)
    return [
        Metric("speckle.rough.lowest_ratio", min(ratios), "", "higher", 0.85),
        Metric("speckle.rough.highest_ratio", max(ratios), "", "lower", None, 0.1),
    ]


def burnt(quick: bool) -> list[Metric]:
    """Stripes whose core of 1 to 9 px is full, speckle 0.2: predicted σ over the actual, and error over gravity's."""
    random = np.random.default_rng(2)
    centre = _winding()
    print("  burnt-out: RMS error, px (predicted σ over the actual)")
    print("    core px, σ px, grain px        likelihood        gravity")
    worst: dict[float, list[tuple[float, float]]] = {}
    for core, grain in itertools.product((1, 5) if quick else (1, 3, 5, 7, 9), (0.0, 1.0)):
        for s in (core / 3,) if quick else (core / 4, core / 3, core / 2):
            if s < 0.7:
                continue
            light = _HEIGHT * np.exp((core / 2) ** 2 / (2 * s * s)) * profile(centre, s)
            image = _burnt_photograph(light, 0.2, grain, random)
            rms, sigma = _error(image, centre, DEFAULT)
            other, its = _error(image, centre, "gravity")
            worst.setdefault(grain, []).append((abs(np.log(sigma / rms)), rms / other))
            print(
                f"    {core:4} {s:5.2f} {grain:4}       "
                f"{rms:7.4f} ({sigma / rms:4.2f})  {other:7.4f} ({its / other:4.2f})"
            )
    metrics = []
    for grain, cells in worst.items():
        off, share = np.max(cells, axis=0)
        name = f"speckle.burnt.grain_{grain:g}"
        metrics += [
            Metric(f"{name}.sigma_off", float(np.expm1(off)), "", "lower", 0.15, floor=0.03),
            Metric(f"{name}.over_gravity", share, "", "lower", 1.05),
        ]
    return metrics


def burnt_and_narrow() -> list[Metric]:
    """Narrow stripes on an even surface, cores of 1 to 4 px full, speckle that their flanks do not show: σ."""
    random = np.random.default_rng(4)
    centre = _winding()
    print("  burnt-out and narrow: RMS error, px (predicted σ over the actual), by contrast")
    ratios = []
    for s, core in itertools.product((0.7, 0.9, 1.1), (1, 2, 3, 4)):
        light = _HEIGHT * np.exp((core / 2) ** 2 / (2 * s * s)) * profile(centre, s)
        cells = ""
        for contrast in (0.0, 0.1, 0.2, 0.4):
            image = _burnt_photograph(light, contrast, 0.0, random)
            rms, sigma = _error(image, centre, DEFAULT)
            cells += f"  {contrast}: {rms:6.4f} ({sigma / rms:4.2f})"
            ratios.append(sigma / rms)
        print(f"    σ {s} px, core {core} px{cells}", flush=True)
    return [
        Metric("speckle.burnt_and_narrow.lowest_ratio", min(ratios), "", "higher", 0.85),
        Metric("speckle.burnt_and_narrow.highest_ratio", max(ratios), "", "lower", 1.15),
    ]


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


def _winding() -> Float[np.ndarray, "columns"]:
    """The stripe's centre in each column: a smooth surface."""
    return _ROWS / 2 + 4 * np.sin(np.arange(_COLUMNS) / 40)


def _photograph(light: Image, contrast: float, grain: float, signal: float, random: np.random.Generator) -> np.ndarray:
    noise = _HEIGHT / signal * random.standard_normal(light.shape)
    return np.rint((_GROUND + light * _speckle(light.shape, contrast, grain, random) + noise).clip(0, _TOP)).astype(
        np.uint16
    )


def _burnt_photograph(light: Image, contrast: float, grain: float, random: np.random.Generator) -> np.ndarray:
    """With `_HEIGHT` above the ground for a full pixel."""
    levels = _photograph(light, contrast, grain, 100, random)
    return np.minimum(levels * (_TOP / (_GROUND + _HEIGHT)), _TOP).astype(np.uint16)


def _speckle(shape: tuple[int, ...], contrast: float, grain: float, random: np.random.Generator) -> Image:
    """Factors of mean 1 and standard deviation `contrast`, correlated over `grain` pixels in both directions."""
    if not contrast:
        return np.ones(shape)
    k = contrast**-2
    if not grain:
        return random.gamma(k, 1 / k, shape)
    field = gaussian_filter(random.standard_normal(shape), grain / np.sqrt(2), mode="wrap")
    return gamma.ppf(ndtr(field / field.std()), k, scale=1 / k)


def _bound(centre: Float[np.ndarray, "columns"], s: float, contrast: float, grain: float, signal: float) -> float:
    """Cramér and Rao's, px, for normal pixels of this covariance; background, height and width unknown."""
    some, h = centre[:200], 1e-4
    light = _HEIGHT * profile(some, s)
    by_s = _HEIGHT * (profile(some, s + h) - profile(some, s - h)) / (2 * h)
    by_centre = _HEIGHT * (profile(some + h, s) - profile(some - h, s)) / (2 * h)
    J = np.stack([np.ones_like(light), light / _HEIGHT, by_s, by_centre], axis=-1).transpose(1, 0, 2)
    apart = np.subtract.outer(np.arange(_ROWS), np.arange(_ROWS))
    alike = np.exp(-0.5 * (apart / grain) ** 2) if grain else np.eye(_ROWS)
    V = contrast**2 * light.T[:, :, None] * alike * light.T[:, None] + (_HEIGHT / signal) ** 2 * np.eye(_ROWS)
    information = J.transpose(0, 2, 1) @ np.linalg.solve(V, J)
    return float(np.sqrt(np.linalg.inv(information)[:, 3, 3].mean()))


def _error(image: np.ndarray, centre: Float[np.ndarray, "columns"], name: Detector) -> tuple[float, float]:
    """RMS error and RMS predicted σ, px, each without the worst in five hundred, which are lost stripes."""
    stripe = detect_stripe(image, _GREY, detector=name)
    valid = np.asarray(stripe.valid[0])
    error = np.abs(np.asarray(stripe.position[0], np.float64)[valid] - centre[valid])
    sigma = np.asarray(stripe.sigma[0], np.float64)[valid]
    near = error <= np.quantile(error, 0.998)
    return float(np.sqrt((error[near] ** 2).mean())), float(np.sqrt((sigma[near] ** 2).mean()))
