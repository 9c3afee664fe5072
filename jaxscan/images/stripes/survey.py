"""What a photograph shows of its sensor: its colours' weights, its noise, and where it is full.

All of it is estimated from some of the windows about the coarse peaks, frame by frame, so that a frame's points do not
depend on what else is in the batch.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int

from jaxscan.images.stripes.colours import Colours, colours_of
from jaxscan.images.stripes.cross_section import MOST, cross_section, either
from jaxscan.images.stripes.grain import Chance
from jaxscan.images.stripes.likelihood import ROUGH, fit, off_beside
from jaxscan.images.stripes.ranks import median
from jaxscan.images.stripes.response import (
    FULL_OF_LUMA,
    NEUTRAL,
    ROUNDING,
    Backgrounds,
    Images,
    channels,
    detail_of,
    detailed,
    half_chroma,
    luma_error,
    noise_gain,
    numbers,
    response,
)
from jaxscan.images.stripes.saturation import FULL, full_number
from jaxscan.images.stripes.sensor_noise import sensor_noise
from jaxscan.images.stripes.windows import (
    Outline,
    Pixels,
    Places,
    Sensor,
    Windows,
    first_pixel,
    full_pixels,
    gather_pixels,
    outline,
    smoothed,
)
from jaxscan.kept_programs import compiled
from jaxscan.robust import NORMAL_MAD

# Lines of each frame that are looked at.
_LINES = 96
# A line seems to have a stripe that stands out by this part of what is usual of the strongest. A stripe has this number
# of lines at the least.
_STANDS, _SHORTEST = 0.25, 8
# Newton's steps: as far as the noise need be known.
_STEPS = 4
# Where speckle is strong, the residuals of a fit show the noise only once the fit has weighted its pixels by it; where
# it is weak too, if the fit knew of a quarter of its C² or less.
_LOOKS, _SKIPPED = 3, 3
_TOO_LITTLE = 4.0
# Rows at each end of the window that show the noise without laser.
_FLANK = 5
# Of a normal distribution: σ over its mean absolute deviation from the mean of five.
_DEVIATION_TO_SIGMA = 1.2533 / (1 - 1 / _FLANK) ** 0.5
# A mean of two such deviations over the lesser of them. One end is louder than the other beyond this multiple of it
# and this number of grey levels: of noise one line in fifty is.
_QUIETER, _LOUDER, _LOUDER_LEVELS = 1.26, 4.0, 1.0
# A stripe exceeds its background by more than this multiple of the noise: smoothed as it is, the greatest of a
# thousand rows of noise stands out by two or three σ.
LEAST_SIGNAL = 4.7
# From this one on a video's stripe is broad, ln of its standard deviation in px.
_BROAD_LN_PX = float(np.log(2.5))
# What the coding of a video leaves of a stripe's error, in parts of its light.
_LEFT_BY_VIDEO = 0.15
# From this one on its pixels show a stripe's own cross-section.
_RESOLVED_LN_PX = float(np.log(1.1))
# A channel's least part of luma: that of blue.
_LEAST_LUMA = 0.1
# How far ln s of a line may be from that of the others: no less than this, and before anything is known a factor of e.
_LEAST_SPREAD, _UNKNOWN = 0.1, 1.0
_TINY = 1e-12

# As `half_chroma` gives it, and the windows' first pixels.
Chroma = tuple[
    Bool[Array | np.ndarray, "frames"],
    Bool[Array | np.ndarray, "frames"],
    Int[Array | np.ndarray, "frames lines"],
]


def survey(
    images: Images,
    background: Backgrounds | None,
    ambient: Int[np.ndarray, "frames"],
    peak: Int[np.ndarray, "frames lines"],
    stands: Int[np.ndarray, "frames lines"],
    color: str,
    columns: bool,
    half: int,
    most: int,
    correlation: Float[np.ndarray, "most distances"] | None = None,
    smooth: Bool[np.ndarray, "most"] | None = None,
    coded: Bool[np.ndarray, "most"] | None = None,
    interpolated: bool = False,
) -> Sensor:
    """Look at each frame's sensor.

    Args:
        images: the photographs.
        background: the same with the laser off, one for all or one for each, or None.
        ambient: c of the response.
        peak: the coarse peak of every line.
        stands: how much it stands out.
        color: of the laser, or grey.
        columns: whether lines are columns.
        half: half the window's length.
        most: how many frames there may be. Each array has this number of entries, with the last one repeated, so that
            no number of frames is compiled again.
        correlation: of each frame's noise, from `noise_correlation`; 0 of frames whose noise is white, None
            where all are such.
        smooth: in which frames windows are smoothed; None where in none.
        coded: which frames are known to be JPEGs; None where none is.
        interpolated: whether the other channels are means of neighbouring pixels.
    """
    coded = np.zeros(most, bool) if coded is None else coded
    of = np.minimum(np.arange(most, dtype=np.int32), len(peak) - 1)
    line = _lines_with_a_stripe(stands)[of]
    frame = np.ascontiguousarray(np.broadcast_to(of[:, None], line.shape))
    ambient, row = ambient[of], peak[frame, line]
    at = (frame, line, row, columns, half)
    lit = gather_pixels(images, *at)
    dark = None if background is None else gather_pixels(background, *at)
    first = first_pixel(images, row, columns, half)
    # Merged exposures have 16 bits, and their own rounding.
    chroma = None if color == "grey" or lit.dtype != jnp.uint8 else half_chroma(lit, first, color)
    look = partial(survey_windows, lit, dark, ambient, color, correlation=correlation, smooth=smooth, coded=coded)
    look = partial(look, interpolated=np.array(interpolated))
    if chroma is None or not np.asarray(chroma[0]).any():
        return _with_cross_section(look(), look)
    halved, repeated = (np.asarray(each) for each in chroma)
    look = partial(look, chroma=(halved, repeated, first))
    sensor = look()
    # Colours at half resolution show all of a broad stripe, and luma's detail only its own error.
    broad = repeated & (np.asarray(sensor.ln_s) > _BROAD_LN_PX)
    if broad.any():
        look = partial(look, chroma=(halved & ~broad, repeated, first))
        sensor = look()
    return _with_cross_section(sensor, look)


def _with_cross_section(sensor: Sensor, look: Callable[..., Sensor]) -> Sensor:
    """The sensor, in frames whose lines leave something in common as the laser's own cross-section has it.

    That is taken where nothing in common is left then: of two lobes, or where it is something else that lines leave,
    it is not.

    Args:
        sensor: as a look shows it.
        look: looks again.
    """
    odd = ~np.asarray(sensor.apart) & (np.asarray(sensor.ln_s) > _RESOLVED_LN_PX)
    if not odd.any():
        return sensor
    found = look(odd=odd)
    taken = odd & np.asarray(found.apart) & np.all(np.abs(np.asarray(found.shape)) < np.array(MOST)[:, None], axis=0)
    if not taken.any():
        return sensor
    return either(taken, found, sensor)


def _lines_with_a_stripe(stands: Int[np.ndarray, "frames lines"]) -> Int[np.ndarray, "frames some"]:
    """Lines of each frame that seem to have one, evenly spread; of all lines where none stand out.

    As many of a narrow image or a short stripe, some of them twice: one size is compiled.
    """
    count = min(_LINES, stands.shape[1])
    strongest = np.sort(np.partition(stands, -count, axis=1)[:, -count:], axis=1)
    usual = np.median(strongest, axis=1)
    # Of a stripe that few lines have the median is one of those beside it. Lines that are not asked stand out least of
    # all: where most are not, all are looked at.
    few = strongest[:, -min(_SHORTEST, count)]
    short = 2 * (strongest >= _STANDS * few[:, None]).sum(axis=1) < count
    usual = np.where(short & (usual > np.iinfo(stands.dtype).min), few, usual)
    chosen = []
    # In light of another colour nothing stands out: less than nothing does.
    for each, least in zip(stands, np.minimum(_STANDS * usual, usual), strict=True):
        bright = np.flatnonzero(each >= least)
        chosen.append(bright[np.linspace(0, len(bright) - 1, _LINES).astype(np.int32)])
    return np.stack(chosen).astype(np.int32)


def survey_windows(
    lit: Array,
    dark: Array | None,
    ambient: Int[Array | np.ndarray, "frames"],
    color: str,
    gain: Pixels | None = None,
    chroma: Chroma | None = None,
    correlation: Float[Array | np.ndarray, "frames distances"] | None = None,
    smooth: Bool[Array | np.ndarray, "frames"] | None = None,
    coded: Bool[Array | np.ndarray, "frames"] | None = None,
    odd: Bool[Array | np.ndarray, "frames"] | None = None,
    interpolated: Bool[Array | np.ndarray, ""] | None = None,
) -> Sensor:
    """Look at each frame's sensor in some of its windows.

    Three programs: the second and the third, which take long to compile, are the same for all colours and depths.

    Args:
        lit: their pixels with the laser on.
        dark: the same with the laser off, or None.
        ambient: c of the response.
        color: of the laser, or grey.
        gain: as that of `Windows`; the noise is that of single pixels.
        chroma: None where no colours are at half resolution.
        correlation: as that of `survey`.
        smooth: as that of `survey`.
        coded: as that of `survey`.
        odd: in which frames the laser's own cross-section is looked for; None where in none.
        interpolated: as that of `survey`.
    """
    windows, around, sensor = _seen(lit, dark, ambient, color, gain, chroma, correlation, smooth, coded, interpolated)
    look = partial(_look, windows, around, read=sensor.read, correlation=correlation)
    asked = np.ones(len(lit), bool)
    if odd is not None:
        sensor = replace(sensor, shape=_cross_section(windows, around, look(sensor, asked, roughly=True), odd))
    sensor = look(sensor, asked, roughly=True)
    # Where speckle has made lines ragged, they are looked at again; so they are where the fit knew of too little of it.
    for _ in range(_LOOKS):
        before = np.asarray(sensor.speckle)
        sensor = look(sensor, asked)
        speckle = np.asarray(sensor.speckle)
        asked = (speckle > ROUGH) | (speckle > _TOO_LITTLE * before)
        if not asked.any():
            break
    return sensor


_cross_section = compiled()(cross_section)


@compiled(static_argnames="color")
def _seen(
    lit: Array,
    dark: Array | None,
    ambient: Int[Array, "frames"],
    color: str,
    gain: Pixels | None,
    chroma: tuple[Bool[Array, "frames"], Bool[Array, "frames"], Places] | None,
    correlation: Float[Array, "frames distances"] | None,
    smooth: Bool[Array, "frames"] | None,
    coded: Bool[Array, "frames"] | None,
    interpolated: Bool[Array, ""] | None,
) -> tuple[Windows, Outline, Sensor]:
    """The response in these windows, where the stripe lies in each, and what the ends of the windows show."""
    levels = channels(lit, dark, color)
    laser = numbers(lit, color)
    half, detail = None, None
    coded = jnp.zeros(len(lit), bool) if coded is None else coded
    if chroma is None:
        full = full_number(laser, coded)
    else:
        half, repeated, first = chroma
        detail, half = detail_of(levels, _FLANK, half, repeated, color)
        coded |= half & ~repeated
        full = full_number(laser, coded | repeated)
        full = jnp.where(half, jnp.floor(FULL_OF_LUMA / FULL * full).astype(full.dtype), full)
        of_line = jax.tree.map(lambda x: x[:, None, None], detail)
        laser = detailed(channels(lit, None, color), first, of_line, color)[0]
        levels = detailed(levels, first, of_line, color)
    burnt = full_pixels(laser, full[:, None, None], coded[:, None, None])
    one = jnp.ones(len(lit), jnp.float32)
    plain = response(levels, NEUTRAL, ambient[:, None, None])
    colours = None if color == "grey" else _colours(levels, plain, burnt, half, interpolated, coded, color)
    weights = (one, one) if colours is None else colours.weights(0.0)
    ground = _ground(plain, burnt, gain)
    r, own = plain, None
    if colours is not None:
        of_lines = jax.tree.map(lambda x: x[:, None, None], colours)
        own = of_lines.of_lines(levels, burnt)
        r = response(levels, own.weights, ambient[:, None, None])
    added = None
    if smooth is not None:
        r, gain, added = smoothed(r, smooth[:, None, None] & ~burnt.any(1, keepdims=True))
    # Of a colour its own light counts twice; in luma a channel's light counts for its part of it.
    in_luma = color == "grey" and levels[0].ndim < lit.ndim
    span = full.astype(jnp.float32) * (_part_of_luma(laser, r, burnt) if in_luma else 1 if color == "grey" else 2)
    rounding = ROUNDING**0.5 * noise_gain(weights, color)
    if half is not None and detail is not None:
        rounding = jnp.hypot(rounding, luma_error(detail, half, weights))
    noise = _ground(r, burnt, gain if own is None else own.louder if gain is None else gain * own.louder)
    if correlation is not None:
        noise /= _shown(correlation)
    read = jnp.maximum(noise, rounding)
    zero = jnp.zeros_like(one)
    unknown, white = _UNKNOWN * one, jnp.ones(len(lit), bool)
    sensor = Sensor(
        weights=weights,
        ambient=ambient,
        full=full,
        span=span,
        ground=ground,
        read=read,
        shot=zero,
        speckle=zero,
        grain=zero,
        ln_s=zero,
        ln_s_spread=unknown,
        beside=_beside(r),
        even=zero,
        apart=white,
        colours=colours,
        detail=detail,
        smooth=smooth,
        coded=coded,
        off_beside=zero,
    )
    return Windows(r, None, burnt, jnp.zeros(r.shape[::2], jnp.int32), gain, added, None, own), outline(r), sensor


@compiled(static_argnames="roughly")
def _look(
    windows: Windows,
    around: Outline,
    before: Sensor,
    asked: Bool[Array, "frames"],
    *,
    read: Float[Array, "frames"],
    correlation: Float[Array, "frames distances"] | None,
    roughly: bool = False,
) -> Sensor:
    """Fit the stripes with the noise as far as it is known, and read it off what they leave, in frames that are asked.

    With no idea of the noise some lines will do.
    """
    if roughly:
        windows, around = jax.tree.map(lambda x: x[..., ::_SKIPPED], (windows, around))
    found = fit(windows, around, jax.tree.map(lambda x: x[:, None, None], before), censored=True, steps=_STEPS)
    known = (around.whole & jnp.isfinite(found.inverse_sigma))[:, 0]
    ln_s = jnp.where(known, windows.as_it_is(found.profile.ln_s)[:, 0], jnp.nan)
    usual = median(ln_s)
    spread = jnp.maximum(NORMAL_MAD * median(jnp.abs(ln_s - usual[:, None])), _LEAST_SPREAD)
    # A line without a stripe has a peak too, of noise.
    shines = known & (around.top - around.floor > LEAST_SIGNAL * read[:, None, None])[:, 0]
    light, apart = sensor_noise(found, windows, around, shines, read, before, correlation, roughly)
    if before.detail is not None:
        from_video = before.detail.repeated & (before.detail.gains[0] > 0)
        light = jax.tree.map(partial(jnp.where, from_video), _of_video(read, light), light)
    sensor = replace(before, read=jnp.sqrt(light.read2), shot=light.shot, speckle=light.speckle)
    v = windows.variance(found.height, jax.tree.map(lambda x: x[:, None, None], sensor))
    off = off_beside(found.residual**2 / v, found, around)[:, 0]
    sensor = replace(
        sensor,
        off_beside=jnp.nan_to_num(median(jnp.where(shines, off, jnp.nan))),
        grain=light.grain,
        even=light.even,
        ln_s=jnp.where(known.any(1), usual, 0.0),
        ln_s_spread=jnp.where(known.any(1), spread, _UNKNOWN),
        apart=apart,
    )
    return jax.tree.map(partial(jnp.where, asked), sensor, before)


def _of_video(read: Float[Array, "frames"], light: Chance) -> Chance:
    """The noise of a stripe in a video.

    Beside the stripe, where nothing moves, a video is as it was predicted from the frames before; in the stripe it is
    off by a part of its light. What a fit of a few pixels leaves shows little of it.
    """
    zero = jnp.zeros_like(read)
    return Chance(read**2, zero, jnp.maximum(light.speckle, _LEFT_BY_VIDEO**2), zero, zero)


def light_of(sensor: Sensor, color: str) -> Float32[np.ndarray, "frames 4"]:
    """Read noise, gain, speckle contrast and saturation of each frame, of a pixel's laser channel.

    Light that the laser adds to its own channel counts twice in the response of a colour, and so does its noise. Where
    colours are at half resolution, they are luma's.
    """
    m, n = (np.asarray(w) for w in sensor.weights)
    by_light, by_noise = np.full(m.shape, 1.0 if color == "grey" else 2.0), noise_gain((m, n), color)
    if sensor.detail is not None:
        laser, first, second = (1 + np.asarray(by) for by in sensor.detail.gains)
        by_luma = 2 * laser - m * first - n * second
        by_light, by_noise = (np.where(laser > 1, by_luma, by) for by in (by_light, by_noise))
    read, shot, speckle, full = (np.asarray(x) for x in (sensor.read, sensor.shot, sensor.speckle, sensor.full))
    return np.stack([read / by_noise, shot / by_light, np.sqrt(speckle), full], axis=-1).astype(np.float32)


def _colours(
    levels: tuple[Array, ...],
    r: Float[Array, "frames window lines"],
    burnt: Array,
    half: Bool[Array, "frames"] | None,
    interpolated: Bool[Array, ""] | None,
    coded: Bool[Array, "frames"],
    color: str,
) -> Colours:
    core, rise = _core(r, burnt)
    light = jnp.where(core, rise, 0.0)
    levels = tuple(x.astype(r.dtype) for x in levels)
    return colours_of(levels, light, _FLANK, burnt, half, interpolated, coded, color)


def _core(r: Pixels, burnt: Array) -> tuple[Bool[Array, "frames window lines"], Pixels]:
    """The pixels of whole stripes above half their height that are not full, and how far each rises."""
    around = outline(r)
    k = jnp.arange(r.shape[1])[None, :, None]
    return (k > around.start) & (k < around.end) & around.whole & ~burnt, r - around.floor


def _part_of_luma(
    laser: Int[Array, "frames window lines"], r: Float[Array, "frames window lines"], burnt: Array
) -> Float[Array, "frames"]:
    """What the brightest channel of the laser's light counts for in luma: of red 0.3."""
    core, luma = _core(r, burnt)
    ends = jnp.concatenate([laser[:, :_FLANK], laser[:, -_FLANK:]], axis=1).astype(jnp.float32)
    rise = laser - ends.mean(1, keepdims=True)
    luma, rise = (jnp.where(core, x, 0.0).sum((1, 2)) for x in (luma, rise))
    return jnp.clip(luma / jnp.maximum(rise, _TINY), _LEAST_LUMA, 1.0)


