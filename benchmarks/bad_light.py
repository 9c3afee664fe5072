"""Photographs as users take them: smoothed noise, flicker, lamps, laser profiles, shaken boards: σ, and what is said.

Stripes of σ 1, 1.5 and 2 px are drawn with exact pixel areas on an even ground, with noise of 3 and 6 grey levels and
with a speckle of contrast 0.2, and then smoothed, enlarged or compressed. What is said of light that changes is asked
of frames of a ball that passes before a wall. Boards that a hand holds are those of the simulated rig of 2003.
"""

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt
from scipy.special import ndtr

from benchmarks.metric import Metric
from benchmarks.shaken import moved, smeared
from jaxscan.images import Stripe, StripeSettings, detect_stripe
from jaxscan.images.hot_pixels import HOT_FRAMES, HotPixels
from jaxscan.reconstruction.light_watch import LightWatch
from jaxscan.simulation.laser_profiles import LASER_PROFILES, bells

_GREY, _RED = StripeSettings("grey"), StripeSettings("red")
_ROWS, _COLUMNS, _GROUND, _HEIGHT = 192, 960, 40.0, 160.0
# Stripe's σ in px, noise in grey levels, contrast of the speckle.
_CASES: Final = ((1.0, 3.0, 0.0), (2.0, 3.0, 0.0), (1.5, 6.0, 0.0), (1.5, 3.0, 0.2))
_LARGER: Final = 1.5
# Parts of the pixels that are hot.
_HOT: Final = (0.0, 1e-4, 5e-4, 1e-3)

Image = UInt[np.ndarray, "rows columns"]
Levels = Float[np.ndarray, "rows columns"]


def measure(quick: bool) -> list[Metric]:
    """σ over the scatter under each filter, of each laser profile, of boards in a hand; what is said of all these."""
    count = 2 if quick else 8
    return smoothed(count) + hot_pixels() + profiles(count) + said() + smeared(quick) + moved(quick)


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
    """Predicted σ over the scatter of `count` photographs of each case, and the correlation that is reported."""
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
        off = _off(*ratios)
        goal = {"better": "lower", "target": 1.18, "floor": 0.05} if name in _LINEAR else {}
        metrics.append(Metric(f"bad_light.{name}.sigma_off", off, "", **goal))
        if name.startswith(("jpeg", "mean", "none")):
            metrics.append(Metric(f"bad_light.{name}.said_to_be_smoothed", alike, "", "lower", 0.0))
    return metrics


def hot_pixels() -> list[Metric]:
    """Scatter and σ over it where some pixels of the sensor are hot, as they come and with those that are found out."""
    s, noise, contrast = _CASES[-1]
    print(f"  hot pixels, stripe of σ {s:g} px, speckle {contrast:g}: scatter px (σ over it) as they come; left out")
    metrics = []
    for share in _HOT:
        random = np.random.default_rng(7)
        levels = [np.roll(_speckled(s, contrast, random), i, axis=0) for i in range(HOT_FRAMES)]
        hot = random.random(levels[0].shape) < share
        # From a tenth of the stripe's height to three times it.
        extra = hot * _HEIGHT * 10 ** random.uniform(-1, 0.5, hot.shape)
        photographs = np.stack([_photograph(each + extra, noise, random) for each in levels])
        corrected = photographs.copy()
        HotPixels(columns=True).correct(corrected)
        cells = ""
        for name, images in (("as_they_come", photographs), ("left_out", corrected)):
            stripe = detect_stripe(images, _GREY)
            off = stripe.position - _centre(np.arange(_COLUMNS)) - np.arange(HOT_FRAMES)[:, None]
            scatter = float(np.nanstd(off))
            ratio = float(np.sqrt(np.nanmean(stripe.sigma**2))) / scatter
            cells += f"{scatter:9.3f} ({ratio:.2f})"
            goal = {"better": "lower", "target": 1.18, "floor": 0.05} if name == "left_out" else {}
            stem = f"bad_light.hot_{1e6 * share:.0f}_ppm.{name}"
            metrics += [Metric(f"{stem}.scatter", scatter, "px"), Metric(f"{stem}.sigma_off", _off(ratio), "", **goal)]
        print(f"    {1e6 * share:5.0f} in a million{cells}", flush=True)
    return metrics


def _off(*ratios: float) -> float:
    """The furthest of them from 1, as a factor."""
    return float(np.exp(np.abs(np.log(ratios)).max()))


def profiles(count: int) -> list[Metric]:
    """Scatter, σ and what is said of stripes of each cross-section, by the default detector and by gravity."""
    print("  laser's profile, σ about 1.6 px, noise 3: bias px, scatter px, σ over the scatter; frames said odd")
    metrics, columns = [], np.arange(_COLUMNS)
    for light, (height, contrast) in _LIGHTS.items():
        for kind in LASER_PROFILES:
            random = np.random.default_rng(6)
            parts = bells(kind) * [1.0, _SHEET_PX, _SHEET_PX]
            bright = np.sum([share * _profile(_centre(columns) + at, s) for share, at, s in parts], axis=0)
            # The centre of gravity of each profile is at 0.
            levels = [height * bright / bright.max() * _grain(bright.shape, contrast, random) for _ in range(count)]
            photographs = np.stack([_photograph(each, 3.0, random) for each in levels])
            cells = ""
            for detector in ("likelihood", "gravity"):
                stripe = detect_stripe(photographs, _GREY, detector=detector)
                off = stripe.position - _centre(columns)
                bias, scatter = float(np.nanmedian(off)), float(np.nanstd(off))
                ratio = float(np.sqrt(np.nanmean(stripe.sigma**2))) / scatter
                cells += f"{bias:9.3f}{scatter:8.3f}{ratio:7.2f}"
                name = f"bad_light.profile.{light}.{kind}.{detector}"
                metrics += [Metric(f"{name}.scatter", scatter, "px"), Metric(f"{name}.sigma_over_scatter", ratio)]
                if detector == "likelihood":
                    said = float(stripe.odd.mean())
                    goal = ("lower", 0.0) if kind == "gaussian" else ("shown", None)
                    metrics.append(Metric(f"{name}.said", said, "", *goal))
                    cells += f"{said:6.2f}"
            print(f"    {light:12}{kind:12}{cells}", flush=True)
    return metrics


# σ of the sheet, px, and of each light the height in grey levels and the speckle's contrast.
_SHEET_PX: Final = 1.6
_LIGHTS: Final = {"even": (_HEIGHT, 0.0), "speckled": (_HEIGHT, 0.2), "burnt_out": (900.0, 0.2)}


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
        notes = watch.notes(exposures_known=False, background=False, grey=False)
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
    return light * _grain(light.shape, contrast, random)


def _grain(shape: tuple[int, ...], contrast: float, random: np.random.Generator) -> Levels | float:
    return random.gamma(contrast**-2, contrast**2, shape) if contrast else 1.0


def _photograph(light: Levels, noise: float, random: np.random.Generator) -> Image:
    return np.rint((_GROUND + light + noise * random.standard_normal(light.shape)).clip(0, 255)).astype(np.uint8)


def _sigma_over_scatter(stripe: Stripe, centre: Float[np.ndarray, "columns"]) -> float:
    """Root mean squares, without the worst in five hundred."""
    error, sigma = np.abs(stripe.position - centre)[stripe.valid], stripe.sigma[stripe.valid]
    near = error <= np.quantile(error, 0.998)
    return float(np.sqrt((sigma[near] ** 2).mean() / (error[near] ** 2).mean()))
