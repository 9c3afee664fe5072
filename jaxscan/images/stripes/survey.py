"""What a photograph tells of its sensor: its colours' weights, its noise, and where it is full.

All of it is estimated from some of the windows about the coarse peaks, frame by frame, so that a frame's points do not
depend on what else is in the batch.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int

from jaxscan.images.stripes.likelihood import Fit, fit
from jaxscan.images.stripes.response import (
    FULL_OF_LUMA,
    NEUTRAL,
    Backgrounds,
    Images,
    channel_weights,
    channels,
    detail_of,
    detailed,
    has_half_chroma,
    luma_error,
    numbers,
    response,
)
from jaxscan.images.stripes.windows import Outline, Pixels, Places, Sensor, Windows, first_pixel, gather_pixels, outline

# Lines of each frame that are looked at, and in how many groups the noise is taken before the median.
_LINES, _GROUPS = 96, 8
# Newton's steps: as far as the noise need be known.
_STEPS = 4
# Where speckle is strong, what a fit leaves tells the noise only once the fit has weighted its pixels by it.
_LOOKS = 2
# Rows at each end of the window that tell the noise without laser.
_FLANK = 5
# Of a normal distribution: σ over its mean absolute deviation from the mean of five.
_DEVIATION_TO_SIGMA = 1.2533 / (1 - 1 / _FLANK) ** 0.5
# A pixel is full from its greatest number on, and what a JPEG makes of it.
FULL = 0.99
# Numbers of 16 bits may come from a sensor of fewer.
_DEPTHS = (10, 12, 14)
# Rounding's own σ, grey levels: no noise is smaller.
_ROUNDING = 12**-0.5
# A stripe's tails are lower than this part of what is seen of its peak.
_TAIL = 0.1
# Its core is higher.
_CORE = 0.5
# Up to this full width at half height the last five of 25 pixels are free of it: 2.5 px is 2.1 σ less than 8 px away.
_CLEAR_WIDTH_PX = 5.0
# A stripe stands above its background by more than so many times the noise: smoothed as it is, the greatest of a
# thousand rows of noise stands out by two or three σ.
LEAST_SIGNAL = 4.7
# Light's own noise is read where at least this part of the lines is not full.
_LEAST_FAIR = 0.25
# A residual that the fit all but removes tells nothing of the noise.
_LEAST_REDUNDANCY = 0.25
# Chance, in standard deviations: the median of groups scatters 1.25 times as much as a mean.
_CHANCE = 3.0
_NORMAL_MAD = 1.4826
# How far ln s of a line may be from that of the others: no less than this, and before anything is known a factor of e.
_LEAST_SPREAD, _UNKNOWN = 0.1, 1.0


def survey(
    images: Images,
    background: Backgrounds | None,
    ambient: Int[np.ndarray, "frames"],
    peak: Int[np.ndarray, "frames lines"],
    color: str,
    columns: bool,
    half: int,
    most: int,
) -> Sensor:
    """Look at each frame's sensor.

    Args:
        images: the photographs.
        background: the same with the laser off, one for all or one for each, or None.
        ambient: c of the response.
        peak: the coarse peak of every line.
        color: of the laser, or grey.
        columns: whether lines are columns.
        half: half the window's length.
        most: how many frames there may be: so many entries has each number of the answer, the last one repeated, so
            that no number of frames compiles anew.
    """
    frames, lines = peak.shape
    # As many of a narrow image, some of them twice: one size is compiled.
    some = np.linspace(0, lines - 1, _LINES).astype(np.int32)
    of = np.minimum(np.arange(most, dtype=np.int32), frames - 1)
    frame, line = (np.ascontiguousarray(x) for x in np.broadcast_arrays(of[:, None], some))
    ambient = ambient[of]
    at = (frame, line, peak[of][:, some], columns, half)
    lit = gather_pixels(images, *at)
    dark = None if background is None else gather_pixels(background, *at)
    first = first_pixel(images, jnp.asarray(peak[of][:, some]), columns, half)
    # Merged exposures have 16 bits, and their own rounding.
    chroma = None if color == "grey" or lit.dtype != jnp.uint8 else has_half_chroma(lit, first, color)
    if chroma is None or not np.asarray(chroma).any():
        return survey_windows(lit, dark, ambient, color)
    return survey_windows(lit, dark, ambient, color, chroma=(chroma, first))


@partial(jax.jit, static_argnames="color")
def survey_windows(
    lit: Array,
    dark: Array | None,
    ambient: Int[Array, "frames"],
    color: str,
    gain: Pixels | None = None,
    chroma: tuple[Bool[Array, "frames"], Places] | None = None,
) -> Sensor:
    """Look at each frame's sensor in some of its windows.

    Args:
        lit: their pixels with the laser on.
        dark: the same with the laser off, or None.
        ambient: c of the response.
        color: of the laser, or grey.
        gain: as that of `Windows`; the noise is that of single pixels.
        chroma: whether each frame's colours are at half resolution, and the windows' first pixels; None where none are.
    """
    levels = channels(lit, dark, color)
    laser = numbers(lit, color)
    full, half, detail = _full_number(laser), None, None
    if chroma is not None:
        half, first = chroma
        detail, half = detail_of(levels, _FLANK, half, color)
        full = jnp.where(half, jnp.floor(FULL_OF_LUMA / FULL * full).astype(full.dtype), full)
        of_line = tuple(by[:, None, None] for by in detail)
        laser = detailed(channels(lit, None, color), first, of_line, color)[0]
        levels = detailed(levels, first, of_line, color)
    burnt = laser >= full[:, None, None].astype(laser.dtype)
    one = jnp.ones(len(lit), jnp.float32)
    plain = response(levels, NEUTRAL, ambient[:, None, None])
    weights = (one, one) if color == "grey" else _weights(levels, plain, burnt, half, color)
    r = response(levels, (weights[0][:, None, None], weights[1][:, None, None]), ambient[:, None, None])
    span = full.astype(jnp.float32) * (1 if color == "grey" else 2)
    rounding = _ROUNDING * (one if color == "grey" else jnp.sqrt(4 + weights[0] ** 2 + weights[1] ** 2))
    ground = _ground(plain, gain)
    if half is not None and detail is not None:
        rounding = jnp.hypot(rounding, luma_error(detail, half, weights))
    read = jnp.maximum(_ground(r, gain), rounding)
    sensor = Sensor(weights, ambient, full, span, ground, read, 0 * one, 0 * one, 0 * one, _UNKNOWN * one, detail)
    around = outline(r)
    windows = Windows(r, None, burnt, jnp.zeros(r.shape[::2], jnp.int32), gain)

    def look(_: Array, sensor: Sensor) -> Sensor:
        """Fit the stripes with the noise as far as it is known, and read the noise off what they leave."""
        found = fit(windows, around, jax.tree.map(lambda x: x[:, None, None], sensor), censored=True, steps=_STEPS)
        known = (around.whole & jnp.isfinite(found.inverse_sigma))[:, 0]
        ln_s = jnp.where(known, found.profile.ln_s[:, 0], jnp.nan)
        usual = _median(ln_s)
        spread = jnp.maximum(_NORMAL_MAD * _median(jnp.abs(ln_s - usual[:, None])), _LEAST_SPREAD)
        any_ = known.any(1)
        own, shot, speckle = _noise(found, windows, around, known, read)
        return replace(
            sensor,
            read=own,
            shot=shot,
            speckle=speckle,
            ln_s=jnp.where(any_, usual, 0.0),
            ln_s_spread=jnp.where(any_, spread, _UNKNOWN),
        )

    return jax.lax.fori_loop(0, _LOOKS, look, sensor)


def light_of(sensor: Sensor, color: str) -> Float32[np.ndarray, "frames 4"]:
    """Read noise, gain, speckle contrast and saturation of each frame, of a pixel's laser channel.

    Light that the laser adds to its own channel counts twice in the response of a colour, and so does its noise. Where
    colours are at half resolution, they are luma's.
    """
    m, n = (np.asarray(w) for w in sensor.weights)
    by_light, by_noise = (
        (np.ones(m.shape),) * 2 if color == "grey" else (np.full(m.shape, 2.0), np.sqrt(4 + m**2 + n**2))
    )
    if sensor.detail is not None:
        laser, first, second = (1 + np.asarray(by) for by in sensor.detail)
        by_luma = 2 * laser - m * first - n * second
        by_light, by_noise = (np.where(laser > 1, by_luma, by) for by in (by_light, by_noise))
    read, shot, speckle, full = (np.asarray(x) for x in (sensor.read, sensor.shot, sensor.speckle, sensor.full))
    return np.stack([read / by_noise, shot / by_light, np.sqrt(speckle), full], axis=-1).astype(np.float32)


def greatest_numbers(bits: int) -> list[int]:
    """What the greatest number of a sensor may be whose photographs have so many bits."""
    return [2**b - 1 for b in (*(d for d in _DEPTHS if d < bits), bits)]


def _full_number(laser: Int[Array, "frames window lines"]) -> Int[Array, "frames"]:
    """From which number on a pixel is full: near the greatest that the sensor can have given."""
    bits = jnp.iinfo(laser.dtype).bits
    depths = jnp.asarray(greatest_numbers(bits), jnp.int32)
    top = laser.astype(jnp.int32).max((1, 2))
    greatest = jnp.where(depths[None] >= top[:, None], depths[None], depths[-1]).min(1)
    return jnp.floor(FULL * greatest).astype(jnp.int32)


def _weights(
    levels: tuple[Array, ...],
    r: Float[Array, "frames window lines"],
    burnt: Array,
    half: Bool[Array, "frames"] | None,
    color: str,
) -> tuple[Float[Array, "frames"], Float[Array, "frames"]]:
    around = outline(r)
    k = jnp.arange(r.shape[1])[None, :, None]
    beside = (k < _FLANK) | (k >= r.shape[1] - _FLANK)
    core = (k > around.start) & (k < around.end) & around.whole & ~burnt
    stripe = jnp.where(core, r - around.floor, 0.0)
    return channel_weights(levels, stripe, jnp.broadcast_to(beside, r.shape), half, color)


def _ground(r: Float[Array, "frames window lines"], gain: Pixels | None) -> Float[Array, "frames"]:
    """What stands out without a laser: noise and texture (σ), from the ends of each frame's windows."""

    def flanks(x: Pixels) -> Float[Array, "2 frames flank lines"]:
        return jnp.stack([x[:, :_FLANK], x[:, -_FLANK:]])

    off = flanks(r) - flanks(r).mean(-2, keepdims=True)
    deviation = jnp.abs(off if gain is None else off / jnp.sqrt(flanks(gain))).mean((0, -2))
    return _DEVIATION_TO_SIGMA * _median(deviation)


