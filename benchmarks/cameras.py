"""A stripe as cameras show it: error of its place over that of the plain centre of gravity, and σ over the error.

Eight drawn frames of a red stripe on textured ground, which bends, steps and moves, as in `video`. The light falls on a
sensor with read noise and shot noise, and comes as a photograph of 8 bits in one of many ways: numbers that are encoded
for a display, pixels that are not alike, a lens that is out of focus, a picture that is scaled. Four widths, three
heights of which the last is burnt out, with speckle and without. Of each way the table has the least and the greatest
of these. Errors beyond half a pixel are counted apart.
"""

from collections.abc import Callable
from itertools import product
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt

from benchmarks.cup_jpeg import Against, as_jpeg
from benchmarks.frame_sigma import HIGH, LOW
from benchmarks.metric import Metric
from benchmarks.mosaic import encoded, sharpened
from benchmarks.video import COLOURS, beside_no_step, moving_light, texture

_FRAMES: Final = 8
# Standard deviation of the stripe, px; its height, of a pixel that is full from 255 on.
_WIDTHS, _HEIGHTS, _SPECKLES = (0.8, 1.2, 2.0, 3.5), (60.0, 170.0, 600.0), (0.2, 0.0)
_QUICK: Final = ((0.2, 1.2, 600.0), (0.2, 2.0, 170.0))
_QUICK_KINDS: Final = ("uneven pixels", "out of focus, 3 px", "full at 200")
# Light of the scene and how it varies; the sensor's noise, and its variance for each level of light.
_GROUND, _VARIES, _READ, _SHOT = 12.0, 3.6, 1.0, 0.02
_GOAL: Final = 1.05

Light = Float[np.ndarray, "frames rows columns 3"]
Levels = Float[np.ndarray, "frames rows columns *rgb"]
Photographs = UInt[np.ndarray, "frames rows columns 3"]
Where = Float[np.ndarray, "frames columns"]


def measure(quick: bool) -> list[Metric]:
    """Every way of a camera; in the short form three of them with two stripes."""
    cases = _QUICK if quick else list(product(_SPECKLES, _WIDTHS, _HEIGHTS))
    metrics = []
    print("  way: RMS px, over gravity, σ over the error, further off % (of gravity); from the least to the greatest")
    for kind in _QUICK_KINDS if quick else KINDS:
        rows = []
        for speckle, width, height in cases:
            photographs, truth, asked = KINDS[kind](width, height, speckle)
            found = Against.create(photographs, truth, asked)
            rows.append((found.rms, found.rms / found.other, found.sigma, found.far, found.far_other))
            way = kind.replace("… ", "").replace(", ", "_").replace(" ", "_").replace(":", "")
            metrics += found.metrics(f"cameras.{way}.speckle_{speckle:g}.width_{width:g}.height_{height:g}", _GOAL)
        low, high = np.min(rows, axis=0), np.max(rows, axis=0)
        within = np.mean([LOW <= row[2] <= HIGH for row in rows])
        print(
            f"    {kind:28s} {low[0]:.3f} to {high[0]:.3f}   {low[1]:.2f} to {high[1]:.2f}   {low[2]:.2f} to "
            f"{high[2]:.2f} ({100 * within:.0f} % within)   {high[3]:.1f} ({high[4]:.1f})",
            flush=True,
        )
    return metrics


def _scene(
    width: float, height: float, speckle: float, psf: Float[np.ndarray, "n n"] | None = None
) -> tuple[Light, Where, Bool[np.ndarray, "frames columns"], np.random.Generator]:
    """Light without noise, where the stripe is, which columns are asked, and chance."""
    random = np.random.default_rng(1)
    pairs = list(moving_light(width, height, speckle, random, _FRAMES))
    ground = texture(_GROUND, _VARIES)[..., None]
    light = np.stack([ground + laser[..., None] * COLOURS for laser, _ in pairs])
    if psf is not None:
        light = np.stack([cv2.filter2D(frame, -1, psf, borderType=cv2.BORDER_REPLICATE) for frame in light])
    return light, np.stack([centre for _, centre in pairs]), beside_no_step(_FRAMES), random


def on_sensor(light: Levels, random: np.random.Generator, full: float = 255.0, read: float = _READ) -> Levels:
    """Levels of light, with read noise and shot noise, up to a full pixel."""
    noise = np.sqrt(read**2 + _SHOT * np.maximum(light, 0.0)) * random.standard_normal(light.shape)
    return (light + noise).clip(0, full)


