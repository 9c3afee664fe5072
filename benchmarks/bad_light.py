"""Light as users have it: smoothed noise, flicker, lamps, exposures, laser profiles: σ against the scatter, and notes.

Stripes of σ 1, 1.5 and 2 px are drawn with exact pixel areas on an even ground, with noise of 3 and 6 grey levels and
with a speckle of contrast 0.2, and then smoothed, enlarged or compressed. What is said of light that changes is asked
of frames of a ball that passes before a wall.
"""

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt
from scipy.special import ndtr

from benchmarks.metric import Metric
from jaxscan.images import Stripe, StripeSettings, detect_stripe
from jaxscan.reconstruction.light_watch import LightWatch

_GREY, _RED = StripeSettings("grey"), StripeSettings("red")
_ROWS, _COLUMNS, _GROUND, _HEIGHT = 192, 960, 40.0, 160.0
# Stripe's σ in px, noise in grey levels, contrast of the speckle.
_CASES: Final = ((1.0, 3.0, 0.0), (2.0, 3.0, 0.0), (1.5, 6.0, 0.0), (1.5, 3.0, 0.2))
_LARGER: Final = 1.5

Image = UInt[np.ndarray, "rows columns"]
Levels = Float[np.ndarray, "rows columns"]


def measure(quick: bool) -> list[Metric]:
    """σ over the scatter under each filter; the same of each laser profile; what is said of light that changes."""
    return smoothed(2 if quick else 8) + profiles(2 if quick else 8) + said()


def _jpeg(quality: int) -> Callable[[Image], Image]:
    def compress(image: Image) -> Image:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))

    return compress


_FILTERS: Final[dict[str, Callable[[Image], Image]]] = {
    "none": lambda image: image,
    "box_3": lambda image: cv2.blur(image, (3, 3)),
    "gauss_0.7": lambda image: cv2.GaussianBlur(image, (0, 0), 0.7),
    "gauss_1": lambda image: cv2.GaussianBlur(image, (0, 0), 1.0),
    "enlarged_1.5": lambda image: cv2.resize(image, None, fx=_LARGER, fy=_LARGER, interpolation=cv2.INTER_CUBIC),
    "bilateral": lambda image: cv2.bilateralFilter(image, 5, 25, 2),
    "median_3": lambda image: cv2.medianBlur(image, 3),
    "jpeg_95": _jpeg(95),
    "jpeg_90": _jpeg(90),
    "jpeg_80": _jpeg(80),
}
# Filters that leave noise as a linear one does: for these σ has a goal.
_LINEAR: Final = ("none", "mean_of_4", "box_3", "gauss_0.7", "gauss_1", "enlarged_1.5")


def smoothed(count: int) -> list[Metric]:
    """σ over the scatter of so many photographs of each case, and the correlation that is said."""
    print("  predicted σ over the actual (correlation that is said): σ of the stripe, noise, speckle")
    print(" " * 18 + "".join(f"{f'{s:g} px, {noise:g}, {contrast:g}':>18}" for s, noise, contrast in _CASES))
    metrics = []
    for name in ("mean_of_4", *_FILTERS):
        ratios, cells, alike = [], "", 0
        for s, noise, contrast in _CASES:
            random, photographs = np.random.default_rng(5), []
            for _ in range(count):
                light = _speckled(s, contrast, random)
                several = [_photograph(light, noise, random) for _ in range(4 if name == "mean_of_4" else 1)]
                image = np.rint(np.mean(several, axis=0)).astype(np.uint8)
                photographs.append(image if name == "mean_of_4" else _FILTERS[name](image))
            stripe, centre = detect_stripe(np.stack(photographs), _GREY), _centre(np.arange(_COLUMNS))
            if name.startswith("enlarged"):
                columns = (np.arange(stripe.position.shape[1]) + 0.5) / _LARGER - 0.5
                centre = (_centre(columns) + 0.5) * _LARGER - 0.5
            ratios.append(_sigma_over_scatter(stripe, centre))
            alike += int(np.count_nonzero(stripe.correlation))
            cells += f"{ratios[-1]:11.2f} ({np.median(stripe.correlation):.2f})"
        print(f"    {name:14}{cells}", flush=True)
        off = float(np.exp(np.abs(np.log(ratios)).max()))
        goal = {"better": "lower", "target": 1.18, "floor": 0.05} if name in _LINEAR else {}
        metrics.append(Metric(f"bad_light.{name}.sigma_off", off, "", **goal))
        if name.startswith(("jpeg", "mean", "none")):
            metrics.append(Metric(f"bad_light.{name}.said_to_be_smoothed", alike, "", "lower", 0.0))
    return metrics