def _shown(correlation: Float[Array, "frames distances"]) -> Float[Array, "frames"]:
    """Which part of σ stands out from the mean of five pixels, in parts of that of white noise."""
    apart = jnp.arange(1, 1 + correlation.shape[1])
    lost = 2 / _FLANK**2 * ((_FLANK - apart)[None] * correlation).sum(1)
    return jnp.sqrt(jnp.maximum(1 - lost / (1 - 1 / _FLANK), _TINY))


def _beside(r: Float[Array, "frames window lines"]) -> Float[Array, "frames"]:
    """The mean product over the mean square of neighbouring pixels at the ends of the windows."""
    ends = jnp.stack([r[:, :_FLANK], r[:, -_FLANK:]])
    off = ends - ends.mean(-2, keepdims=True)
    squares, products = (off * off).sum(-2), (off[..., 1:, :] * off[..., :-1, :]).sum(-2)
    return (products / jnp.maximum(squares, _TINY)).mean((0, 2))


def _ground(r: Float[Array, "frames window lines"], burnt: Array, gain: Pixels | None) -> Float[Array, "frames"]:
    """What stands out without a laser: noise and texture (σ), from the ends of each frame's windows.

    A burnt-out stripe is flat, so that its window may begin or end on it: there the quieter end counts. So it does
    where an edge of the room's light lies in one end.
    """

    def flanks(x: Pixels) -> Float[Array, "2 frames flank lines"]:
        return jnp.stack([x[:, :_FLANK], x[:, -_FLANK:]])

    off = flanks(r) - flanks(r).mean(-2, keepdims=True)
    deviation = jnp.abs(off if gain is None else off / jnp.sqrt(flanks(gain))).mean(-2)
    quieter = deviation.min(0)
    one_sided = burnt.any(1) | (deviation.max(0) > _LOUDER * quieter + _LOUDER_LEVELS)
    each = jnp.where(one_sided, _QUIETER * quieter, deviation.mean(0))
    return _DEVIATION_TO_SIGMA * median(each)
