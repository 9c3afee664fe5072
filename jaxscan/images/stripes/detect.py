"""Where the laser stripe is: one position for each image column (or row), to a fraction of a pixel.

`coarse` reduces the images to a peak for each block of rows and chooses among them; `windows` gathers the pixels about
the peak, `survey` learns from some of them what the sensor is like, and a detector measures the centre. They are
compiled apart, for in one piece a compiler on a CPU computes each step again for every use of it in the next. Where
the window was too narrow for the stripe, the stripe is burnt out or an edge runs along it, lines are measured again by
themselves.

There is a stripe where the peak exceeds its background by a multiple of the frame's noise, and both its flanks do too.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import cycle
from math import prod
from typing import Any, Final

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int

from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError
from jaxscan.images.stripe_settings import StripeSettings
from jaxscan.images.stripes.across_blocks import ALONE, beyond_usual, sigma_across_blocks
from jaxscan.images.stripes.along import widened_by_flanks, widened_by_scatter, with_grain
from jaxscan.images.stripes.between import widened_between
from jaxscan.images.stripes.candidates import candidates, choose
from jaxscan.images.stripes.coarse import choose_peaks, coarse_peaks
from jaxscan.images.stripes.detectors import Model, measure
from jaxscan.images.stripes.evidence import edges_and_profiles, mostly_torn
from jaxscan.images.stripes.likelihood import FEW_STEPS_CENSORED, FWHM, ROUGH, STEPS_CENSORED
from jaxscan.images.stripes.mosaic import native_pixels, of_mosaics
from jaxscan.images.stripes.printed import widened_by_print
from jaxscan.images.stripes.processed import (
    ALIKE_BESIDE,
    are_jpegs,
    at_half_resolution,
    correlations,
    of_video,
    share_full,
)
from jaxscan.images.stripes.settle import Band, Looked, MeasuredFrames, Places, settle
from jaxscan.images.stripes.smoothed import widening
from jaxscan.images.stripes.stripe import Stripe
from jaxscan.images.stripes.surroundings import ambient_levels, sample, surroundings
from jaxscan.images.stripes.survey import LEAST_SIGNAL, light_of, survey
from jaxscan.images.stripes.validity import Verdict
from jaxscan.images.stripes.windows import Sensor, gather_windows
from jaxscan.precision import float32

# Frames that are looked at together.
FRAMES_AT_ONCE: Final = 16
# Half windows, px: the wide one holds stripes up to some 60 px wide.
_SHORT, _NARROW, _WIDE = 8, 12, 40
# Stripes of a standard deviation up to 1.7 px are within short windows, with some background.
_SLIM_LN_PX = float(np.log(1.7))
# Up to this one, a JPEG's error in the stripe's blocks is large beside what the stripe leaves of its own steepness.
_SHARP_LN_PX = float(np.log(1.3))
# Up to this one the stripe has about three pixels, which do not show their own noise.
_SCARCE_LN_PX = float(np.log(0.6))
# In a JPEG with colours at half resolution, up to this one the native pixels of a mosaic are better than all.
_FINE_LN_PX = float(np.log(1.6))
# A peak below this multiple of the least strength is measured again in a longer window.
_FAINT = 2.0
_LEAST_STRENGTH = 10.0
# The part of a frame's lines that are burnt out, beyond which no edges are looked for in the others.
_MOSTLY_BURNT = 0.3
# Beyond this part of the lines with a stripe it is burnt out all along it.
_ALL_BURNT = 0.75
# ln of the standard deviation of the narrowest stripe in which an edge is measured, px.
_NARROWEST_TORN = float(np.log(0.9))
# This part of the lines with an edge is narrower than the stripe.
_WHOLE = 0.9
# Lines are measured in groups of these sizes, whatever the image: few sizes are compiled. Large groups cost less per
# line, because two cores start together; the few lines that are measured again would not fill them.
_GROUPS: Final = (4, 128), (20, 512)
_GROUPS_AGAIN: Final = (4, 64), (8, 512)
_FEW = 8


def detect_stripe(
    images: np.ndarray | Array,
    settings: StripeSettings,
    background: np.ndarray | Array | None = None,
    *,
    detector: Detector = DEFAULT,
    choice: Choice = DEFAULT_CHOICE,
    count: int | None = None,
    band: Band | None = None,
) -> Stripe:
    """Find the laser stripe in one photograph or in a batch of them.

    Args:
        images: (rows, columns) grey, (rows, columns, 3) RGB, or a batch of either with the frames first; 8 or 16 bits.
        settings: the laser's colour, and whether there is one point for each column or for each row.
        background: the scene with the laser off: one image for all frames, or one for each.
        detector: how the centre is measured.
        choice: which is taken where there are several in a line.
        count: how many of the images are looked at, the first ones; all by default. A buffer that keeps its size and
            is not always full compiles nothing again.
        band: the first and the last row (or column) of each line at which there can be a stripe; everywhere by default.

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
        # The last piece begins early enough to be as long as the others, for another length would compile again.
        begin = max(0, min(first, len(frames) - length))
        some, inner = slice(begin, begin + length), slice(first - begin, None)
        # Both hold for the thread that they are set in.
        with jax.default_device(device), float32():
            found = _detect(
                frames[some],
                dark if dark is None or len(dark) == 1 else dark[some],
                settings,
                detector,
                choice,
                min(count - begin, length),
                band,
            )
        return found if first == begin else found[inner]

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
    return found[0] if len(found) == 1 else Stripe.joined(found)


