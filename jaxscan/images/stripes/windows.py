"""Second step of stripe detection: the response in a window about each coarse peak, and the stripe's outline there.

Windows stand as (groups, window, lines): reduced over the middle axis they are forty times as fast on a CPU as over
the first, so a detector is written for all lines of all frames at once. What is one number for a line has the shape
(groups, 1, lines).
"""

from typing import Final, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt

from jaxscan.geometry.rotation import A
from jaxscan.images.stripes.colours import Colours, InTexture, OwnWeights, in_texture
from jaxscan.images.stripes.response import NEUTRAL, Backgrounds, Detail, Images, channels, detailed, numbers, response
from jaxscan.kept_programs import compiled

Pixels = Float[Array, "groups window lines"]
Lines = Float[Array, "groups 1 lines"]
Places = Int[Array, "groups lines"]
# Of JAX or of NumPy.
Rows = TypeVar("Rows", Array, np.ndarray)

# The smoothing's own full width at half height, squared: 8 ln 2 times its variance of 1.
_SMOOTHING_FWHM2 = 5.545
_LEAST_WIDTH_PX: Final = 1.0
_SMOOTHING = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
# The least variance of a stripe, px².
_LEAST_S2: Final = 0.01
# Between full pixels one is full from this part of a full number on.
_NEARLY: Final = 0.8
# A stripe may be white where the laser's channel reaches this part of a full number. Of white light two channels rise
# by twice what the third does; between these multiples: of the laser's own light by less, of another colour's by more.
# A level above all others.
_MAY_BE_WHITE: Final = 0.7
_AS_WHITE: Final = (0.5, 3.0)
_NO_CAP: Final = 2**20
# What `smoothed` adds to the variance of a stripe, px².
_ADDED_PX2: Final = 0.5
# What it leaves of the variance of independent pixels, and what pixels 1 and 2 apart then share of it.
SOFT_GAIN, _SHARED, _SHARED_FAR = 6 / 16, 4 / 16, 1 / 16


class Bump(eqx.Module):
    """What stands out in a window.

    Attributes:
        smooth: s, the response smoothed by (1 4 6 4 1) / 16.
        floor: b, the background: the greater of its two minima beside the peak.
        top: p, the peak of s.
        at: the peak's pixel, counted from the window's first.
    """

    smooth: Pixels
    floor: Lines
    top: Lines
    at: Lines


class Outline(Bump):
    """Where the stripe lies in its window: between the places where s crosses (p + b) / 2 first on either side.

    Attributes:
        start: last pixel below half height before the peak, −∞ if there is none.
        end: first pixel below half height after the peak, ∞ if there is none.
        middle: of the two crossings; the peak where one is missing.
        width: between the crossings, less what the smoothing adds, px.
        whole: whether both crossings are in the window.
    """

    start: Lines
    end: Lines
    middle: Lines
    width: Lines
    whole: Bool[Array, "groups 1 lines"]


class Sensor(eqx.Module):
    """What a photograph shows of its own sensor and colours: one number for each frame, or for each line of a window.

    Attributes:
        weights: m and n of the response in quiet lines.
        ambient: its c, grey levels.
        full: from this number on a pixel of the laser's channel is full.
        span: the response of such a pixel.
        ground: σ beside the stripe, texture and all, of the response in which stripes are looked for (m = n = 1), grey
            levels: what a stripe must stand out from.
        read: σ of the sensor's noise without laser, grey levels.
        shot: variance of the response for each grey level of it, above the background: photons.
        speckle: variance of the laser's light in a pixel, in parts of its square: the speckle's contrast, squared.
        grain: correlation of the speckle of neighbouring pixels of a line; of pixels k apart it is grain^(k²).
        ln_s: ln of the stripe's usual standard deviation, px.
        ln_s_spread: σ of that of single lines.
        beside: of neighbouring pixels at the ends of the windows, the mean product over the mean square, their means
            taken out: −0.2 where noise is white.
        even: of noise that is alike in neighbouring pixels beside the stripe, 1 if it is so on the stripe, 0 if not.
        apart: whether what the plain profile leaves in the lines has nothing in common, as chance leaves it, or has a
            shape: that of a laser that is no bell, of a halo, or of what a camera sharpens.
        coded: whether it is a JPEG, as far as the survey was told, or colours at half resolution show it.
        off_beside: how far the worst pixel beside the stripe is off in the usual line, in parts of its noise; 0 where
            none is seen.
        colours: by which each line's weights are determined; None of a grey laser.
        detail: what luma's detail gives back; None where the colours of all frames are at full resolution.
        smooth: in which frames windows are smoothed; None where in none.
        shape: coefficients of the laser's cross-section; None where all are bells.
        cut: in which frames a full pixel was cut off before a JPEG was made of it; None where it is a bound in all.
    """

    weights: tuple[Float[Array, "*of"], Float[Array, "*of"]]
    ambient: Int[Array, "*of"]
    full: Int[Array, "*of"]
    span: Float[Array, "*of"]
    ground: Float[Array, "*of"]
    read: Float[Array, "*of"]
    shot: Float[Array, "*of"]
    speckle: Float[Array, "*of"]
    grain: Float[Array, "*of"]
    ln_s: Float[Array, "*of"]
    ln_s_spread: Float[Array, "*of"]
    beside: Float[Array, "*of"]
    even: Float[Array, "*of"]
    apart: Bool[Array, "*of"]
    coded: Bool[Array, "*of"]
    off_beside: Float[Array, "*of"]
    colours: Colours | None = None
    detail: Detail | None = None
    smooth: Bool[Array, "*of"] | None = None
    cut: Bool[Array, "*of"] | None = None
    shape: tuple[Float[Array, "*of"], ...] | None = None

    def of(self, frame: Places) -> "Sensor":
        """The numbers of each line's frame, as (groups, 1, lines)."""
        return jax.tree.map(lambda x: x[frame][:, None], self)


