"""Stripe detectors side by side: error against the Cramér-Rao bound, at a step of reflectance, among spots, on a bed.

Stripes are drawn with exact pixel areas in 16 bits, so that rounding plays no part. The bound is that of one line by
itself, with background, height and width unknown too; of a full pixel it is that of a censored datum.
"""

import os
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr
from scipy.stats import norm

from benchmarks.metric import Metric
from jaxscan.detectors import DEFAULT, DETECTORS, Detector
from jaxscan.images import Stripe, StripeSettings, detect_stripe, read_image

# The ground is so high that no noise is cut off at zero.
_GREY, _ROWS, _GROUND, _HEIGHT = StripeSettings("grey"), 64, 12000.0, 20000.0
_FULL = _GROUND + _HEIGHT
_TOP = 65535
_COLUMNS = 4000
_PHASES = 8


def measure(quick: bool) -> list[Metric]:
    """All figures; in the short form fewer widths, columns and sizes."""
    metrics = bound(quick) + step_of_reflectance(_names(quick)) + spots()
    return metrics if quick else metrics + flat()


def _names(quick: bool) -> tuple[Detector, ...]:
    return ("likelihood", "gravity") if quick else tuple(DETECTORS)


def bound(quick: bool) -> list[Metric]:
    """RMS over the bound, predicted σ over the actual and bias, over widths and signal to noise."""
    columns = _COLUMNS if quick else 5 * _COLUMNS
    widths, signals = ((0.7, 1.5, 4.0), (10, 100)) if quick else ((0.7, 1.0, 1.5, 2.0, 3.0, 4.0), (10, 30, 100))
    random = np.random.default_rng(0)
    centre = _ROWS / 2 + 4 * np.sin(np.arange(columns) / 40) + random.uniform(-0.5, 0.5, columns)
    worst: dict[str, list[tuple[float, float, float]]] = {"open": [], "full": []}
    print("  RMS error over the bound (predicted σ over the actual)")
    print("    σ px, signal/noise, bound px    " + "".join(f"{name:>15}" for name in _names(quick)))
    for kind, s, signal in ((k, s, n) for k in worst for s in widths for n in signals):
        if kind == "full" and s < 1:
            continue  # A core of five full pixels would be 600 times as bright as a pixel holds.
        noise = _HEIGHT / signal
        height = _HEIGHT * (np.exp(2.5**2 / (2 * s * s)) if kind == "full" else 1.0)
        levels = _GROUND + height * profile(centre, s)
        image = levels + noise * random.standard_normal(levels.shape)
        scale = _TOP / _FULL if kind == "full" else 1.0
        image = np.rint(image.clip(0, _FULL if kind == "full" else _TOP) * scale).astype(np.uint16)
        least = _bound(centre, s, height, noise, _FULL if kind == "full" else 1e9)
        cells = ""
        for name in _names(quick):
            rms, sigma, bias = _errors(detect_stripe(image, _GREY, detector=name), centre)
            cells += f"{rms / least:8.2f} ({sigma / rms:4.2f})" if np.isfinite(rms) else f"{'–':>15}"
            if name == DEFAULT:
                worst[kind].append((rms / least, abs(np.log(sigma / rms)), bias))
        print(f"    {kind:5} {s:4} {signal:5} {least:9.4f}      {cells}", flush=True)
    free, full = (np.array(worst[kind]).max(axis=0) for kind in ("open", "full"))
    return [
        Metric("stripes.rms_over_bound", free[0], "", "lower", 1.15),
        Metric("stripes.rms_over_bound_full_core", full[0], "", "lower", 1.5),
        Metric("stripes.sigma_off", float(np.expm1(free[1])), "", "lower", 0.10, floor=0.03),
        Metric("stripes.sigma_off_full_core", float(np.expm1(full[1]))),
        Metric("stripes.bias", free[2], "px", "lower", 0.01, floor=0.003),
        Metric("stripes.bias_full_core", full[2], "px", "lower", 0.01, floor=0.003),
    ]


def profile(centre: Float[np.ndarray, "columns"], s: float) -> Float[np.ndarray, "rows columns"]:
    """A stripe of σ = s px and of height 1, each pixel its exact mean."""
    edges = (np.arange(_ROWS + 1)[:, None] - 0.5 - centre) / s
    return s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)


def _bound(centre: Float[np.ndarray, "columns"], s: float, height: float, noise: float, full: float) -> float:
    """Cramér and Rao's, px: root of the mean over the columns' phases, all four parameters unknown."""
    some = centre[:400]
    h = 1e-4
    J = np.stack(
        [
            np.ones((_ROWS, some.size)),
            profile(some, s),
            height * (profile(some, s + h) - profile(some, s - h)) / (2 * h),
            height * (profile(some + h, s) - profile(some - h, s)) / (2 * h),
        ],
        axis=-1,
    )
    # Information of a censored datum, in parts of a free one's, by the distance t of its mean from the limit.
    t = np.minimum((full - _GROUND - height * profile(some, s)) / noise, 30)
    censored = ndtr(t) - t * norm.pdf(t) + np.exp(2 * norm.logpdf(t) - norm.logsf(t))
    told = np.where(t < 30, censored, 1.0)
    information = np.einsum("kni,kn,knj->nij", J, told / noise**2, J)
    return float(np.sqrt(np.linalg.inv(information)[:, 3, 3].mean()))


