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
between them have all of the stripe's curvature. Let Q_0 and Q_1 be the quotient of d² of odd by that of even pixels in
lines whose centre is nearest to an even and to an odd pixel. A stripe of any shape that passes all places among the
pixels has Q_0 Q_1 = 1, for what even pixels are to it in the ones odd pixels are in the others. Of a mosaic both are
small, or both large, whatever the interpolation, and whatever a program has sharpened since.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, UInt

from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.saturation import FULL
from jaxscan.images.stripes.settle import Band
from jaxscan.images.stripes.stripe import Stripe

# Pixels to either side of the peak from which the centre is estimated, and in which d is looked at; and of the window
# that shows the background.
_AROUND, _HALF = 3, 6
# Where d is looked at, of those that the window has.
_BEGIN: Final = _HALF - 1 - _AROUND
# The centre of a line is nearest to a pixel that is less than this away, px.
_NEAR_PX: Final = 0.5
# Pixels are interpolated if √(Q_0 Q_1) is less than this, or more than one over it, with this number of lines in each.
_LESS, _FEWEST = 0.3, 16
# Lines of each frame that are looked at, of either parity.
_LINES: Final = 160
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
    # Without the pixels that are full, those of a bell could be taken for a mosaic's: the whole of it is needed.
    whole = (inside == peak[:, lines]) & ~full[..., _BEGIN:-_BEGIN].any(axis=-1)
    squares = (r[..., 1:-1] - (r[..., :-2] + r[..., 2:]) / 2)[..., _BEGIN:-_BEGIN] ** 2
    light = np.maximum(r - np.median(r, axis=-1, keepdims=True), 0)
    from_peak = (light @ np.arange(-_HALF, _HALF + 1, dtype=np.float32)) / np.maximum(light.sum(axis=-1), 1e-9)
    odd = (at[..., 1:-1] % 2 == 1)[..., _BEGIN:-_BEGIN]
    # Of the pixels of parity 0 and 1 of each line.
    d2 = [(squares * which).sum(-1) / which.sum(-1) for which in (~odd, odd)]
    # Of lines whose centre is nearest to a pixel of parity 0 and 1: the quotient of parity 1's d² by parity 0's.
    phase = inside + from_peak
    quotient, told = np.ones((len(peak), 2)), np.ones((len(peak), 2), bool)
    for of in (0, 1):
        nearest = whole & (np.abs((phase - of + 1) % 2 - 1) < _NEAR_PX)
        even, uneven = (_mean(d2[parity], nearest) for parity in (0, 1))
        known = (nearest.sum(-1) >= _FEWEST) & (even > 0) & (uneven > 0)
        quotient[known] *= uneven[known] / even[known]
        told &= known
    both = np.sqrt(quotient)
    found = np.select([told & (both < _LESS), told & (both > 1 / _LESS)], [0, 1], NO_MOSAIC)
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
        if lines is not None and lines[0].ndim > 1:
            lines = (lines[0][all_of_them], lines[1][all_of_them])
        return detect(np.asarray(frames[:, *here])[all_of_them], beside, count=len(which), band=lines, mosaic=mosaic)

    for parity in np.unique(native):
        which = np.flatnonzero(native == parity)
        order.append(which)
        if parity == NO_MOSAIC:
            found.append(part(which, (slice(None), slice(None)), False, band))
            continue
        halves = []
        for of in (0, 1):
            lines = None if band is None else ((band[0][..., of::2] - parity) / 2, (band[1][..., of::2] - parity) / 2)
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
        2 * together("breadth"),
        together("valid"),
        together("verdict"),
        together("burnt"),
        light,
        halves[0].odd | halves[1].odd,
        np.maximum(halves[0].correlation, halves[1].correlation),
        halves[0].mosaic,
        halves[0].full,
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
    values: Float[np.ndarray, "frames 2 lines"], of: Bool[np.ndarray, "frames 2 lines"]
) -> Float[np.ndarray, "frames 2"]:
    """Over some lines."""
    return (values * of).sum(-1) / np.maximum(of.sum(-1), 1)
