"""Several exposures of one motor step merged into one photograph of high dynamic range.

A linear sensor reads y_i = t_i E + noise from the irradiance E in the time t_i, up to the number z at which it is full.
Where its noise has one σ in all exposures, the estimate of least variance is

    E = Σ t_i y_i / Σ t_i²

over the exposures in which the pixel is not full. Photons alone would ask for Σ y_i / Σ t_i; weights of t_i² cost them
6 % of σ at two exposures of 1:4, and those of photons cost a sensor of one σ 17 %.

Near black, noise is cut off at zero, and a mean over what is left is too bright. Which exposures are too dark for a
pixel is decided by the longest in which it is not full, never by their own numbers: that would select among the noise.

What a camera adds to every number, its black level b, is no light: y_i = t_i E + b. In pixels of two levels of light,
dim and bright, the means of two exposures are on one line of the slope t_i / t_j, if the sensor is linear; where it
meets y_i = y_j is b. It is subtracted, and what it is worth in the longest exposure is added again, so that noise about
black is not cut off.

The photograph has 16 bits. E is scaled such that a pixel that is full in the shortest exposure is full in the
photograph too: a censored datum for the fit of the profile. One step of its numbers is one step of the *longest*
exposure, of 8 bits, up to a ratio of exposures of 1:256.
"""

from collections.abc import Sequence
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt

from jaxscan.errors import InputError
from jaxscan.images.stripes.saturation import FULL, greatest_numbers
from jaxscan.kept_programs import compiled

Frames = UInt[Array | np.ndarray, "exposures rows columns *rgb"]
Merged = UInt[Array, "rows columns *rgb"]

_GREATEST: Final = 65535
# The greatest number of a pixel that was not full in every exposure.
_NOT_FULL: Final = int(FULL * _GREATEST) - 1
# A pixel is too dark in an exposure where it is expected to read less than this part of a full one.
_BLACK: Final = 0.02
# Exposures are compared on pixels that lie between these parts of a full one in the longer one, if there are at least
# this number, on every Nth row and column, or on all where these are too few; not where the shorter one reads less than
# this part of a full one in the mean; they disagree where their irradiances differ by more than this factor.
_COMPARED, _LEAST_COMPARED, _EVERY, _LEAST_PART, _AGREE = (0.15, 0.85), 200, 4, 0.03, 1.25
# A black level shows where the means of bright and dim pixels of the longer exposure are this part of a full one apart,
# and is subtracted from this part on: noise that is cut off at zero looks like a smaller one.
_APART, _LEAST_LEVEL = 0.05, 0.01


def merge_exposures(
    frames: Frames, exposures_s: Sequence[float], backgrounds: Frames | None = None
) -> tuple[Merged, Merged | None]:
    """One photograph from several exposures of a scene that stands still, and one of its background.

    Args:
        frames: (exposures, rows, columns) grey or (exposures, rows, columns, 3), 8 or 16 bits, linear in the light
            above one black level.
        exposures_s: how long each was exposed, in any order; equal ones are averaged.
        backgrounds: the same scene with the laser off, one for each frame, exposed as long.

    Returns:
        Photographs of 16 bits in one scale. A pixel (of a channel) that is full in every exposure is 65535.

    Raises:
        InputError: exposures are missing or not positive, shapes or depths differ, or the photographs are not brighter
            in proportion to their exposures above a black level.
    """
    times = np.asarray(exposures_s, np.float64)
    if times.shape != frames.shape[:1] or not len(times):
        raise InputError(f"exposures_s: {times.size} exposure times for {len(frames)} frames: give one for each")
    if not (np.isfinite(times) & (times > 0)).all():
        raise InputError(f"exposures_s = {times.tolist()}: an exposure lasts longer than 0 seconds")
    if frames.dtype not in (np.uint8, np.uint16):
        raise InputError(f"the frames have pixels of {frames.dtype}: give 8 or 16 bit integers")
    if backgrounds is not None and (backgrounds.shape, backgrounds.dtype) != (frames.shape, frames.dtype):
        raise InputError(
            f"the backgrounds are {backgrounds.dtype} of shape {backgrounds.shape}, the frames {frames.dtype} of shape "
            f"{frames.shape}: of a scan with several exposures of a step take one background for each frame"
        )
    # The longest first: the first that is not full then shows how bright a pixel is.
    order = np.argsort(-times, kind="stable")
    full = full_number(int(np.max(frames)), frames.dtype)
    lit = [np.asarray(frames[i]) for i in order]
    relative = times[order] / times.min()
    dark = None if backgrounds is None else [np.asarray(backgrounds[i]) for i in order]
    black = _black_level(lit, dark, relative, full)
    arguments = (jnp.asarray(relative, jnp.float32), full, jnp.float32(black))
    merged = _merge(tuple(lit), *arguments, of_laser=True)
    return merged, None if dark is None else _merge(tuple(dark), *arguments, of_laser=False)