def _errors(stripe: Stripe, centre: Float[np.ndarray, "columns"]) -> tuple[float, float, float]:
    """RMS error, RMS predicted σ, and the largest mean error over an eighth of a pixel's phases.

    Means are less what their own scatter explains. NaN where a detector finds less than nine in ten.
    """
    valid = np.asarray(stripe.valid[0])
    if valid.mean() < 0.9:
        return np.nan, np.nan, np.nan
    error = np.asarray(stripe.position[0], np.float64)[valid] - centre[valid]
    sigma = np.asarray(stripe.sigma[0], np.float64)[valid]
    phase = ((centre[valid] % 1) * _PHASES).astype(int)
    means = [
        max(abs(error[phase == i].mean()) - 3 * error[phase == i].std() / np.sqrt((phase == i).sum()), 0.0)
        for i in range(_PHASES)
    ]
    return float(np.sqrt((error**2).mean())), float(np.sqrt((sigma**2).mean())), max(means)


def step_of_reflectance(names: tuple[Detector, ...]) -> list[Metric]:
    """A stripe of σ 1.5 px that an edge of 10:1 crosses lengthwise, from 3 px before its centre to 3 px after."""
    columns, s, fine = _COLUMNS, 1.5, 25
    edge = np.linspace(-3, 3, columns)
    centre = np.full(columns, _ROWS / 2 + 0.3) + np.random.default_rng(1).uniform(-0.5, 0.5, columns)
    v = (np.arange(_ROWS * fine) + 0.5)[:, None] / fine - 0.5
    light = np.exp(-0.5 * ((v - centre) / s) ** 2) * np.where(v - centre < edge, 1.0, 0.1)
    image = _GROUND + _HEIGHT * light.reshape(_ROWS, fine, columns).mean(axis=1)
    image = np.rint(image + _HEIGHT / 100 * np.random.default_rng(2).standard_normal(image.shape)).astype(np.uint16)
    errors = {}
    for name in names:
        stripe = detect_stripe(image, _GREY, detector=name)
        error = np.asarray(stripe.position[0], np.float64) - centre
        errors[name] = float(np.sqrt(np.nanmean(error**2))) if np.isfinite(error).any() else np.nan
    share = errors[DEFAULT] / errors["gravity"]
    return [
        *(Metric(f"stripes.reflectance_step.{name}", rms, "px") for name, rms in errors.items()),
        Metric("stripes.reflectance_step.over_gravity", share, "", "lower", 0.5),
    ]


def spots() -> list[Metric]:
    """Frames with twenty round spots as bright as the stripe, which is there in every second fifth of the lines."""
    random = np.random.default_rng(3)
    rows, columns = 480, 640
    v, u = np.mgrid[:rows, :columns]
    lit = np.arange(columns) // (columns // 5) % 2 == 0
    centre = rows / 2 + 60 * np.sin(np.arange(columns) / 90)
    stripe = np.where(lit, 200 * np.exp(-0.5 * ((v - centre) / 1.5) ** 2), 0.0)
    strays = kept = whole = 0
    for _ in range(8):
        levels = 20 + stripe + 2 * random.standard_normal(stripe.shape)
        hidden = np.zeros(columns, bool)
        for column, row, s in random.uniform([0, 0, 1.0], [columns, rows, 3.0], (20, 3)):
            levels += 200 * np.exp(-0.5 * ((u - column) ** 2 + (v - row) ** 2) / s**2)
            hidden |= np.abs(np.arange(columns) - column) < 5 * s
        found = detect_stripe(np.rint(levels).clip(0, 255).astype(np.uint8), _GREY)
        near = found.valid[0] & (np.abs(found.position[0] - centre) < 2)
        strays += int((found.valid[0] & ~(near & lit)).sum())
        kept += int((near & lit & ~hidden).sum())
        whole += int((lit & ~hidden).sum())
    print(f"  160 round spots leave {strays} points")
    return [
        Metric("stripes.spots.points_of_each", strays / 160, "", "lower", 0.5, floor=0.1),
        Metric("stripes.spots.kept_of_the_stripe", kept / whole, "", "higher", 0.99),
    ]


def flat() -> list[Metric]:
    """The bare bed: how far each detector's stripe is from a straight line."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        print("  JAXSCAN_DATA is not set: no real bed")
        return []
    paths = sorted((Path(folder) / "stage-flat" / "frames").glob("*.jpg"))
    frames = np.stack([read_image(path) for path in paths])
    metrics = []
    for name in DETECTORS:
        stripe = detect_stripe(frames, StripeSettings("red", columns=False), detector=name)
        each = []
        for position in np.asarray(stripe.position, np.float64):
            row = np.flatnonzero(np.isfinite(position))
            line = np.polyfit(row, position[row], 1)
            each.append(np.sqrt(np.mean((position[row] - np.polyval(line, row)) ** 2)))
        label, rms = f"stripes.flat.{name}", float(np.median(each))
        if name == DEFAULT:
            metrics.append(Metric(label, rms, "px", "lower", 0.30))
            rows = float(np.asarray(stripe.valid).mean(axis=1).min())
            metrics.append(Metric("stripes.flat.rows", rows, "", "higher", 0.95))
        else:
            metrics.append(Metric(label, rms, "px"))
    return metrics