def _noise(
    found: Fit, windows: Windows, around: Outline, known: Bool[Array, "frames lines"], ground: Float[Array, "frames"]
) -> tuple[Float[Array, "frames"], Float[Array, "frames"], Float[Array, "frames"]]:
    """Read noise, shot noise and speckle, from what is left of the stripes when their profiles have been taken off.

    A residual e has the expected square v (1 − h), v = gain · (read² + shot · A P + speckle · (A P)²), with
    h = w Jᵀ (Jᵀ W J)⁻¹ J its leverage.
    Summed over the stripe's tails, its flanks and its core, these are three equations; solved for groups of lines, of
    which the median is taken, for where a stripe meets an edge its profile is no Gaussian. Where stripes are so narrow
    that the ends of the windows are free of them, these tell `read` better.
    """
    rest = 1 - found.weight * _leverage(found.jacobian, found.factor)
    height = jnp.maximum(found.height, 0.0)
    peak = around.top - around.floor
    # A line without a stripe has a peak too, of noise.
    lit = known & (peak > LEAST_SIGNAL * ground[:, None, None])[:, 0]
    free = (found.weight > 0) & ~windows.full & lit[:, None] & (rest > _LEAST_REDUNDANCY)
    tail, core = height < _TAIL * peak, height > _CORE * peak

    def grouped(where: Array, values: Pixels) -> Float[Array, "frames groups"]:
        each = jnp.where(free & where, values, 0.0).sum(1)
        groups = min(_GROUPS, each.shape[1])
        use = each.shape[1] // groups * groups
        return each[:, :use].reshape(each.shape[0], groups, -1).sum(2)

    def usual(above: Float[Array, "frames groups"], below: Float[Array, "frames groups"]) -> Float[Array, "frames"]:
        return _median(jnp.where(below > 0, above / jnp.where(below > 0, below, 1.0), jnp.nan))

    squares = found.residual**2 if windows.gain is None else found.residual**2 / windows.gain
    (e_tail, e_rest), (n_tail, n_rest), (p_tail, p_rest), (q_tail, q_rest) = (
        [grouped(where, values) for where in (tail, ~tail)]
        for values in (squares, rest, rest * height, rest * height**2)
    )
    # Of the two laws by which the light may scatter, photons leave the least of what the tails show to the sensor.
    by_photons = usual(e_tail * p_rest - e_rest * p_tail, n_tail * p_rest - n_rest * p_tail)
    by_speckle = usual(e_tail * q_rest - e_rest * q_tail, n_tail * q_rest - n_rest * q_tail)
    read2 = jnp.where(by_photons > 0, by_photons, by_speckle)
    clear = _median(jnp.where(known, around.width[:, 0], jnp.nan)) < _CLEAR_WIDTH_PX
    read2 = jnp.where(clear | ~(read2 > 0), ground**2, jnp.minimum(read2, ground**2))
    # Steep flanks beside a full core say more of the model than of photons.
    fair = ~windows.full.any(1, keepdims=True)
    (n, n_core), (e, e_core), (p, p_core), (q, q_core) = (
        [grouped(where, values) for where in (fair & ~core, fair & core)]
        for values in (rest, squares, rest * height, rest * height**2)
    )
    excess, excess_core = e - read2[:, None] * n, e_core - read2[:, None] * n_core
    shot = usual(excess * q_core - excess_core * q, p * q_core - p_core * q)
    speckle = usual(excess_core * p - excess * p_core, p * q_core - p_core * q)
    alone = usual(excess + excess_core, p + p_core), usual(excess + excess_core, q + q_core)
    # Neither is negative: where one would be, the other explains it all.
    shot, speckle = (
        jnp.where(speckle > 0, jnp.where(shot > 0, shot, 0.0), alone[0]),
        jnp.where(shot > 0, jnp.where(speckle > 0, speckle, 0.0), alone[1]),
    )
    # Drawn towards none where they are within what chance alone makes of so many residuals.
    found_squares = shot * (p + p_core).sum(1) + speckle * (q + q_core).sum(1)
    tiny = jnp.finfo(jnp.float32).tiny
    chance = _CHANCE**2 * 2 * read2**2 * (n + n_core).sum(1) / jnp.maximum(found_squares**2, tiny)
    sure = jnp.where((found_squares > 0) & (chance < 1), 1 - chance, 0.0)
    # Of a burnt-out stripe the few lines that are not full are its ends and edges, which are no sample of the others.
    lines = (fair & lit[:, None]).sum((1, 2)) >= _LEAST_FAIR * lit.sum(1)
    shot, speckle = (jnp.where(lines & (value > 0), sure * value, 0.0) for value in (shot, speckle))
    return jnp.sqrt(read2), shot, speckle


