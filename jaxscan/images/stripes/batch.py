"""Photographs that are looked at together, and where something stands out in each of their lines."""

from dataclasses import dataclass
from typing import Final

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.detectors import Choice
from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.candidates import candidates, choose
from jaxscan.images.stripes.coarse import choose_peaks, coarse_peaks
from jaxscan.images.stripes.surroundings import ambient_levels, sample, surroundings
from jaxscan.images.stripes.survey import survey
from jaxscan.images.stripes.windows import Sensor

# Frames that are looked at together.
FRAMES_AT_ONCE: Final = 16
# Half windows, px: the wide one holds stripes up to some 60 px wide.
SHORT, NARROW, WIDE = 8, 12, 40
# What lies beside a stripe is this far away, px. The laser's channel rises by this part of a full number at the least,
# and the others by less than this part of that.
_BESIDE_PX, _LEAST_RISE, _ALONE = 8, 0.05, 0.4
# How far away the sides of a stripe are, in its standard deviations; how many narrow peaks of a line are looked at.
_SIDES, _NARROW_PEAKS = 2.5, 2


@dataclass(frozen=True)
class Batch:
    """No more photographs than `FRAMES_AT_ONCE`, of which the first ones count: those that `peak` is of.

    Attributes:
        frames: as they were given.
        dark: the same with the laser off, one for all or one for each, or None.
        settings: the laser's colour, and which way lines run.
        images: the photographs on the device.
        background: likewise `dark`.
        ambient: c of the response.
        peaks: of each block of each line, packed.
        peak: the row (or column) at which the stripe is looked for.
        stands: by how much that stands out.
        interpolated: whether the other channels are means of neighbouring pixels, as those of a mosaic's native
            pixels are.
    """

    frames: np.ndarray | Array
    dark: np.ndarray | Array | None
    settings: StripeSettings
    images: Array
    background: Array | None
    ambient: Int[np.ndarray, "frames"]
    peaks: Array
    peak: Int[np.ndarray, "count lines"]
    stands: Int[np.ndarray, "count lines"]
    interpolated: bool = False

    @staticmethod
    def create(
        frames: np.ndarray | Array,
        dark: np.ndarray | Array | None,
        settings: StripeSettings,
        choice: Choice,
        count: int,
        interpolated: bool = False,
    ) -> "Batch":
        """The first `count` photographs, with what stands out in them."""
        color, columns = settings.color, settings.columns
        length = _length(frames, columns)
        ambient = ambient_levels(frames, dark, color)
        # Without a copy where the array is aligned to 64 bytes; nothing of it is kept.
        images, background = jax.device_put((frames, dark))
        peaks = coarse_peaks(images, background, ambient, color, columns)
        peak, stands = (np.array(each)[:count] for each in choose_peaks(peaks, length, columns))
        if choice not in ("likeliest", "strongest"):
            rows, strength = (np.asarray(each)[:count] for each in candidates(peaks, length, columns))
            peak = choose(rows, strength, choice)
        return Batch(frames, dark, settings, images, background, ambient, peaks, peak, stands, interpolated)

    @property
    def count(self) -> int:
        """How many of the photographs count."""
        return len(self.peak)

    @property
    def length(self) -> int:
        """Rows (or columns) of a line."""
        return _length(self.frames, self.settings.columns)

    @property
    def has_8_bits(self) -> bool:
        """Whether pixels have 8 bits, as those of JPEGs have."""
        return self.frames.dtype == np.uint8

    @property
    def in_luma(self) -> bool:
        """Whether photographs in colour are measured by luma."""
        return self.settings.color == "grey" and self.frames.ndim > self.peak.ndim + 1

    def half(self, wanted: int) -> int:
        """Half a window's length, as far as a line has room for it."""
        return min(wanted, (self.length - 1) // 2)

    def survey(
        self,
        correlation: Float[np.ndarray, "most distances"] | None = None,
        smooth: Bool[np.ndarray, "most"] | None = None,
        without: Bool[np.ndarray, "count lines"] | None = None,
        coded: Bool[np.ndarray, "most"] | None = None,
    ) -> Sensor:
        """What each photograph shows of its sensor, in `FRAMES_AT_ONCE` entries.

        Args:
            correlation: of each frame's noise, as `survey` has it.
            smooth: in which frames windows are smoothed; None where in none.
            without: lines that are not asked; None where all may be.
            coded: which are known to be JPEGs; None where none is.
        """
        stands = self.stands
        if without is not None:
            stands = np.where(without, np.iinfo(stands.dtype).min, stands)
        return survey(
            self.images,
            self.background,
            self.ambient,
            self.peak,
            stands,
            self.settings.color,
            self.settings.columns,
            self.half(NARROW),
            FRAMES_AT_ONCE,
            correlation,
            smooth,
            coded,
            self.interpolated,
        )

    def peaks_of_colour(self) -> np.ndarray | None:
        """The peaks where neutral light cancels however bright it is; None where there are no colours.

        That is without c, and so does a stripe that is burnt out white but for its flanks.
        """
        if self.settings.color == "grey":
            return None
        without = np.full_like(self.ambient, np.iinfo(np.int16 if self.has_8_bits else np.int32).max)
        return np.asarray(
            coarse_peaks(self.images, self.background, without, self.settings.color, self.settings.columns)
        )

    def rises_alone(
        self, frame: int, line: Int[np.ndarray, "some"], row: Int[np.ndarray, "some"]
    ) -> Bool[np.ndarray, "some"]:
        """Whether at some places the laser's channel rises above what lies beside them, and the others do not.

        So it does on a surface of another colour, whose own light outdoes the laser's in the sum of channels; what
        shines white lifts them all.
        """
        levels = np.asarray(self.frames[frame])

        def at(by: int) -> Float[np.ndarray, "some rgb"]:
            there = np.clip(row + by, 0, self.length - 1)
            return levels[(there, line) if self.settings.columns else (line, there)].astype(np.float32)

        rise = at(0) - np.maximum(at(-_BESIDE_PX), at(_BESIDE_PX))
        laser, *others = (rise[:, channel] for channel in CHANNELS[self.settings.color])
        return (laser > _LEAST_RISE * np.iinfo(self.frames.dtype).max) & (np.maximum(*others) < _ALONE * laser)

    def narrow_peaks(
        self, frame: int, line: Int[np.ndarray, "some"], sensor: Sensor
    ) -> tuple[Int[np.ndarray, "peaks"], Int[np.ndarray, "peaks"]]:
        """The lines and rows at which something as narrow as the stripe stands out most from both of its sides.

        The edge of a painted surface outshines a stripe beside it, but only on one side of it. The response is that
        with weights in which most of the photograph's texture cancels. None where the channels do not show it.

        Args:
            frame: which photograph.
            line: some of its lines.
            sensor: what it shows of its colours.
        """
        assert sensor.colours is not None
        colours = jax.tree.map(lambda x: np.asarray(x)[frame], sensor.colours)
        if not (colours.by_line and colours.aligned):
            return line[:0], line[:0]
        m, n = (np.float32(weight) for weight in colours.weights(1.0))
        levels = np.asarray(self.frames[frame])
        levels = (levels[:, line] if self.settings.columns else np.swapaxes(levels[line], 0, 1)).astype(np.float32)
        own, first, second = (levels[..., i] for i in CHANNELS[self.settings.color])
        r = 2 * own - m * first - n * second
        r = (r[:-2] + r[1:-1] + r[2:]) / 3
        apart = int(np.ceil(_SIDES * np.exp(np.asarray(sensor.ln_s)[frame]))) + 2
        sides = np.pad(r, ((apart, apart), (0, 0)), mode="edge")
        stands = r - np.maximum(sides[: len(r)], sides[2 * apart :])
        rows, lines = [], []
        for _ in range(_NARROW_PEAKS):
            row = stands.argmax(axis=0)
            rows.append(row + 1)
            lines.append(line)
            near = np.clip(row + np.arange(-apart, apart + 1)[:, None], 0, len(r) - 1)
            np.put_along_axis(stands, near, -np.inf, axis=0)
        return np.concatenate(lines), np.concatenate(rows)

    def surroundings(self, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
        """The share of each frame's full pixels, and the levels beside the stripe."""
        some = sample(self.frames)[: self.count]
        return surroundings(some, np.asarray(sensor.full)[: self.count], self.settings.color)


def _length(frames: np.ndarray | Array, columns: bool) -> int:
    return frames.shape[1 if columns else 2]
