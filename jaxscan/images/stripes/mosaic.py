"""Photographs of a sensor with a mosaic of colour filters, and how the stripe is measured in them.

Each pixel of most colour cameras sees one colour, in a pattern of 2 x 2 (B. E. Bayer 1976), and the other two are
interpolated from its neighbours. Of red or blue light every second pixel along a line is
then about the mean of the two beside it, and a stripe that is not much wider than that is no bell any more: its centre
moves by up to 0.2 px to and fro as it passes from pixel to pixel. Those pixels of a line that saw the laser, or where
none of its own did, lie beside those that did, are a sampling of the bell at every second place: a photograph of half
the size, whose noise is that of the sensor. A mosaic makes two of them, of its even and of its odd lines, and each is
measured as any photograph is. Green is seen by every second pixel of each line: what lies between is made of all four
neighbours, and is best left in.

With r the response along a line and d_k = r_k − (r_(k−1) + r_(k+1)) / 2, an interpolated pixel has d near 0, and those
between them all of the stripe's curvature. Where a stripe's centre is next to an interpolated pixel, a stripe of no
mosaic has the larger d just there: so the two cannot be mistaken for each other, whatever the interpolation, and
whatever a program has sharpened since.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, UInt

from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.settle import Band
from jaxscan.images.stripes.stripe import Stripe
from jaxscan.images.stripes.survey import FULL

# Pixels to either side of the peak from which the centre is estimated, and in which d is looked at; and of the window
# that shows the background.
_AROUND, _HALF = 3, 6
# Where d is looked at, of those that the window has.
_BEGIN: Final = _HALF - 1 - _AROUND
# A line counts whose centre is nearer than this to a pixel that may be interpolated, px.
_NEAR_PX: Final = 0.5
# Pixels are interpolated if the mean square of their d is less than this part of that of the pixels between them, over
# at least this number of lines. Where there is no mosaic it is 1.09 or more, of a bell of any width.
_LESS, _FEWEST = 0.4, 16
# A stripe that stays at one place may never be next to an interpolated pixel. Then the part is less than that of a bell
# of any width that is level: 0.007 at the least, of s = 0.83 px.
_EXACTLY: Final = 0.001
# Lines of each frame that are looked at, of either parity.
_LINES: Final = 96
# Where no parity is taken.
NO_MOSAIC: Final = -1


def native_pixels(
    frames: np.ndarray | Array,
    dark: np.ndarray | Array | None,
    settings: StripeSettings,
    peak: Int[np.ndarray, "frames lines"],
    taken: Bool[np.ndarray, "frames"],
    *,
    alike: bool = False,
) -> Int[np.ndarray, "frames"] | None:
    """Which pixels along the lines show the laser as the sensor saw it: those of parity 0 or 1.

    Args:
        frames: the photographs, of which there may be more than `peak` is of; lines of 15 pixels or more.
        dark: the same with the laser off, one for all or one for each, or None.
        settings: the laser's colour, and which way lines run.
        peak: about where the stripe is in each line.
        taken: in which frames the native pixels would be taken: in others no mosaic is looked for.
        alike: whether all frames go together, as the greater part of them does.

    Returns:
        The parity of each frame, `NO_MOSAIC` where the photograph shows none; None where no photograph does.
    """
    found = np.full((len(peak), 2), NO_MOSAIC)
    pairs = peak.shape[1] // 2
    length = frames.shape[1 if settings.columns else 2]
    if settings.color == "grey" or frames.ndim == 3 or pairs < _FEWEST:
        return None
    # The same number of even and of odd lines, evenly spread: (frames, 2, lines, window).
    lines = 2 * np.linspace(0, pairs - 1, min(pairs, _LINES)).astype(int) + np.array([[0], [1]])
    inside = np.clip(peak[:, lines], _HALF + 1, length - _HALF - 2)
    at = inside[..., None] + np.arange(-_HALF, _HALF + 1)
    numbers = _pixels(frames, at, lines[..., None], settings)
    full = numbers >= FULL * np.iinfo(numbers.dtype).max
    r = numbers.astype(np.float32)
    if dark is not None:
        r -= _pixels(dark, at, lines[..., None], settings)
    # A pixel that is full has lost what it could say, and so have those that it was made of.
    some = (inside == peak[:, lines])[..., None] & ~(full[..., :-2] | full[..., 1:-1] | full[..., 2:])
    some = some[..., _BEGIN:-_BEGIN]
    squares = np.where(some, (r[..., 1:-1] - (r[..., :-2] + r[..., 2:]) / 2)[..., _BEGIN:-_BEGIN], 0) ** 2
    light = np.maximum(r - np.median(r, axis=-1, keepdims=True), 0)
    from_peak = (light @ np.arange(-_HALF, _HALF + 1, dtype=np.float32)) / np.maximum(light.sum(axis=-1), 1e-9)
    odd = (at[..., 1:-1] % 2 == 1)[..., _BEGIN:-_BEGIN]
    # Of the pixels of parity 0 and 1: sums over a line, and numbers of pixels.
    d2, count = (np.stack([(x * ~odd).sum(-1), (x * odd).sum(-1)]) for x in (squares, some))
    for native in (1, 0):
        of, others = 1 - native, native
        # How far the centre is from the next pixel of the other parity.
        near = np.abs((inside % 2 + from_peak - of + 1) % 2 - 1) < _NEAR_PX
        parts = [
            np.where(lines_of.sum(-1) >= _FEWEST, _mean(d2[of], count[of], lines_of), np.inf)
            < less * _mean(d2[others], count[others], lines_of)
            for lines_of, less in ((near, _LESS), (np.ones_like(near), _EXACTLY))
        ]
        found[parts[0] | parts[1]] = native
    # Of green light the pixels of neighbouring lines differ in parity: those are left as they are.
    found = np.where((found[:, 0] == found[:, 1]) & taken, found[:, 0], NO_MOSAIC)
    if alike:
        values, counts = np.unique(found, return_counts=True)
        found[:] = values[np.argmax(counts)]
    return None if (found == NO_MOSAIC).all() else found


def half_of(columns: bool, parity: int, of: int) -> tuple[slice, slice]:
    """The native pixels, those of a parity, of a photograph's even (`of` 0) or odd (1) lines."""
    along, across = slice(parity, None, 2), slice(of, None, 2)
    return (along, across) if columns else (across, along)


