"""Where the laser stripe is: one position for each image column (or row), to a fraction of a pixel.

`coarse` reduces the images to a peak for each block of rows and chooses among them; `windows` gathers the pixels about
the peak, `survey` learns from some of them what the sensor is like, and a detector measures the centre. They are
compiled apart, for in one piece a compiler on a CPU computes each step again for every use of it in the next. Where
the window was too narrow for the stripe, the stripe is burnt out or an edge runs along it, lines are measured again by
themselves.

There is a stripe where the peak stands above its background by so many times the frame's noise, with both its flanks.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from itertools import cycle
from math import prod
from typing import Any, Final

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int

from jaxscan.detectors import DEFAULT, Choice, Detector
from jaxscan.errors import InputError
from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.candidates import candidates, choose
from jaxscan.images.stripes.coarse import choose_peaks, coarse_peaks
from jaxscan.images.stripes.detectors import Measured, Model, measure
from jaxscan.images.stripes.evidence import edges_go_on
from jaxscan.images.stripes.likelihood import FWHM
from jaxscan.images.stripes.survey import LEAST_SIGNAL, light_of, survey
from jaxscan.images.stripes.windows import gather_windows

# Frames that are looked at together.
FRAMES_AT_ONCE: Final = 16
# Half windows, px: the wide one holds stripes up to some 60 px wide.
_NARROW, _WIDE = 12, 40
_LEAST_STRENGTH = 10.0
# Of the frame's M + N, below the part of the frame that a burnt-out stripe may take; told from about so many pixels.
_AMBIENT_QUANTILE = 0.97
_SOME_PIXELS = 1200
# The part of a frame's lines that are burnt out, beyond which no edges are looked for in the others.
_MOSTLY_BURNT = 0.3
# Lines are measured in groups of so many, whatever the image: few sizes are compiled. Large ones cost less a line, by
# what it takes two cores to begin together; those few that are looked at again would not fill them.
_GROUPS: Final = (4, 128), (20, 512)
_GROUPS_AGAIN: Final = (4, 64), (8, 512)
_FEW = 8
# Points of a stripe follow one another within so many lines, off by no more than so much and a steep slope. It is so
# much longer than it is thick, and longer than so many lines.
_GAP, _COMPANY_PX, _STEEPEST = 4, 2.0, 4.0
_LONGER, _SHORTEST = 1.5, 2.5
# A lens's flare, and a JPEG's blocks of 16 pixels, echo the end of a bright stripe so faintly at the most, no further.
_ECHO, _ECHO_PX = 1 / 8, 16
# Where a surface ends it is half as bright as it is further in, whatever blurs it: what is dimmer is light spilt beyond
# its end. So many lines further in are asked, and so many are left out at most.
_SPILT, _FURTHER_IN, _MOST_SPILT = 0.5, 2, 3


@dataclass(frozen=True)
class Stripe:
    """The stripe in a batch of frames, one entry for each image column (or for each row, as the settings say).

    Attributes:
        position: its centre, the row v of each column (the column u of each row), px; NaN where it is not valid.
        sigma: the predicted standard deviation of the position, px; NaN where it is not valid.
        strength: its peak, smoothed over five pixels, above the local background: grey levels of 2 L − (M + N), L the
            laser's channel, or of the intensity.
        width: full width at half the height, px; NaN where it is not valid.
        valid: whether there is a stripe, with both flanks on the image and with company in the neighbouring lines.
        light: read noise, gain, speckle contrast and saturation of each frame (`images.light`); NaN without a stripe.
    """

    position: Float32[np.ndarray, "frames lines"]
    sigma: Float32[np.ndarray, "frames lines"]
    strength: Float32[np.ndarray, "frames lines"]
    width: Float32[np.ndarray, "frames lines"]
    valid: Bool[np.ndarray, "frames lines"]
    light: Float32[np.ndarray, "frames 4"]


def detect_stripe(
    images: np.ndarray | Array,
    settings: StripeSettings,
    background: np.ndarray | Array | None = None,
    *,
    detector: Detector = DEFAULT,
    choice: Choice = "strongest",
    count: int | None = None,
) -> Stripe:
    """Find the laser stripe in one photograph or in a batch of them.

    Args:
        images: (rows, columns) grey, (rows, columns, 3) RGB, or a batch of either with the frames first; 8 or 16 bits.
        settings: the laser's colour, and whether there is one point for each column or for each row.
        background: the scene with the laser off: one image for all frames, or one for each.
        detector: how the centre is measured.
        choice: which is taken where there are several in a line.
        count: how many of the images are looked at, the first ones; all by default. A buffer that keeps its size and
            is not always full compiles nothing anew.

    Returns:
        The stripe in the first `count` images.

    Raises:
        InputError: shapes, depths or colour do not go together.
    """
    frames = _batch(images, settings, "the image")
    dark = None if background is None else _batch(background, settings, "the background")
    if dark is not None:
        _check_background(frames, dark)
    devices = jax.local_devices()
    count = len(frames) if count is None else count

    def piece(first: int, device: Any) -> Stripe:
        # The last piece begins early enough to be as long as the others, for another length would compile anew.
        begin = max(0, min(first, len(frames) - length))
        some, inner = slice(begin, begin + length), slice(first - begin, None)
        with jax.default_device(device):
            found = _detect(
                frames[some],
                dark if dark is None or len(dark) == 1 else dark[some],
                settings,
                detector,
                choice,
                min(count - begin, length),
            )
        return found if first == begin else Stripe(*(getattr(found, f.name)[inner] for f in fields(Stripe)))

    # Frames are looked at each by itself, so several devices share them without a word to one another; a choice that
    # depends on the frames beside it keeps them together.
    shares = 1 if choice == "coherent" else len(devices)
    length = min(FRAMES_AT_ONCE, -(-len(frames) // shares))
    firsts = range(0, count, length)
    if len(devices) == 1 or len(firsts) == 1:
        found = [piece(first, devices[0]) for first in firsts]
    else:
        with ThreadPoolExecutor(len(devices)) as pool:
            found = list(pool.map(piece, firsts, cycle(devices)))
    return (
        found[0]
        if len(found) == 1
        else Stripe(*(np.concatenate([getattr(s, f.name) for s in found]) for f in fields(Stripe)))
    )


def _detect(
    frames: np.ndarray | Array,
    dark: np.ndarray | Array | None,
    settings: StripeSettings,
    detector: Detector,
    choice: Choice,
    count: int,
) -> Stripe:
    """The stripe in the first `count` of no more frames than `FRAMES_AT_ONCE`."""
    color, columns = settings.color, settings.columns
    length = frames.shape[1 if columns else 2]
    narrow, wide = (min(half, (length - 1) // 2) for half in (_NARROW, _WIDE))
    ambient = ambient_levels(frames, dark, color)
    # Without a copy where the array is aligned to 64 bytes; nothing of it is kept.
    images, background = jax.device_put((frames, dark))
    peaks = coarse_peaks(images, background, ambient, color, columns)
    if choice == "strongest":
        peak = np.asarray(choose_peaks(peaks, length, columns))[:count]
    else:
        rows, strength = (np.asarray(each)[:count] for each in candidates(peaks, length, columns))
        peak = choose(rows, strength, choice)
    sensor = survey(images, background, ambient, peak, color, columns, narrow, FRAMES_AT_ONCE)

    def look(at: tuple[np.ndarray, ...], half: int, model: Model) -> Measured:
        """The lines of frames `at[0]` and numbers `at[1]`, in groups of few sizes: each size compiles anew."""
        found = []
        for group, count in _groups(*at, peak[at], sizes=_GROUPS if model == "plain" else _GROUPS_AGAIN):
            windows = gather_windows(images, background, sensor, *group, color, columns, half)
            found.append(
                jax.tree.map(lambda x, n=count: np.ravel(x)[:n], measure(windows, sensor, group[0], detector, model))
            )
        return found[0] if len(found) == 1 else jax.tree.map(lambda *parts: np.concatenate(parts), *found)

    def look_again(measured: Measured, which: Bool[np.ndarray, "frames lines"], half: int, model: Model) -> Measured:
        places = np.nonzero(which)
        if not places[0].size:
            return measured
        found = look(places, half, model)
        # Where there is no edge in the stripe, what was measured without one stands.
        taken = found.whole if model == "torn" else np.ones_like(found.whole)
        at = tuple(index[taken] for index in places)
        return jax.tree.map(lambda old, new: _replaced(old, at, new[taken]), measured, found)

    everywhere = tuple(index.ravel() for index in np.indices(peak.shape, np.int32))
    measured = jax.tree.map(lambda x: x.reshape(peak.shape), look(everywhere, narrow, "plain"))
    ground = np.asarray(sensor.ground)[: len(peak), None]
    least = np.maximum(LEAST_SIGNAL * ground, _LEAST_STRENGTH)
    # A window inside a burnt-out stripe sees no background, but it sees one end of it.
    strong = measured.relief > least
    cramped = measured.cramped & strong & (wide > narrow)
    burnt = measured.burnt & strong & ~cramped
    if detector == "likelihood":
        measured = look_again(measured, cramped, wide, "censored")
        measured = look_again(measured, burnt, narrow, "censored")
        # The halo of a burnt-out stripe, and of lines nearly so beside it, strains the profile too, and is no edge.
        halo = burnt | (burnt.mean(axis=1, keepdims=True) > _MOSTLY_BURNT)
        plain = strong & ~cramped & ~halo
        strained = plain & measured.strained & edges_go_on(np.asarray(measured.h3), np.asarray(measured.h4), plain)
        measured = look_again(measured, strained, narrow, "torn")
    else:
        measured = look_again(measured, cramped, wide, "plain")
    valid = measured.whole & (measured.strength > least)
    valid = _in_a_line(measured, np.asarray(valid))
    position, sigma, width = (
        np.where(valid, x, np.float32(np.nan)) for x in (measured.position, measured.sigma, measured.width)
    )
    light = np.where(valid.any(axis=1, keepdims=True), light_of(sensor, color)[: len(valid)], np.float32(np.nan))
    return Stripe(position, sigma, np.asarray(measured.strength), width, valid, light)


def _in_a_line(measured: Measured, seen: Bool[np.ndarray, "frames lines"]) -> Bool[np.ndarray, "frames lines"]:
    """Whether a point belongs to something longer than it is thick: a stripe is a line, noise and glints are not.

    Points hang together that lie no further apart than a stripe as steep as any would, over a few missing lines. Along
    the lines the σ of such a run, weighted by strength, is n / √12 of a stripe that is n lines long; of a round spot it
    is that of its profile across.
    """
    place = np.flatnonzero(seen)
    if not place.size:
        return seen
    line = place % seen.shape[1]
    at, weight, width = (np.asarray(x).ravel()[place] for x in (measured.position, measured.strength, measured.width))
    apart = np.diff(line)
    # The next frame's lines begin anew.
    joined = (np.diff(place) <= _GAP) & (apart > 0) & (np.abs(np.diff(at)) <= _COMPANY_PX + _STEEPEST * apart)
    starts = np.concatenate([[0], 1 + np.flatnonzero(~joined)])
    weight = weight.astype(np.float64)
    total, mean, square, thick = (
        np.add.reduceat(x, starts) for x in (weight, weight * line, weight * line**2, weight * (width / FWHM) ** 2)
    )
    along2 = square / total - (mean / total) ** 2
    length = np.diff(starts, append=place.size)
    # Any two points are in a line.
    longer = (along2 > np.maximum(_LONGER**2 * thick / total, _SHORTEST**2 / 12)) & (length > 2)
    ends = starts + length - 1
    kept = (
        np.repeat(longer, length)
        & ~_spilt(weight, starts, ends)
        & ~_echoes(place, seen.shape[1], at, weight, starts, ends)
    )
    found = np.zeros_like(seen)
    found.flat[place] = kept
    return found


def _echoes(
    place: Int[np.ndarray, "points"],
    lines: int,
    at: Float[np.ndarray, "points"],
    strength: Float[np.ndarray, "points"],
    first: Int[np.ndarray, "runs"],
    last: Int[np.ndarray, "runs"],
) -> Bool[np.ndarray, "points"]:
    """Which points lie beyond the end of what is so much brighter, within a run or in a short one beside it."""
    echo = np.zeros(len(strength), bool)
    brightest = np.maximum.reduceat(strength, first)
    whole = np.zeros(len(first), bool)
    # Of a run and the one before it, either may echo the other.
    one, other = np.s_[1:], np.s_[:-1]
    for end, inwards in ((first, 1), (last, -1)):
        inner = np.clip(end + inwards * np.arange(_ECHO_PX + 1)[:, None], first, last)
        bright = strength[inner].max(axis=0)
        faint = np.logical_and.accumulate(strength[inner] < _ECHO * bright)
        echo[inner[faint]] = True
        # Towards the end of this run lies a run before it, or after it.
        mine, its = (one, other) if inwards > 0 else (other, one)
        beside = np.abs(place[end[mine]] - place[end[its]]) <= _ECHO_PX
        beside &= np.abs(at[end[mine]] - at[end[its]]) <= _ECHO_PX
        beside &= place[end[mine]] // lines == place[end[its]] // lines
        whole[its] |= beside & (brightest[its] < _ECHO * bright[mine])
    return echo | np.repeat(whole, last - first + 1)


def _spilt(
    strength: Float[np.ndarray, "points"], first: Int[np.ndarray, "runs"], last: Int[np.ndarray, "runs"]
) -> Bool[np.ndarray, "points"]:
    """Which points at the ends of runs are beyond the surface's: dimmer than half of what is seen further in."""
    spilt = np.zeros(len(strength), bool)
    for end, other, inwards in ((first, last, 1), (last, first, -1)):
        for _ in range(_MOST_SPILT):
            inner = np.clip(end + inwards * np.arange(1, _FURTHER_IN + 1)[:, None], 0, len(strength) - 1)
            dim = strength[end] < _SPILT * strength[inner].max(axis=0)
            dim &= (other - end) * inwards >= _FURTHER_IN
            spilt[end[dim]] = True
            end = end + inwards * dim
    return spilt


