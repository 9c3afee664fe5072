"""How many JPEGs are known by their blocks, by quality and noise, and how many photographs are taken for JPEGs.

Drawn stripes, level, sloping and bent, open and burnt out, in light and dark rooms, at full colour resolution, where
colours do not tell. What is no JPEG: as it is drawn, of a grey camera, from a mosaic of colours, blurred, kept in few
levels, with a gamma, enlarged; and a JPEG cut off its grid.
"""

import itertools
from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float, Int, UInt
from scipy.ndimage import gaussian_filter

from benchmarks.cup_jpeg import as_jpeg
from benchmarks.jpeg import draw
from benchmarks.metric import Metric
from jaxscan.images import StripeSettings
from jaxscan.images.stripes.blocks import has_blocks
from jaxscan.simulation.mosaic import through_mosaic

Photograph = UInt[np.ndarray, "rows columns *rgb"]
Drawn = tuple[Photograph, Int[np.ndarray, "columns"]]

_ROWS, _COLUMNS = 176, 640
_QUALITIES: Final = (98, 95, 92, 90, 85, 80, 75, 60, 50)
_NOISES: Final = (0.0, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
# What is no JPEG has more noise too.
_MORE_NOISES: Final = (0.1, 0.2, 0.4, 15.0)
# Rows for each column; height of the stripe and ambient light, grey levels; its σ, px.
_SLOPES: Final = (0.0, 0.003, 0.05, 0.3)
_PEAKS, _AMBIENTS, _WIDTHS = (180.0, 350.0), (40, 6), (0.5, 0.74, 1.1)
# Fewer distinct values than it takes are in the blocks of a stripe that is level all along and has no noise.
_SLOPING: Final = _SLOPES[2:]
_FULL: Final = _NOISES, _QUALITIES, 3, _WIDTHS


def measure(quick: bool) -> list[Metric]:
    """Three drawings of each kind; in the short form one of one width, in fewer noises and qualities."""
    noises, qualities, seeds, widths = (_NOISES[::3], _QUALITIES[::3], 1, _WIDTHS[1:2]) if quick else _FULL
    print("  JPEGs that are known, %, by quality and noise, grey levels: " + ", ".join(f"{n:g}" for n in noises))
    known: dict[int, list[float]] = {}
    for quality in qualities:
        known[quality] = [
            float(
                np.mean(
                    [_is_known(as_jpeg(x[None], quality, "444")[0], at) for x, at in _drawn(n, seeds, _SLOPING, widths)]
                )
            )
            for n in noises
        ]
        print(f"    {quality}  " + " ".join(f"{100 * share:4.0f}" for share in known[quality]), flush=True)
    metrics = [
        Metric(
            f"known_jpeg.quality_{quality}",
            float(np.mean(share)),
            "",
            "higher",
            0.95 if quality < 92 else None,
            floor=0.02,
        )
        for quality, share in known.items()
    ]
    for name, make in _NO_JPEGS.items():
        found = [
            _is_known(*make(*each))
            for noise in (*noises, *_MORE_NOISES)
            for each in _drawn(noise, seeds, _SLOPES, widths)
        ]
        print(f"  {name}: {sum(found)} of {len(found)} taken for JPEGs", flush=True)
        metrics.append(
            Metric(f"known_jpeg.taken_for_one.{name}", float(np.mean(found)), "", "lower", 0.001, floor=0.002)
        )
    return metrics


def _drawn(noise: float, seeds: int, slopes: tuple[float, ...], widths: tuple[float, ...]) -> list[Drawn]:
    """A photograph of each kind, and about where its stripe is in each column."""
    return [
        _draw(peak, ambient, slope, s, noise, seed)
        for peak, ambient, slope, s, seed in itertools.product(_PEAKS, _AMBIENTS, slopes, widths, range(seeds))
    ]


def _draw(peak: float, ambient: int, slope: float, s: float, noise: float, seed: int) -> Drawn:
    random, x = np.random.default_rng(seed), np.arange(_COLUMNS)
    bend = 3 * np.sin(x / 40) if slope else 0.0
    centre = _ROWS / 2 + random.uniform(-4, 4) + np.clip(slope * (x - _COLUMNS / 2), -60, 60) + bend
    photograph = draw("red", peak, (ambient, ambient, ambient), centre, s, random, _ROWS, noise)
    return photograph, np.rint(centre).astype(int)


def _is_known(photograph: Photograph, peak: Int[np.ndarray, "columns"]) -> bool:
    color = "red" if photograph.ndim > 2 else "grey"
    return has_blocks(np.ascontiguousarray(photograph), StripeSettings(color), peak)


def _rounded(levels: Float[np.ndarray, "rows columns 3"]) -> Photograph:
    return np.rint(levels).astype(np.uint8)


_NO_JPEGS: Final[dict[str, Callable[[Photograph, Int[np.ndarray, "columns"]], Drawn]]] = {
    "drawn": lambda x, at: (x, at),
    "grey": lambda x, at: (x[..., 0], at),
    "mosaic": lambda x, at: (through_mosaic(x), at),
    "blurred": lambda x, at: (_rounded(gaussian_filter(x.astype(float), (0.6, 0.6, 0))), at),
    "few_levels": lambda x, at: (x // 4 * 4, at),
    "gamma": lambda x, at: (_rounded(255 * (x / 255) ** 0.45), at),
    "enlarged": lambda x, at: (x.repeat(2, axis=0).repeat(2, axis=1), (2 * at).repeat(2)),
    "jpeg_off_its_grid": lambda x, at: (as_jpeg(x[None], 90, "444")[0][3:, 5:], at[5:] - 3),
}
