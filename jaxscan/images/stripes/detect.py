"""Where the laser stripe is: one position for each image column (or row), to a fraction of a pixel.

`coarse` reduces the images to a peak for each block of rows and chooses among them (`batch`); `survey` learns from
windows about some of the peaks what the sensor is like, and what was done to the photographs since (`light`); a
detector measures the centre in the window about each peak (`look`). They are compiled apart, for in one piece a
compiler on a CPU computes each step again for every use of it in the next. Where the window was too narrow for the
stripe, the stripe is burnt out or an edge runs along it (`edges`), lines are measured again by themselves. Where edges
or other light were taken for noise, that is read again first (`noise_again`).

There is a stripe where the peak exceeds its background by a multiple of the frame's noise, and both its flanks do too
(`settle`).
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import cycle
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Int

from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError
from jaxscan.images.stripe_settings import StripeSettings
from jaxscan.images.stripes.batch import FRAMES_AT_ONCE, NARROW, Batch
from jaxscan.images.stripes.beside_steps import beside_steps
from jaxscan.images.stripes.by_gravity import steadier_by_gravity
from jaxscan.images.stripes.edges import WithEdges, with_edges
from jaxscan.images.stripes.light import Light
from jaxscan.images.stripes.look import Looker
from jaxscan.images.stripes.mosaic import native_pixels, of_mosaics
from jaxscan.images.stripes.noise_again import noise_again
from jaxscan.images.stripes.processed import at_half_resolution
from jaxscan.images.stripes.settle import Band, MeasuredFrames, settle
from jaxscan.images.stripes.sigma import sigma_of_centres
from jaxscan.images.stripes.stray_light import without_stray_light
from jaxscan.images.stripes.stripe import Stripe
from jaxscan.images.stripes.validity import LN_WIDTHS, LN_WIDTHS_IN_BLOCKS, Verdict
from jaxscan.images.stripes.windows import Sensor
from jaxscan.precision import float32


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
        band: the first and the last row (or column) of each line at which there can be a stripe, of all images
            alike or of each; everywhere by default.

    Returns:
        The stripe in the first `count` images.

    Raises:
        InputError: shapes, depths or colour do not match.
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
                band if band is None or band[0].ndim == 1 else (band[0][some], band[1][some]),
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
    batch = Batch.create(frames, dark, settings, choice, count, bool(mosaic))
    sensor = batch.survey()
    native = _native_pixels(batch, sensor, choice) if mosaic is None else None
    if native is not None:
        parts = partial(_detect, settings=settings, detector=detector, choice=choice)
        return of_mosaics(frames, dark, settings.columns, native, band, parts, batch.surroundings(sensor))
    looker = Looker.create(batch, Light.create(batch, sensor, detector == "likelihood"), detector)
    looker, looked = looker.everywhere()
    ln_widths = np.where(at_half_resolution(sensor), LN_WIDTHS_IN_BLOCKS, LN_WIDTHS)[:count]
    all_of_it = MeasuredFrames(
        looked, batch.peak, looker.least, looker.ground, ln_widths, batch.length, looker.at, band
    )
    narrow = None if sensor.colours is None or dark is not None else partial(batch.narrow_peaks, sensor=sensor)
    colours = batch.peaks_of_colour, batch.rises_alone, narrow
    verdict = settle(all_of_it, batch.peaks, settings.columns, choice == "likeliest", *colours)
    valid, looked = verdict == Verdict.STRIPE, all_of_it.looked
    found = WithEdges(looked.measured, np.zeros_like(valid), np.zeros(count, bool))
    measured, by_gravity = found.measured, np.zeros(count, bool)
    if detector == "likelihood":
        looker, looked = noise_again(looker, looked, all_of_it.peak)
        looked = beside_steps(looker, without_stray_light(looker, looked, all_of_it.peak), all_of_it.peak)
        found = with_edges(looker, looked, all_of_it.peak)
        measured, by_gravity = steadier_by_gravity(looker, found.measured, all_of_it.peak, valid)
    light = looker.light
    return Stripe(
        np.where(valid, measured.position, np.float32(np.nan)),
        sigma_of_centres(looker, measured, valid, found.with_edge, by_gravity, bool(mosaic)),
        measured.strength,
        np.where(valid, measured.width, np.float32(np.nan)),
        np.where(valid, measured.breadth, np.float32(np.nan)),
        valid,
        verdict,
        measured.burnt,
        light.of_frames(valid, settings.color),
        found.odd,
        light.correlation[:count, 0],
        np.full(count, bool(mosaic)),
        *batch.surroundings(light.sensor),
    )


def _native_pixels(batch: Batch, sensor: Sensor, choice: Choice) -> Int[np.ndarray, "frames"] | None:
    """The parity of a mosaic's native pixels in each frame, where there is one and lines have room for half of them."""
    if batch.length // 2 <= 2 * NARROW:
        return None
    # Where colours have half the resolution no pixel is as the sensor saw it, and luma has all of them.
    taken = ~at_half_resolution(sensor)[: batch.count]
    return native_pixels(batch.frames, batch.dark, batch.settings, batch.peak, taken, alike=choice == "coherent")


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
    if length <= 2 * NARROW:
        raise InputError(
            f"{what} has {length} {'rows' if settings.columns else 'columns'}: a stripe needs {2 * NARROW + 1}"
        )
    return frames


def _check_background(frames: np.ndarray | Array, dark: np.ndarray | Array) -> None:
    if dark.dtype != frames.dtype or dark.shape[1:] != frames.shape[1:] or len(dark) not in (1, len(frames)):
        raise InputError(
            f"the background is {dark.dtype} of shape {dark.shape}, the frames {frames.dtype} of shape {frames.shape}: "
            "take it with the same camera settings, one image for all frames or one for each"
        )