def rounded(levels: Levels) -> UInt[np.ndarray, "frames rows columns *rgb"]:
    """Photographs of 8 bits."""
    return np.rint(levels.clip(0, 255)).astype(np.uint8)


def _contrast(levels: Light) -> Light:
    """A tone curve that is steep in the middle and flat at its ends."""
    x = levels / 255
    return 255 * (x + 0.35 * x * (1 - x) * (2 * x - 1))


def _halved(levels: Light) -> Light:
    """Scaled down by the mean of four."""
    return (levels[:, ::2, ::2] + levels[:, 1::2, ::2] + levels[:, ::2, 1::2] + levels[:, 1::2, 1::2]) / 4


def disc(radius: float) -> Float[np.ndarray, "n n"]:
    """What a lens out of focus makes of a point."""
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    kernel = (radius + 0.5 - np.hypot(x, y)).clip(0, 1)
    return kernel / kernel.sum()


Way = Callable[[Light, np.random.Generator], Photographs]


def _as(way: Way, psf: Float[np.ndarray, "n n"] | None = None, full: float = 255.0) -> Callable[..., tuple]:
    def photographs(width: float, height: float, speckle: float) -> tuple[Photographs, Where, np.ndarray]:
        light, where, asked, random = _scene(width, height, speckle, psf)
        return way(on_sensor(light, random, full), random), where, asked

    return photographs


def _in_half_size(width: float, height: float, speckle: float) -> tuple[Photographs, Where, np.ndarray]:
    """Of twice the width, encoded, and scaled down: what is asked is a pixel's own centre."""
    light, where, asked, random = _scene(2 * width, height, speckle)
    photographs = rounded(_halved(encoded(rounded(on_sensor(light, random)).astype(np.float64))))
    pairs = (where[:, ::2] + where[:, 1::2]) / 2
    return photographs, (pairs - 0.5) / 2, asked[:, ::2] & asked[:, 1::2]


def _uneven(levels: Light, random: np.random.Generator) -> Photographs:
    """Each pixel has a gain and an offset of its own, behind where it is full."""
    gain = 1 + 0.03 * random.standard_normal(levels.shape[1:3])
    return rounded(levels * gain[None, ..., None] + 2 * random.standard_normal(levels.shape[1:3])[None, ..., None])


def _hot(levels: Light, random: np.random.Generator) -> Photographs:
    """One pixel of a thousand shines by itself."""
    return rounded(levels + 80 * (random.random(levels.shape[1:]) < 0.001)[None])


KINDS: Final[dict[str, Callable[..., tuple[Photographs, Where, np.ndarray]]]] = {
    "as it is": _as(lambda x, _: rounded(x)),
    "encoded for a display": _as(lambda x, _: rounded(encoded(x))),
    "… with a tone curve": _as(lambda x, _: rounded(_contrast(encoded(x)))),
    "… as JPEG 4:2:0": _as(lambda x, _: as_jpeg(rounded(encoded(x)), 90, "420")),
    "… as JPEG 4:4:4": _as(lambda x, _: as_jpeg(rounded(encoded(x)), 90, "444")),
    "… in half the size": _in_half_size,
    "uneven pixels": _as(_uneven),
    "noise of rows": _as(lambda x, random: rounded(x + 3 * random.standard_normal((len(x), x.shape[1], 1, 1)))),
    "noise of columns": _as(lambda x, random: rounded(x + 3 * random.standard_normal((len(x), 1, x.shape[2], 1)))),
    "hot pixels": _as(_hot),
    "white balance": _as(lambda x, _: rounded(np.rint(x * (0.5, 1, 0.6)) * (2, 1, 1.67))),
    "full at 200": _as(lambda x, random: rounded(x + random.standard_normal(x.shape)), full=200.0),
    "sharpened": _as(lambda x, _: rounded(np.stack([sharpened(frame, 0.8) for frame in x]))),
    "out of focus, 2 px": _as(lambda x, _: rounded(x), disc(2.0)),
    "out of focus, 3 px": _as(lambda x, _: rounded(x), disc(3.0)),
    "… as JPEG 4:4:4, 3 px": _as(lambda x, _: as_jpeg(rounded(x), 90, "444"), disc(3.0)),
    "… as JPEG 4:2:0, 3 px": _as(lambda x, _: as_jpeg(rounded(encoded(x)), 90, "420"), disc(3.0)),
    "out of focus, 4.5 px": _as(lambda x, _: rounded(x), disc(4.5)),
}