def of_mosaics(
    frames: np.ndarray | Array,
    dark: np.ndarray | Array | None,
    columns: bool,
    native: Int[np.ndarray, "frames"],
    band: Band | None,
    detect: Callable[..., Stripe],
    around: tuple[np.ndarray, np.ndarray],
) -> Stripe:
    """The stripe in frames of which some have a mosaic, each part of them measured by itself.

    Args:
        frames: the photographs, of which there may be more than `native` is of.
        dark: the same with the laser off, one for all or one for each, or None.
        columns: whether lines are columns.
        native: as `native_pixels` gives it.
        band: the first and last row (or column) of each line at which there can be a stripe, or None.
        detect: the stripe in a part of them, from its frames, `dark`, `count`, `band`, and whether it has a `mosaic`.
        around: the share of full pixels, and the surroundings, of all frames.
    """
    alone = dark is None or len(dark) == 1
    found, order = [], []

    def part(which: np.ndarray, here: tuple[slice, slice], mosaic: bool, lines: Band | None) -> Stripe:
        # Another number of frames would compile again.
        all_of_them = np.resize(which, len(frames))
        beside = None if dark is None else np.asarray(dark[:, *here])
        beside = beside if beside is None or alone else beside[all_of_them]
        return detect(np.asarray(frames[:, *here])[all_of_them], beside, count=len(which), band=lines, mosaic=mosaic)

    for parity in np.unique(native):
        which = np.flatnonzero(native == parity)
        order.append(which)
        if parity == NO_MOSAIC:
            found.append(part(which, (slice(None), slice(None)), False, band))
            continue
        halves = []
        for of in (0, 1):
            lines = None if band is None else ((band[0][of::2] - parity) / 2, (band[1][of::2] - parity) / 2)
            halves.append(part(which, half_of(columns, parity, of), True, lines))
        found.append(_interleaved(halves, parity))
    back = np.argsort(np.concatenate(order))
    joined = Stripe.joined(
        [replace(one, surroundings=around[1][which]) for one, which in zip(found, order, strict=True)]
    )
    return replace(joined[back], full=around[0])


def _interleaved(halves: Sequence[Stripe], parity: int) -> Stripe:
    """The stripe of even and odd lines together, in pixels of the photograph."""
    lines = sum(half.position.shape[1] for half in halves)

    def together(name: str) -> Any:
        values = [getattr(half, name) for half in halves]
        out = np.empty((len(values[0]), lines), values[0].dtype)
        out[:, 0::2], out[:, 1::2] = values
        return out

    # Lines that saw the laser themselves have the sensor's own noise, the others that of a mean of two.
    reads = np.stack([half.light[:, 0] for half in halves])
    lit = np.where(reads[0] >= np.nan_to_num(reads[1]), 0, 1)
    light = np.stack([half.light for half in halves])[lit, np.arange(len(lit))]
    return Stripe(
        2 * together("position") + parity,
        2 * together("sigma"),
        together("strength"),
        2 * together("width"),
        together("valid"),
        together("verdict"),
        together("burnt"),
        light,
        halves[0].odd | halves[1].odd,
        np.maximum(halves[0].correlation, halves[1].correlation),
        halves[0].full,
        halves[0].mosaic,
        halves[0].surroundings,
    )


def _pixels(
    frames: np.ndarray | Array,
    at: Int[np.ndarray, "frames 2 lines window"],
    lines: np.ndarray,
    settings: StripeSettings,
) -> UInt[np.ndarray, "frames 2 lines window"]:
    """Levels of the laser's channel; of one photograph for all frames, too."""
    of = np.arange(len(at)).reshape(-1, 1, 1, 1) if len(frames) > 1 else 0
    laser = CHANNELS[settings.color][0]
    return np.asarray(frames[(of, at, lines, laser) if settings.columns else (of, lines, at, laser)])


def _mean(
    sums: Float[np.ndarray, "frames 2 lines"],
    count: Int[np.ndarray, "frames 2 lines"],
    which: Bool[np.ndarray, "frames 2 lines"],
) -> Float[np.ndarray, "frames 2"]:
    """Over the pixels of some lines."""
    return (sums * which).sum(-1) / np.maximum((count * which).sum(-1), 1)