def profiles(count: int) -> list[Metric]:
    """Bias, scatter and σ of stripes whose cross section is no bell."""
    print("  laser's profile: bias px, scatter px, predicted σ over the scatter; stripe of σ about 1.6 px, noise 3")
    random, metrics = np.random.default_rng(6), []
    for name, parts in _PROFILES.items():
        light = np.sum([share * _profile(_centre(np.arange(_COLUMNS)) + at, s) for share, at, s in parts], axis=0)
        middle = sum(share * s * at for share, at, s in parts) / sum(share * s for share, _, s in parts)
        light *= _HEIGHT / light.max()
        stripe = detect_stripe(np.stack([_photograph(light, 3.0, random) for _ in range(count)]), _GREY)
        off = stripe.position - _centre(np.arange(_COLUMNS)) - middle
        bias = float(np.nanmean(off))
        scatter = float(np.nanstd(off))
        ratio = float(np.sqrt(np.nanmean(stripe.sigma**2))) / scatter
        print(f"    {name:14}{bias:8.3f}{scatter:8.3f}{ratio:8.2f}", flush=True)
        metrics.append(Metric(f"bad_light.profile.{name}.sigma_over_scatter", ratio))
    return metrics


# Bells that make up a profile: height, place and σ in px.
_PROFILES: Final = {
    "gaussian": ((1.0, 0.0, 1.6),),
    "flat": tuple((1.0, at, 0.8) for at in np.linspace(-2, 2, 9)),
    "two_lobed": ((1.0, -1.5, 0.9), (1.0, 1.5, 0.9)),
    "skewed": ((1.0, 0.0, 1.2), (0.5, 1.5, 1.6)),
    "side_lobes": ((1.0, 0.0, 1.6), (0.08, -5.0, 1.2), (0.08, 5.0, 1.2)),
}


def said() -> list[Metric]:
    """How many notes each fault of the light has; good light has none."""
    faults: dict[str, Callable[[int, Levels, Levels], Levels]] = {
        "good": lambda i, wall, laser: wall + laser,
        "laser_of_10_percent_ripple": lambda i, wall, laser: wall + laser * (1 + 0.1 * (-1) ** i),
        "flicker_of_20_percent": lambda i, wall, laser: wall * (1 + 0.2 * np.sin(_V / 20 + 2.3 * i)) + laser,
        "a_lamp_switched": lambda i, wall, laser: wall * (2 if i > 4 else 1) + laser,
        "exposures_not_listed": lambda i, wall, laser: (0.4, 1.0)[i % 2] * (wall + laser),
        "overexposed": lambda i, wall, laser: wall * (9 if i > 4 else 1) + laser,
    }
    metrics = []
    for name, fault in faults.items():
        random, frames = np.random.default_rng(0), []
        for i in range(8):
            ball = np.clip(1 - ((_V - 120) ** 2 + (_U - 80 - 20 * i) ** 2) / 60**2, 0, None)
            wall = np.where(ball > 0, 20 + 60 * np.sqrt(ball), 30 + _V / 12)
            laser = 90 * np.exp(-0.5 * ((_V - 130 - 8 * np.sin(_U / 60) - i) / 1.5) ** 2)
            levels = np.stack([fault(i, wall, part * laser) for part in (1, 0.02, 0.02)], axis=-1)
            frames.append(np.rint(levels + 2 * random.standard_normal(levels.shape)).clip(0, 255).astype(np.uint8))
        watch = LightWatch()
        watch.see(detect_stripe(np.stack(frames), _RED))
        notes = watch.notes(exposures_known=False, background=False)
        print(f"    {name}: {'; '.join(notes) or 'nothing is said'}")
        wanted = name not in ("good", "laser_of_10_percent_ripple")
        metrics.append(
            Metric(f"bad_light.said.{name}", len(notes), "", *(("higher", 1.0) if wanted else ("lower", 0.0)))
        )
    return metrics


_V, _U = np.mgrid[:240, :320].astype(float)


def _centre(columns: Float[np.ndarray, "columns"]) -> Float[np.ndarray, "columns"]:
    return _ROWS / 2 + 4 * np.sin(columns / 40)


def _profile(centre: Float[np.ndarray, "columns"], s: float) -> Levels:
    edges = (np.arange(_ROWS + 1)[:, None] - 0.5 - centre) / s
    return s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)


def _speckled(s: float, contrast: float, random: np.random.Generator) -> Levels:
    light = _HEIGHT * _profile(_centre(np.arange(_COLUMNS)), s)
    return light * random.gamma(contrast**-2, contrast**2, light.shape) if contrast else light


def _photograph(light: Levels, noise: float, random: np.random.Generator) -> Image:
    return np.rint((_GROUND + light + noise * random.standard_normal(light.shape)).clip(0, 255)).astype(np.uint8)


def _sigma_over_scatter(stripe: Stripe, centre: Float[np.ndarray, "columns"]) -> float:
    """Root mean squares, without the worst in five hundred."""
    error, sigma = np.abs(stripe.position - centre)[stripe.valid], stripe.sigma[stripe.valid]
    near = error <= np.quantile(error, 0.998)
    return float(np.sqrt((sigma[near] ** 2).mean() / (error[near] ** 2).mean()))