def ambient_levels(
    frames: np.ndarray | Array, dark: np.ndarray | Array | None, color: str
) -> Int[np.ndarray, "frames"]:
    """The level of the other two channels without laser, in each frame."""
    if color == "grey":
        return np.zeros(len(frames), np.int32)
    every = max(1, int((frames.shape[1] * frames.shape[2] / _SOME_PIXELS) ** 0.5))
    _, first, second = CHANNELS[color]

    def others_of(images: np.ndarray | Array) -> Int[np.ndarray, "frames rows columns"]:
        # Of frames on a device no more is fetched than that.
        some = np.asarray(images[:, ::every, ::every], np.int32)
        return some[..., first] + some[..., second]

    others = others_of(frames) if dark is None else others_of(frames) - others_of(dark)
    flat = np.reshape(others, (len(frames), -1))
    rank = int(_AMBIENT_QUANTILE * (flat.shape[1] - 1))
    return np.partition(flat, rank, axis=1)[:, rank].astype(np.int32)


def _groups(
    *at: Int[np.ndarray, "some"], sizes: tuple[tuple[int, int], tuple[int, int]]
) -> Iterator[tuple[list[Int[np.ndarray, "groups lines"]], int]]:
    """The indices in groups of one of two shapes, the last one filled up by repetition; and how many of each count."""
    first, some, (small, large) = 0, len(at[0]), sizes
    while first < some:
        # A few small ones take less time than one large one that is almost empty.
        shape = large if some - first > _FEW * prod(small) else small
        count = min(prod(shape), some - first)
        yield [np.resize(index[first : first + count], shape).astype(np.int32, copy=False) for index in at], count
        first += count