def full_number(top: int, dtype: np.dtype) -> int:
    """From which number on a pixel is full, in photographs whose greatest number is `top`: as `survey` has it."""
    return int(FULL * next(greatest for greatest in greatest_numbers(8 * dtype.itemsize) if top <= greatest))


@compiled(static_argnames="of_laser")
def _merge(
    frames: tuple[UInt[Array, "rows columns *rgb"], ...],
    times: Float[Array, "exposures"],
    full: int,
    black: Float[Array, ""],
    of_laser: bool,
) -> Merged:
    """Irradiances in numbers of 16 bits; `times` are relative to the shortest, the longest comes first."""
    above, below = jnp.zeros((2, *frames[0].shape), jnp.float32)
    expected, longest = jnp.full((2, *frames[0].shape), jnp.inf, jnp.float32)
    for frame, t in zip(frames, times, strict=True):
        y = frame.astype(jnp.float32) - black
        free: Bool[Array, "rows columns *rgb"] = frame.astype(jnp.int32) < full
        first = free & jnp.isinf(longest)
        expected, longest = jnp.where(first, y / t, expected), jnp.where(first, t, longest)
        use = free & ((t == longest) | (expected * t >= _BLACK * full))
        above += jnp.where(use, t * y, 0.0)
        below += jnp.where(use, t * t, 0.0)
    scale = _NOT_FULL / jnp.asarray(full, jnp.float32)
    merged = jnp.rint(scale * above / jnp.maximum(below, 1.0) + scale * black / times[0]).clip(0, _NOT_FULL)
    # What is full without the laser is so with it, and is no less bright for being subtracted.
    return jnp.where(below > 0, merged, _GREATEST if of_laser else _NOT_FULL).astype(jnp.uint16)


def _black_level(
    frames: Sequence[np.ndarray],
    backgrounds: Sequence[np.ndarray] | None,
    times: Float[np.ndarray, "exposures"],
    full: int,
) -> float:
    """What the camera adds to every number; 0 where that is little, or does not show.

    Raises:
        InputError: above it, numbers do not grow in proportion to the exposure.
    """
    pairs, levels = [], []
    for i in range(len(frames) - 1):
        lit = frames[i], frames[i + 1]
        bright = _means(*lit, _COMPARED[0] * full, _COMPARED[1] * full)
        if bright is None:
            continue
        stated = float(times[i] / times[i + 1])
        pairs.append((stated, *bright))
        # Without backgrounds what is dark beside the stripe shows it.
        if backgrounds is None:
            dim = _means(*lit, -1, _COMPARED[0] * full)
        else:
            dim = _means(backgrounds[i], backgrounds[i + 1], -1, _COMPARED[1] * full)
        if dim is None or bright[0] - dim[0] < _APART * full or stated == 1:
            continue
        slope = (bright[0] - dim[0]) / max(bright[1] - dim[1], 1.0)
        if 1 / _AGREE < slope / stated < _AGREE:
            levels.append((stated * dim[1] - dim[0]) / (stated - 1))
    black = float(np.median(levels)) if levels else 0.0
    black = black if black >= _LEAST_LEVEL * full else 0.0
    for stated, of_longer, of_shorter in pairs:
        longer, shorter = of_longer - black, of_shorter - black
        if max(shorter, longer / stated) < _LEAST_PART * full:
            continue
        ratio = longer / max(shorter, 1.0)
        if not 1 / _AGREE < ratio / stated < _AGREE:
            above = f", above a black level of {black:.0f}" if black else ""
            raise InputError(
                f"exposures_s: a frame exposed {stated:.3g} times as long as another of its step is {ratio:.3g} times "
                f"as bright ({of_longer:.0f} and {of_shorter:.0f} grey levels in the mean of the same pixels{above}): "
                "check the exposure times, that the camera keeps its gain and stores numbers in proportion to the "
                "light (no gamma, no contrast curve), and its black level, which adds the same to every number: set it "
                "to 0 if nothing is cut off by that, or photograph each exposure with the laser off too (background)"
            )
    return black


def _means(longer: np.ndarray, shorter: np.ndarray, low: float, high: float) -> tuple[float, float] | None:
    """The means of two exposures in the pixels that lie between two numbers in the longer one; None for too few.

    Chosen by the longer one alone: a limit on both would choose their ratio too.
    """
    for every in (_EVERY, 1):
        here = longer[::every, ::every]
        chosen = (here > low) & (here < high)
        if chosen.sum() >= _LEAST_COMPARED:
            of_longer, of_shorter = (x[chosen].mean(dtype=np.float64) for x in (here, shorter[::every, ::every]))
            return float(of_longer), float(of_shorter)
    return None