def _detect(
    frames: np.ndarray | Array,
    dark: np.ndarray | Array | None,
    settings: StripeSettings,
    detector: Detector,
    choice: Choice,
    count: int,
    band: Band | None,
    mosaic: bool | None = None,
) -> Stripe:
    """The stripe in the first `count` of no more frames than `FRAMES_AT_ONCE`.

    Whether they are the native pixels of a `mosaic` is known, or else looked for.
    """
    color, columns = settings.color, settings.columns
    length = frames.shape[1 if columns else 2]
    short, narrow, wide = (min(half, (length - 1) // 2) for half in (_SHORT, _NARROW, _WIDE))
    ambient = ambient_levels(frames, dark, color)
    # Without a copy where the array is aligned to 64 bytes; nothing of it is kept.
    images, background = jax.device_put((frames, dark))
    peaks = coarse_peaks(images, background, ambient, color, columns)
    peak, stands = (np.array(each)[:count] for each in choose_peaks(peaks, length, columns))
    if choice not in ("likeliest", "strongest"):
        rows, strength = (np.asarray(each)[:count] for each in candidates(peaks, length, columns))
        peak = choose(rows, strength, choice)
    looking = (images, background, ambient, peak, stands, color, columns, narrow, FRAMES_AT_ONCE)
    sensor = survey(*looking)
    native = None
    if mosaic is None and length // 2 > 2 * _NARROW:
        # Where colours have half the resolution, luma has all pixels: a broad stripe is better measured in these.
        taken = ~at_half_resolution(sensor) | (np.asarray(sensor.ln_s) < _FINE_LN_PX)
        native = native_pixels(frames, dark, settings, peak, taken[: len(peak)], alike=choice == "coherent")
    if native is not None:
        parts = partial(_detect, settings=settings, detector=detector, choice=choice)
        around = surroundings(sample(frames)[:count], np.asarray(sensor.full)[:count], color)
        return of_mosaics(frames, dark, columns, native, band, parts, around)
    correlation = correlations(frames, dark, settings, sensor, peak)
    smoothed = np.flatnonzero(correlation[: len(peak), 0])
    alike = correlation if len(smoothed) else None
    if alike is not None:
        sensor = survey(*looking, alike)
    at_first, smooth = sensor, None
    ln_s = np.asarray(sensor.ln_s) if detector == "likelihood" else np.full(len(correlation), np.inf)
    slim = ln_s < _SLIM_LN_PX
    sharp = ln_s < _SHARP_LN_PX
    plain = (correlation[:, 0] == 0) & (frames.dtype == np.uint8) & (detector == "likelihood")
    # The noise of a JPEG is white only where it has left it as it was; what it makes of full pixels counts always.
    asked = plain & (sharp | (np.asarray(sensor.beside) > ALIKE_BESIDE))
    asked[: len(peak)] |= plain[: len(peak)] & (share_full(frames, settings, sensor, peak) > _MOSTLY_BURNT)
    jpeg = are_jpegs(frames, settings, sensor, peak, plain, asked)
    if (jpeg & sharp).any():
        smooth = jpeg & sharp
        sensor = survey(*looking, alike, smooth)
    # Of luma that is interpolated, and of luma whose channels are full each by itself, full pixels are bounds.
    video, halved = of_video(sensor), at_half_resolution(sensor)
    cut = jpeg & ~halved & (color != "grey" or frames.ndim == peak.ndim + 1)
    # In a video's luma they are numbers: what its coding leaves there is more than lies between them and a bound.
    cut |= video & halved
    cut = cut if cut.any() else None
    ground = np.asarray(sensor.ground)[:count]
    least = np.maximum(LEAST_SIGNAL * ground, _LEAST_STRENGTH)
    slim_frames = slim[:count]

    def look(at: Places, half: int, model: Model, steps: int | None = None) -> Any:
        """`Measured` of the windows at these places, in NumPy's arrays; in groups, for each size compiles again."""
        found = []
        # An edge of reflectance is looked for in the pixels as they are.
        here = replace(sensor, smooth=None) if model == "edge" else sensor
        if model == "censored":
            here = replace(sensor, cut=cut)
        for group, count in _groups(*at, sizes=_GROUPS if model == "plain" else _GROUPS_AGAIN):
            windows = gather_windows(images, background, here, *group, color, columns, half)
            measured = measure(windows, here, group[0], detector, model, steps)
            found.append(jax.tree.map(lambda x, n=count: np.ravel(x)[:n], measured))
        return found[0] if len(found) == 1 else jax.tree.map(lambda *parts: np.concatenate(parts), *found)

    def look_again(
        measured: Any, at: Places, which: np.ndarray, half: int, model: Model, steps: int | None = None
    ) -> Any:
        if not which.any():
            return measured
        found = look(tuple(index[which] for index in at), half, model, steps)
        # Where there is no edge in the stripe, what was measured without one stands.
        taken = found.whole if model == "edge" else np.ones_like(found.whole)
        places = np.flatnonzero(which)[taken]
        return jax.tree.map(lambda old, new: _replaced(old, places, new[taken]), measured, found)

    def look_at_burnt(measured: Any, at: Places, which: np.ndarray, half: int) -> Any:
        """In few steps, which do for most; a group of lines takes as many as the slowest of them."""
        measured = look_again(measured, at, which, half, "censored", FEW_STEPS_CENSORED)
        return look_again(measured, at, which & ~measured.settled, half, "censored", STEPS_CENSORED)

    def first_look(at: Places) -> tuple[Any, np.ndarray]:
        """In short windows where the frame's stripe is slim, else in narrow ones; and where that is."""
        slim = slim_frames[at[0]]
        if slim.all() or not slim.any():
            return look(at, short if slim.all() else narrow, "plain"), slim
        each = [
            look(tuple(index[which] for index in at), half, "plain") for which, half in ((slim, short), (~slim, narrow))
        ]
        order = np.argsort(np.concatenate([np.flatnonzero(slim), np.flatnonzero(~slim)]))
        return jax.tree.map(lambda *parts: np.concatenate(parts)[order], *each), slim

    def looked_at(at: Places, begun: tuple[Any, np.ndarray] | None = None) -> Looked:
        measured, slim = first_look(at) if begun is None else begun
        # In noise a longer window has a lower lowest point, by which what is faint stands out.
        doubtful = measured.cramped & (measured.relief > least[at[0]]) | (measured.strength < _FAINT * least[at[0]])
        measured = look_again(measured, at, slim & doubtful, narrow, "plain")
        slim = slim & ~doubtful
        # A window inside a burnt-out stripe sees no background, but it sees one end of it.
        strong = (measured.relief > least[at[0]]) | (measured.cramped & measured.burnt)
        cramped = measured.cramped & strong & (wide > narrow)
        burnt = measured.burnt & strong & ~cramped
        as_burnt = burnt | all_cut[at[0]] & strong & ~cramped
        if detector == "likelihood":
            grained, rough = (strong & each for each in _speckled(sensor, at[0], measured.relief))
            # What a JPEG leaves hides speckle in burnt-out lines.
            plain, even = measured, ~(grained | rough)
            if cut is not None:
                even |= cut[at[0]] & measured.burnt | all_cut[at[0]]
            measured = look_at_burnt(measured, at, cramped & even, wide)
            measured = look_at_burnt(measured, at, as_burnt & even & ~slim, narrow)
            measured = look_at_burnt(measured, at, as_burnt & even & slim, short)
            measured = look_again(measured, at, cramped & ~even, wide, "grained and censored")
            again = (rough | grained & burnt) & ~(cramped | even)
            measured = look_again(measured, at, again, narrow, "grained and censored")
            measured = look_again(measured, at, grained & ~(rough | as_burnt | cramped), narrow, "grained")
            # Whether there is an edge is asked of the plain fit.
            measured = replace(measured, strained=plain.strained, h3=plain.h3, h4=plain.h4)
        else:
            measured = look_again(measured, at, cramped, wide, "plain")
        return Looked(measured, strong, cramped, burnt)

    everywhere = tuple(index.ravel() for index in (*np.indices(peak.shape, np.int32), peak))
    begun = first_look(everywhere)
    plainly = jax.tree.map(lambda x: x.reshape(peak.shape), begun[0])
    # Noise that is read off burnt-out lines of a JPEG is no measure for those few between that are not.
    all_cut = np.zeros(len(peak), bool)
    if cut is not None:
        shines = plainly.relief > least[:, None]
        all_cut = cut[: len(peak)] & ((plainly.burnt & shines).sum(1) > _ALL_BURNT * shines.sum(1))
    seen = plainly.whole & ~plainly.burnt & (plainly.relief > least[:, None]) & (correlation[: len(peak), :1] == 0)
    along = plainly.ln_light, seen
    if detector == "likelihood":
        sensor = with_grain(sensor, *along)
    looked = jax.tree.map(lambda x: x.reshape(peak.shape), looked_at(everywhere, begun))

    def of_colour() -> np.ndarray:
        # Without c neutral light cancels however bright it is, and a stripe that is burnt out white but for its flanks.
        greatest = np.iinfo(np.int16 if frames.dtype == np.uint8 else np.int32).max
        return np.asarray(coarse_peaks(images, background, np.full_like(ambient, greatest), color, columns))

    batch = MeasuredFrames(looked, peak, least, ground, length, looked_at, band)
    verdict = settle(batch, peaks, columns, choice == "likeliest", None if color == "grey" else of_colour)
    looked, peak = batch.looked, batch.peak
    measured, odd, with_edge = looked.measured, np.zeros(len(peak), bool), np.zeros(peak.shape, bool)
    if detector == "likelihood":
        # The halo of a burnt-out stripe, and of lines nearly so beside it, strains the profile too, and is no edge.
        halo = looked.burnt | (looked.burnt.mean(axis=1, keepdims=True) > _MOSTLY_BURNT)
        plain = looked.strong & ~looked.cramped & ~halo
        # What edges leave is taken for noise where most lines have one: it is read again off those that have least.
        misled, even = mostly_torn(measured.h3, measured.h4, plain)
        # What blurs a narrower stripe hides the shape that an edge leaves in it; a JPEG leaves such shapes of its own.
        broad = np.asarray(sensor.ln_s)[: len(peak)] > _NARROWEST_TORN
        misled &= broad
        if misled.any():
            stands[misled[:, None] & ~even] = np.iinfo(stands.dtype).min
            sensor = with_grain(survey(*looking, alike, smooth), *along)
            sensor = replace(sensor, ln_s=_whole_width(np.array(sensor.ln_s), measured.width, plain, misled))
            which = np.repeat(misled, peak.shape[1])
            again = looked_at(tuple(index[which] for index in (*everywhere[:2], peak.ravel())))
            measured = jax.tree.map(
                lambda old, new: _replaced(old, misled, new.reshape(-1, peak.shape[1])), measured, again.measured
            )
        strained, odd = edges_and_profiles(measured.h3, measured.h4, plain, plain & measured.strained)
        strained &= broad[:, None]
        # The shapes that a video's coding leaves are no edges.
        strained &= ~video[: len(peak), None]
        # A stripe that is burnt out over its whole length is judged by its flanks.
        mostly = (looked.burnt & looked.strong).sum(1) > _ALL_BURNT * np.maximum(looked.strong.sum(1), 1)
        odd |= mostly & ~np.asarray(sensor.apart)[: len(odd)]
        flat = jax.tree.map(np.ravel, measured)
        flat = look_again(flat, (*everywhere[:2], peak.ravel()), strained.ravel(), narrow, "edge")
        flat = jax.tree.map(lambda x: x.reshape(peak.shape), flat)
        measured, with_edge = flat, flat.position != measured.position
    valid = verdict == Verdict.STRIPE
    position, sigma, width = (
        np.where(valid, x, np.float32(np.nan)) for x in (measured.position, measured.sigma, measured.width)
    )
    for i in smoothed:
        sigma[i] *= widening(correlation[i], sensor, int(i), width[i], measured.relief[i])
    sigma = widened_by_flanks(sigma, measured.breadth, measured.burnt, sensor)
    independent = sigma
    sigma = widened_by_scatter(sigma, position, measured.burnt, sensor)
    some = (jpeg | video)[: len(sigma)]
    if some.any():
        here = independent[some], position[some], width[some], measured.burnt[some], sharp[: len(sigma)][some]
        sigma[some] = sigma_across_blocks(*here)
    # The few native pixels of a stripe that is hardly wider than they are apart do not show its speckle.
    scarce = (np.asarray(sensor.ln_s) < _SCARCE_LN_PX)[: len(sigma)] & bool(mosaic)
    if scarce.any():
        one_kind = np.zeros_like(measured.burnt)
        here = independent[scarce], position[scarce], width[scarce], one_kind[scarce], sharp[: len(sigma)][scarce]
        sigma[scarce] = sigma_across_blocks(*here, ALONE)
    sigma = widened_between(sigma, position, width)
    seen_in = images, background, sensor, correlation, settings, short
    printed = widened_by_print(sigma, position, width, ~with_edge, *seen_in, partial(_groups, sizes=_GROUPS))
    some = some | scarce
    printed[some] = beyond_usual(sigma[some], printed[some])
    sigma = printed
    around = surroundings(sample(frames)[: len(valid)], np.asarray(sensor.full)[: len(valid)], color)
    light = light_of(sensor, color)
    if smooth is not None:
        # The noise of pixels as they are, not of smoothed windows.
        light = np.where(smooth[:, None], light_of(at_first, color), light)
    light = np.where(valid.any(axis=1, keepdims=True), light[: len(valid)], np.float32(np.nan))
    return Stripe(
        position,
        sigma,
        measured.strength,
        width,
        valid,
        verdict,
        measured.burnt,
        light,
        odd,
        correlation[: len(valid), 0],
        np.full(len(valid), bool(mosaic)),
        *around,
    )


def _whole_width(
    ln_s: Float32[np.ndarray, "most"],
    width: Float[np.ndarray, "frames lines"],
    seen: Bool[np.ndarray, "frames lines"],
    has_edge: Bool[np.ndarray, "frames"],
) -> Float32[np.ndarray, "most"]:
    """Where most lines of a frame have an edge, ln of its stripe's standard deviation: an edge makes lines narrower."""
    for frame in np.flatnonzero(has_edge):
        ln_s[frame] = np.log(np.quantile(width[frame, seen[frame]], _WHOLE) / FWHM)
    return ln_s


def _speckled(
    sensor: Sensor, frame: Int[np.ndarray, "lines"], relief: Float[np.ndarray, "lines"]
) -> tuple[Bool[np.ndarray, "lines"], Bool[np.ndarray, "lines"]]:
    """Which lines have speckle of several pixels, and which have so much that it makes them ragged.

    Either only where it counts beside the sensor's noise.
    """
    speckle, grain, read = (np.asarray(x)[frame] for x in (sensor.speckle, sensor.grain, sensor.read))
    counts = speckle * relief**2 > read**2
    return counts & (grain > 0), counts & (speckle > ROUGH)


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


def _replaced(old: np.ndarray, at: np.ndarray, new: np.ndarray) -> np.ndarray:
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