def _leverage(jacobian: tuple[Pixels, ...], factor: list[list[Array]]) -> Pixels:
    """Jᵀ (L Lᵀ)⁻¹ J of each pixel: the square of L⁻¹ J."""
    y: list[Pixels] = []
    for i, J in enumerate(jacobian):
        y.append((J - sum(factor[i][m] * y[m] for m in range(i))) / factor[i][i])
    return sum((value**2 for value in y), start=jnp.zeros_like(jacobian[0]))


def _median(values: Float[Array, "frames some"]) -> Float[Array, "frames"]:
    """The median of each frame's values that are not NaN.

    By their ranks: of so few, counting is sooner done, and much sooner compiled, than a sort.
    """
    known = ~jnp.isnan(values)
    count = known.sum(1, keepdims=True)
    others = jnp.where(known, values, jnp.inf)[:, None]
    before = (others < values[..., None]).sum(2)
    upto = (others <= values[..., None]).sum(2)

    def ranked(rank: Int[Array, "frames 1"]) -> Float[Array, "frames"]:
        return jnp.where(known & (before <= rank) & (rank < upto), values, -jnp.inf).max(1)

    return jnp.where(count[:, 0] > 0, (ranked((count - 1) // 2) + ranked(count // 2)) / 2, jnp.nan)
