"""What the photographs of a batch show of their light, their sensors, and of what was done to them since."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32

from jaxscan.images.stripes.along import with_grain
from jaxscan.images.stripes.batch import Batch
from jaxscan.images.stripes.cross_section import either, size_of
from jaxscan.images.stripes.processed import (
    ALIKE_BESIDE,
    are_jpegs,
    at_half_resolution,
    correlations,
    of_video,
    share_full,
)
from jaxscan.images.stripes.saturation import has_plateau
from jaxscan.images.stripes.survey import light_of
from jaxscan.images.stripes.windows import Sensor

# Stripes of a standard deviation up to 1.7 px are within short windows, with some background.
_SLIM_LN_PX: Final = float(np.log(1.7))
# Up to this one, a JPEG's error in the stripe's blocks is large beside what the stripe leaves of its own steepness.
_SHARP_LN_PX: Final = float(np.log(1.3))
# What a cross-section has beside a bell, from which it is said to be none: flat ones have 0.27 to 0.36.
_FAR_FROM_A_BELL: Final = 0.15
# The part of a frame's lines that are burnt out, beyond which no edges are looked for in the others.
MOSTLY_BURNT: Final = 0.3


@dataclass(frozen=True)
class Light:
    """The light of a batch's photographs, each array in `FRAMES_AT_ONCE` entries.

    Attributes:
        sensor: colours' weights, noise and saturation, of the windows that are measured.
        of_pixels: the same of single pixels: another one where windows are smoothed.
        correlation: of the noise of pixels 1, 2, … apart; 0 where it is white.
        slim: where the usual stripe fits a short window.
        sharp: where it is hardly wider than what a JPEG's blocks leave of it.
        jpeg: which are JPEGs; none where no profile is fitted, for it matters to that alone.
        video: which come from a video.
        cut: in which full pixels are numbers and no bounds.
        coded: which are known as JPEGs, for whatever detector.
    """

    sensor: Sensor
    of_pixels: Sensor
    correlation: Float32[np.ndarray, "most distances"]
    slim: Bool[np.ndarray, "most"]
    sharp: Bool[np.ndarray, "most"]
    jpeg: Bool[np.ndarray, "most"]
    video: Bool[np.ndarray, "most"]
    cut: Bool[np.ndarray, "most"]
    coded: Bool[np.ndarray, "most"]

    @staticmethod
    def create(batch: Batch, sensor: Sensor, fitted: bool) -> "Light":
        """The light of a batch, from its first survey.

        Args:
            batch: the photographs.
            sensor: as the survey without any correlation has it.
            fitted: whether profiles are fitted, which JPEGs disturb more than other detectors.
        """
        correlation = correlations(batch.frames, batch.dark, batch.settings, sensor, batch.peak)
        if correlation[:, 0].any():
            sensor = batch.survey(correlation)
        ln_s = np.asarray(sensor.ln_s) if fitted else np.full(len(correlation), np.inf)
        slim, sharp = ln_s < _SLIM_LN_PX, ln_s < _SHARP_LN_PX
        coded, of_pixels = _jpegs(batch, sensor, sharp, correlation, fitted), sensor
        jpeg = coded & fitted
        smooth = jpeg & sharp
        if (coded & ~np.asarray(sensor.coded)).any() or smooth.any():
            sensor = batch.survey(_or_none(correlation), smooth if smooth.any() else None, coded=coded)
        video, halved = of_video(sensor), at_half_resolution(sensor)
        # Of luma that is interpolated, and of luma whose channels are full each by itself, full pixels are bounds. In a
        # video's luma they are numbers: what its coding leaves there is more than lies between them and a bound.
        cut = jpeg & ~halved & (not batch.in_luma) | video & halved
        return Light(sensor, of_pixels, correlation, slim, sharp, jpeg, video, cut, coded)

    def with_grain(self, ln_light: Float[np.ndarray, "count lines"], seen: Bool[np.ndarray, "count lines"]) -> "Light":
        """The same with the speckle as it is along the stripe, in frames whose noise is white."""
        white = seen & (self.correlation[: len(seen), :1] == 0)
        return replace(self, sensor=with_grain(self.sensor, ln_light, white))

    def read_again(self, batch: Batch, without: Bool[np.ndarray, "count lines"]) -> "Light":
        """The same with the noise that a survey without some lines shows.

        Where fewer lines no longer show the cross-section that all of them have shown, all is as it was.
        """
        smooth = None if self.sensor.smooth is None else np.asarray(self.sensor.smooth)
        sensor = batch.survey(_or_none(self.correlation), smooth, without, self.coded)
        lost = (_beside_a_bell(self.sensor) > 0) & (_beside_a_bell(sensor) == 0)
        return replace(self, sensor=either(lost, self.sensor, sensor) if lost.any() else sensor)

    def no_bell(self) -> Bool[np.ndarray, "most"]:
        """In which frames the laser has a cross-section of its own that is far from a bell."""
        return _beside_a_bell(self.sensor) > _FAR_FROM_A_BELL

    def of_frames(self, valid: Bool[np.ndarray, "count lines"], color: str) -> Float32[np.ndarray, "count 4"]:
        """Read noise, gain, speckle contrast and saturation of the pixels of each frame; NaN without a stripe."""
        light = light_of(self.sensor, color)
        if self.sensor.smooth is not None:
            light = np.where(np.asarray(self.sensor.smooth)[:, None], light_of(self.of_pixels, color), light)
        return np.where(valid.any(axis=1, keepdims=True), light[: len(valid)], np.float32(np.nan))


def _beside_a_bell(sensor: Sensor) -> Float[np.ndarray, "most"]:
    """What the laser's own cross-section has beside a bell in each frame; 0 where none is known."""
    return np.zeros(len(sensor.read)) if sensor.shape is None else size_of(sensor.shape)


def _jpegs(
    batch: Batch,
    sensor: Sensor,
    sharp: Bool[np.ndarray, "most"],
    correlation: Float32[np.ndarray, "most distances"],
    fitted: bool,
) -> Bool[np.ndarray, "most"]:
    """Which photographs are JPEGs, of those for which it matters."""
    may_be = (correlation[:, 0] == 0) & batch.has_8_bits
    # The noise of a JPEG is white only where it has left it as it was; what it makes of full pixels counts always.
    # What it leaves of a stripe's flat top is not where the sensor is full.
    asked = has_plateau(np.asarray(sensor.full))
    if fitted:
        asked |= sharp | (np.asarray(sensor.beside) > ALIKE_BESIDE)
        asked[: batch.count] |= share_full(batch.frames, batch.settings, sensor, batch.peak) > MOSTLY_BURNT
    return are_jpegs(batch.frames, batch.settings, sensor, batch.peak, may_be, may_be & asked)


def _or_none(correlation: Float32[np.ndarray, "most distances"]) -> Float32[np.ndarray, "most distances"] | None:
    """None where all frames' noise is white, which is another program."""
    return correlation if correlation[:, 0].any() else None