def _replaced(old: Array, at: tuple[np.ndarray, ...], new: np.ndarray) -> np.ndarray:
    values = np.array(old)
    values[at] = new
    return values


def _batch(images: np.ndarray | Array, settings: StripeSettings, what: str) -> np.ndarray | Array:
    """The images as (frames, rows, columns) or (frames, rows, columns, 3), checked."""
    if images.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{what} has pixels of {images.dtype}: give 8 or 16 bit integers")
    coloured = images.ndim >= 3 and images.shape[-1] == 3
    if images.ndim - coloured not in (2, 3) or 0 in images.shape:
        raise InputError(
            f"{what} has the shape {images.shape}: give (rows, columns) or (rows, columns, 3), or a batch of either"
        )
    frames = images if images.ndim - coloured == 3 else images[None]
    if not coloured and settings.color != "grey":
        raise InputError(f'{what} is grey, and the laser\'s colour {settings.color}: write color = "grey"')
    length = frames.shape[1 if settings.columns else 2]
    if length <= 2 * _NARROW:
        raise InputError(
            f"{what} has {length} {'rows' if settings.columns else 'columns'}: a stripe needs {2 * _NARROW + 1}"
        )
    return frames


def _check_background(frames: np.ndarray | Array, dark: np.ndarray | Array) -> None:
    if dark.dtype != frames.dtype or dark.shape[1:] != frames.shape[1:] or len(dark) not in (1, len(frames)):
        raise InputError(
            f"the background is {dark.dtype} of shape {dark.shape}, the frames {frames.dtype} of shape {frames.shape}: "
            "take it with the same camera settings, one image for all frames or one for each"
        )