class Cut(eqx.Module):
    """Lines of JPEGs in which pixels may be full, and where these were cut off before the JPEG was made.

    What a JPEG leaves is in full pixels too: some are read a little below full, others above. So a full pixel is no
    bound of the light but a number, min(μ, F) with an error. The smoothing is that of the windows' response.

    Attributes:
        lines: which.
        ceiling: F, the response that each pixel would have if it were full.
        twice: which are smoothed twice.
    """

    lines: Bool[Array, "groups 1 lines"]
    ceiling: Pixels
    twice: Bool[Array, "groups 1 lines"]

    def smoothed(self, x: Pixels) -> Pixels:
        """Pixels smoothed as those of the lines' response are."""
        once = _softened(x)
        return jnp.where(self.twice, _softened(once), once)


class Windows(eqx.Module):
    """The response in windows, one for each line: a column of the image, or a row.

    Attributes:
        response: r of each pixel, grey levels.
        neutral: the response in which neutral light cancels; None where there are no colours.
        full: whether the laser's channel was full there: then r is a lower bound.
        first: the row (or column) of the window's first pixel.
        gain: variance of the noise of r over that of a pixel, where r is interpolated or smoothed; None where neither.
        added: what smoothing has added to the variance of each line's stripe, px²; None where none is smoothed.
        cut: lines whose full pixels are numbers; None where there are none.
        own: the weights of its lines, and what they make of their noise; None of a grey laser.
        colours: its channels; None where they were not asked for.
    """

    response: Pixels
    neutral: Pixels | None
    full: Bool[Array, "groups window lines"]
    first: Places
    gain: Pixels | None = None
    added: Lines | None = None
    cut: Cut | None = None
    own: OwnWeights | None = None
    colours: InTexture | None = None

    def as_seen(self, ln_s: Lines) -> Lines:
        """The logarithm of a stripe's standard deviation with what smoothing adds to it."""
        return ln_s if self.added is None else 0.5 * jnp.log(jnp.exp(2 * ln_s) + self.added)

    def as_it_is(self, ln_s: Lines) -> Lines:
        """The logarithm of its standard deviation without."""
        if self.added is None:
            return ln_s
        return 0.5 * jnp.log(jnp.maximum(jnp.exp(2 * ln_s) - self.added, _LEAST_S2))

    def read2(self, sensor: Sensor) -> Lines:
        """The variance of the read noise of each line."""
        return sensor.read**2 if self.own is None else self.own.louder * sensor.read**2

    def variance(self, height: Pixels, sensor: Sensor) -> Pixels:
        """The noise of pixels that stand so high above the background."""
        light = jnp.maximum(height, 0.0)
        variance = self.read2(sensor) + light * (sensor.shot + sensor.speckle * light)
        return variance if self.gain is None else self.gain * variance


@compiled(static_argnames=("columns", "half"))
def gather_pixels(
    images: Images, frame: Places, line: Places, peak: Places, columns: bool, half: int
) -> UInt[Array, "groups window lines *rgb"]:
    """The pixels in a window about each peak.

    Args:
        images: the photographs; one alone serves for every frame.
        frame: of each window, which photograph; windows come in groups, of a frame or of whatever one likes.
        line: which column (or row).
        peak: about which row (or column).
        columns: whether windows run down columns or along rows.
        half: half the window's length.
    """
    size = 2 * half + 1
    first = first_pixel(images, peak, columns, half)
    place = (first, line) if columns else (line, first)
    of = jnp.zeros_like(frame) if images.shape[0] == 1 else frame
    return jax.lax.gather(
        images,
        jnp.stack([of, *place], axis=-1),
        jax.lax.GatherDimensionNumbers(
            offset_dims=(1,) if images.ndim == 3 else (1, 3),
            collapsed_slice_dims=(0, 2) if columns else (0, 1),
            start_index_map=(0, 1, 2),
        ),
        (*((1, size, 1) if columns else (1, 1, size)), *images.shape[3:]),
        mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )


def first_pixel(images: Images, peak: Rows, columns: bool, half: int) -> Rows:
    """The row (or column) in which a window begins: at the image's edge it is moved inwards."""
    return (peak - half).clip(0, images.shape[1 if columns else 2] - 2 * half - 1)


def gather_windows(
    images: Images,
    background: Backgrounds | None,
    sensor: Sensor,
    frame: Int[np.ndarray, "groups lines"],
    line: Int[np.ndarray, "groups lines"],
    peak: Int[np.ndarray, "groups lines"],
    color: str,
    columns: bool,
    half: int,
    with_colours: bool = False,
) -> Windows:
    """The response in a window about each peak; the arguments are those of `gather_pixels`."""
    at = frame, line, peak, columns, half
    dark = None if background is None else gather_pixels(background, *at)
    return _windows_of(
        gather_pixels(images, *at), dark, sensor, frame, first_pixel(images, peak, columns, half), color, with_colours
    )


# Apart from the gathering, for this need not be compiled again for photographs of another size.
@compiled(static_argnames=("color", "with_colours"))
def _windows_of(
    lit: UInt[Array, "groups window lines *rgb"],
    dark: UInt[Array, "groups window lines *rgb"] | None,
    sensor: Sensor,
    frame: Places,
    first: Places,
    color: str,
    with_colours: bool,
) -> Windows:
    """The response in windows of these pixels, which begin in the rows (or columns) `first`."""
    here = sensor.of(frame)
    laser = numbers(lit, color)
    levels = channels(lit, dark, color)
    if here.detail is not None:
        laser = detailed(channels(lit, None, color), first, here.detail, color)[0]
        levels = detailed(levels, first, here.detail, color)
    full = full_pixels(laser, here.full, here.coded)
    r, own = response_of_lines(levels, full, here)
    gain = added = cut = apart = None
    if here.cut is not None:
        below = jnp.iinfo(lit.dtype).max - laser.astype(jnp.float32)
        ceiling = r + (1 if color == "grey" else 2) * below
        cut = Cut(here.cut, ceiling, jnp.ones_like(here.cut) if here.smooth is None else ~here.smooth)
    if here.smooth is not None:
        plain = ~full.any(1, keepdims=True)
        soft = here.smooth & (plain if cut is None else plain & ~cut.lines)
        r, gain, added = smoothed(r, soft)
        levels = tuple(jnp.where(soft, _softened(level), level) for level in levels)
    if cut is not None:
        r = jnp.where(cut.lines, cut.smoothed(r), r)
    neutral = None if color == "grey" else response(levels, NEUTRAL, _cap(levels, laser, here))
    if with_colours and here.colours is not None and own is not None:
        apart = in_texture(levels, here.colours, own)
    return Windows(r, neutral, full, first, gain, added, cut, own, apart)


def response_of_lines(
    levels: tuple[Shaped[Array, "groups window lines"], ...], full: Bool[Array, "groups window lines"], sensor: Sensor
) -> tuple[Pixels, OwnWeights | None]:
    """The response with the weights of each line, and these."""
    if sensor.colours is None:
        return response(levels, sensor.weights, sensor.ambient), None
    own = sensor.colours.of_lines(levels, full)
    return response(levels, own.weights, sensor.ambient), own


def _cap(
    levels: tuple[Shaped[Array, "groups window lines"], ...],
    laser: Shaped[Array, "groups window lines"],
    sensor: Sensor,
) -> Int[Array, "groups 1 lines"]:
    """The neutral response's c: none where something small and white shines, as a head before a dark ground.

    c is the level of most of the frame, and what is brighter does not cancel. A stripe is white only where its own
    channel comes near to full.
    """
    stripe = (laser >= (_MAY_BE_WHITE * sensor.full).astype(laser.dtype)).any(1, keepdims=True)
    own, others = (_softened(level.astype(jnp.float32)) for level in (levels[0], levels[1] + levels[2]))
    above, rise = others - sensor.ambient, own - sensor.ambient / 2
    seen = 2 * own - jnp.minimum(others, sensor.ambient)
    brightest = seen == seen.max(1, keepdims=True)
    white = brightest & (above > 0) & (above > _AS_WHITE[0] * rise) & (above < _AS_WHITE[1] * rise)
    white = white.any(1, keepdims=True)
    return jnp.where(white & ~stripe, _NO_CAP, sensor.ambient)


