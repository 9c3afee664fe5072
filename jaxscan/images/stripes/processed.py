"""What was done to a photograph before it came: a filter that its noise shows, a JPEG, colours at half resolution."""

from typing import Final

import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int

from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.blocks import has_blocks
from jaxscan.images.stripes.smoothed import DISTANCES, noise_correlation
from jaxscan.images.stripes.windows import Sensor

# Neighbouring pixels beside the stripe are alike from this on, −0.2 being white: it is looked into.
ALIKE_BESIDE: Final = -0.12
# Lines that are asked whether they are burnt out, before any is measured, are this number of lines apart.
_SOME: Final = 8


def correlations(
    frames: np.ndarray | Array,
    dark: np.ndarray | Array | None,
    settings: StripeSettings,
    sensor: Sensor,
    peak: Int[np.ndarray, "frames lines"],
) -> Float32[np.ndarray, "most distances"]:
    """Correlation of the noise 1, 2, … pixels apart in each frame, 0 where it is white; as long as `sensor`."""
    beside, m, n = (np.asarray(x) for x in (sensor.beside, *sensor.weights))
    found = np.zeros((len(beside), DISTANCES), np.float32)
    for i in np.flatnonzero(beside[: len(peak)] > ALIKE_BESIDE):
        ground = None if dark is None else np.asarray(dark[i if len(dark) > 1 else 0])
        told = noise_correlation(np.asarray(frames[i]), ground, settings, (m[i], n[i]), peak[i])
        if told is not None:
            found[i] = told
    return found


def are_jpegs(
    frames: np.ndarray | Array,
    settings: StripeSettings,
    sensor: Sensor,
    peak: Int[np.ndarray, "frames lines"],
    may_be: Bool[np.ndarray, "most"],
    asked: Bool[np.ndarray, "most"],
) -> Bool[np.ndarray, "most"]:
    """Which frames are JPEGs: of those that may be by colours at half resolution, of those that are asked by blocks."""
    half, may_be = at_half_resolution(sensor), may_be & ~of_video(sensor)
    found = may_be & half
    for i in np.flatnonzero((may_be & asked & ~half)[: len(peak)]):
        found[i] = has_blocks(np.asarray(frames[i]), settings, peak[i])
    return found


def at_half_resolution(sensor: Sensor) -> Bool[np.ndarray, "most"]:
    """Which frames have their colours at half resolution."""
    none = np.zeros(len(sensor.ln_s), bool)
    return np.any([np.asarray(by) != 0 for by in sensor.detail.gains], axis=0) if sensor.detail else none


def of_video(sensor: Sensor) -> Bool[np.ndarray, "most"]:
    """Which frames have both pixels of a pair of one colour, as those of a video have."""
    return np.zeros(len(sensor.ln_s), bool) if sensor.detail is None else np.asarray(sensor.detail.repeated)


def share_full(
    frames: np.ndarray | Array, settings: StripeSettings, sensor: Sensor, peak: Int[np.ndarray, "frames lines"]
) -> Float[np.ndarray, "frames"]:
    """In which part of some lines of each frame the coarse peak is full."""
    line = np.arange(0, peak.shape[1], _SOME)
    places = (peak[:, line], line) if settings.columns else (line, peak[:, line])
    pixels = np.asarray(frames[(np.arange(len(peak))[:, None], *places)])
    if settings.color != "grey":
        pixels = pixels[..., CHANNELS[settings.color][0]]
    elif pixels.ndim > peak.ndim:
        pixels = pixels.max(-1)
    return (pixels >= np.asarray(sensor.full)[: len(peak), None]).mean(axis=1)