def full_pixels(
    laser: Shaped[Array, "groups window lines"],
    full: Int[Array, "groups 1 _"],
    coded: Bool[Array, "groups 1 _"],
) -> Bool[Array, "groups window lines"]:
    """Which pixels are full: those that reach the number, and those between two of them that nearly do.

    A sensor's pixels are not all full at one number, and the noise of its rows is added after that. What a JPEG leaves
    in full pixels is another matter.

    Args:
        laser: the numbers of the channel that shows it.
        full: the number.
        coded: which windows are of JPEGs.
    """
    sure = laser >= full.astype(laser.dtype)
    beside = jnp.pad(sure, [(0, 0), (1, 1), (0, 0)])
    between = beside[:, :-2] & beside[:, 2:] & (laser >= _NEARLY * full)
    return sure | between & ~coded


def smoothed(r: Pixels, which: Bool[Array, "groups 1 lines"]) -> tuple[Pixels, Pixels, Lines]:
    """The response smoothed by (1 2 1) / 4 in some lines, its gain, and what this adds to a stripe's variance, px².

    What a JPEG of full colour resolution leaves beside the truth is larger the higher the frequency: its tables of
    quantisation (ITU-T T.81, annex K) take steps ten times as long there. A fit that takes pixels for independent then
    reads the centre from the flanks' steepest pixels, where the error is. Smoothed, they are nearly independent.
    """
    gain = jnp.broadcast_to(jnp.where(which, SOFT_GAIN, 1.0), r.shape)
    return jnp.where(which, _softened(r), r), gain, jnp.where(which, _ADDED_PX2, 0.0)


def _softened(x: Pixels) -> Pixels:
    padded = jnp.pad(x, [(0, 0), (1, 1), (0, 0)], mode="edge")
    return (padded[:, :-2] + 2 * x + padded[:, 2:]) / 4


def smoothed_speckle(speckle: A, grain: A) -> tuple[A, A]:
    """Squared contrast of speckle in smoothed windows, over the gain of single pixels, and correlation of neighbours.

    Args:
        speckle: squared contrast in a pixel.
        grain: correlation ρ of neighbours; of pixels k apart it is ρ^(k²).
    """
    apart, near = (
        SOFT_GAIN * grain ** (k * k)
        + _SHARED * (grain ** ((k - 1) ** 2) + grain ** ((k + 1) ** 2))
        + _SHARED_FAR * (grain ** ((k - 2) ** 2) + grain ** ((k + 2) ** 2))
        for k in (0, 1)
    )
    return speckle * apart / SOFT_GAIN, near / apart


def bump(r: Pixels) -> Bump:
    """What stands out in each window of a response."""
    size = r.shape[1]
    k = places(size)
    padded = jnp.pad(r, [(0, 0), (2, 2), (0, 0)], mode="edge")
    s = jnp.zeros_like(r)
    for i, weight in enumerate(_SMOOTHING):
        s += weight * padded[:, i : i + size]
    top = s.max(1, keepdims=True)
    at = _least(k, s == top)
    left, right = _least(s, k < at), _least(s, k > at)
    # At the image's edge there may be no pixel beyond the peak: then one side alone decides.
    floor = jnp.where(jnp.isfinite(left) & jnp.isfinite(right), jnp.maximum(left, right), jnp.minimum(left, right))
    return Bump(s, floor, top, at)


def outline(r: Pixels) -> Outline:
    """The outline of the stripe in each window of a response."""
    seen = bump(r)
    s, at, k, size = seen.smooth, seen.at, places(r.shape[1]), r.shape[1]
    half_height = (seen.top + seen.floor) / 2
    below = s < half_height
    start = -_least(-k, below & (k < at))
    end = _least(k, below & (k > at))
    # The crossings lie between the last pixel below and the first above.
    share = (s[:, 1:] - half_height) / jnp.where(s[:, 1:] == s[:, :-1], 1.0, s[:, 1:] - s[:, :-1])
    rise = start + 1 - jnp.where(k[:, :-1] == start, share, 0.0).sum(1, keepdims=True)
    fall = end - jnp.where(k[:, :-1] == end - 1, share, 0.0).sum(1, keepdims=True)
    whole = (start >= 0) & (end < size)
    middle = jnp.where(whole, (rise + fall) / 2, at)
    width = jnp.sqrt(jnp.maximum(jnp.where(whole, fall - rise, 0.0) ** 2 - _SMOOTHING_FWHM2, _LEAST_WIDTH_PX**2))
    return Outline(s, seen.floor, seen.top, at, start, end, middle, width, whole)


def _least(values: Float[Array, "..."], where: Bool[Array, "..."]) -> Lines:
    return jnp.where(where, values, jnp.inf).min(1, keepdims=True)


def places(size: int) -> Float[Array, "1 window 1"]:
    """The pixels of a window, counted from its first."""
    return jnp.arange(size, dtype=jnp.float32)[None, :, None]
