"""What the photographs of a scan show of its points, where these are clear of the stripe.

The rig's motion says in which pixel of a photograph a point is. The photograph counts where the point is on it, clear
of the stripe, and nothing that the scan has seen is before it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxscan.geometry import Pose
from jaxscan.images.decode import Image, read_image
from jaxscan.images.sampled import levels_at
from jaxscan.kept_programs import compiled
from jaxscan.reconstruction.point_colours import in_stripe, least_depths, visible
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.reconstruction.stripe_reach import stripe_reach
from jaxscan.rig import Camera

# Photographs whose colours are taken on either side of a point's own.
_EACH_SIDE: Final = 3
# Photographs that are looked at on either side.
_LOOKED_AT: Final = 10
# In how many strides of the photographs the stripe is left behind.
_STRIDES: Final = 3
# Photographs, all over the scan, in which points are looked for that none of those shows.
_ALL_OVER: Final = 64
# Points that are looked for there together.
_AT_ONCE: Final = 1 << 20
# Points that may hide others, at most, of scans that have more.
_OCCLUDERS: Final = 400_000
# Frames between which the surface is filled in, by at most this number of points.
_FILLED: Final = 12
# Colours are alike that differ by less than this part, or these grey levels; this number must be.
_ALIKE: Final = (0.15, 12.0)
_LEAST_ALIKE: Final = 2
# Points that are projected together, at least.
_LEAST_SIZE: Final = 256
# 0, 0, 0 is kept for a point without a colour.
_LEAST: Final = 1


class Photographs:
    """The photographs of a scan, with where its motion carries the points in each.

    Args:
        camera: that took them.
        image: the scan's points, which hide what is behind them.
        photographs: one for each of its frames.
        columns: whether the stripe has a row for each column.
        stripe: whether it is in them; False for photographs with the laser off.

    Raises:
        InputError: a photograph cannot be read.
    """

    def __init__(
        self, camera: Camera, image: RangeImage, photographs: Sequence[Path], *, columns: bool, stripe: bool
    ) -> None:
        back = image.from_camera().inverse()
        self._count = len(photographs)
        self._poses = [Pose(back.rotation[i], back.translation[i]) for i in range(self._count)]
        self._camera, self._image, self._columns, self._stripe = camera, image, columns, stripe
        self._photographs = photographs
        self._closed = len(image.gaps()) == self._count
        self._guard = stripe_reach(photographs, image.pixels, columns=columns) if stripe else 0.0
        self._occluders = self._points_between()
        self._shown: dict[int, tuple[Image, Float[np.ndarray, "rows columns"]]] = {}

    def near(self, points: Sequence[Float[np.ndarray, "_ 3"]]) -> list[UInt8[np.ndarray, "_ 3"]]:
        """The colours of points from the photographs next to their own, so that light and shade are those of its step.

        Args:
            points: for each frame, object frame, mm.

        Returns:
            8 bits; 0, 0, 0 for a point that none of them shows.
        """
        first = self._steps_to_leave_the_stripe()
        stride = max(1, first // _STRIDES)
        colours = [np.zeros((len(these), 3), np.uint8) for these in points]
        for i, these in enumerate(points):
            if not len(these):
                continue
            sides = [self._around(i, side * max(1, first // 2), side * stride) for side in (-1, 1)]
            # With the laser off a point's own photograph shows it too.
            own = [] if self._stripe or i % stride else [i]
            for j in [j for j in self._shown if j < min([*sides[0], *sides[1], *own], default=0)]:
                del self._shown[j]
            samples = []
            for side in [*sides, own]:
                taken = np.zeros(len(these), int)
                for j in side:
                    if (taken >= _EACH_SIDE).all():
                        break
                    colour, clear = self._seen(j, these)
                    clear &= taken < _EACH_SIDE
                    samples.append(np.where(clear[:, None], colour, np.nan))
                    taken += clear
            if samples:
                colours[i] = _agreed(np.stack(samples))
        self._shown.clear()
        return colours

    def far(self, points: Sequence[Float[np.ndarray, "_ 3"]]) -> list[UInt8[np.ndarray, "_ 3"]]:
        """The colours of points from photographs all over the scan, those nearest to their own first.

        Near the axis of a turn the stripe leaves a point only slowly, and what hides a point from the photographs next
        to its own may have moved away in others.

        Args:
            points: as `near` has them.

        Returns:
            As `near`.
        """
        frame = np.repeat(np.arange(self._count), [len(these) for these in points])
        P = np.concatenate(points)
        colours = np.zeros((len(P), 3), np.uint8)
        for start in range(0, len(P), _AT_ONCE):
            some = slice(start, start + _AT_ONCE)
            colours[some] = self._all_over(P[some], frame[some])
        return np.split(colours, np.cumsum([len(these) for these in points])[:-1])

    def _all_over(
        self, points: Float[np.ndarray, "points 3"], frame: Int[np.ndarray, "points"]
    ) -> UInt8[np.ndarray, "points 3"]:
        nearest = np.full((2, _EACH_SIDE, len(points)), np.inf, np.float32)
        samples = np.full((2, _EACH_SIDE, len(points), 3), np.nan, np.float32)
        for j in np.unique(np.linspace(0, self._count - 1, _ALL_OVER).astype(int)):
            colour, clear = self._seen(int(j), points)
            self._shown.clear()
            away = self._steps_away(frame, int(j))
            for side, there in enumerate((clear & (away < 0), clear & (away >= 0))):
                farthest = nearest[side].argmax(axis=0)
                which = np.flatnonzero(there & (np.abs(away) < nearest[side].max(axis=0)))
                nearest[side, farthest[which], which] = np.abs(away)[which]
                samples[side, farthest[which], which] = colour[which]
        return _agreed(samples.reshape(-1, len(points), 3))

    def _steps_away(self, frame: Int[np.ndarray, "points"], j: int) -> Int[np.ndarray, "points"]:
        away = j - frame
        return (away + self._count // 2) % self._count - self._count // 2 if self._closed else away

    def _seen(
        self, j: int, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Bool[np.ndarray, "points"]]:
        """Colours of photograph j where points are in it, grey levels of 8 bits; and whether it shows them."""
        if j not in self._shown:
            picture = read_image(self._photographs[j])
            self._shown[j] = picture, least_depths(*self._project(j, self._occluders), picture.shape[:2])
        picture, nearest = self._shown[j]
        pixels, depths = self._project(j, points)
        clear = visible(nearest, pixels, depths)
        if self._guard:
            clear &= ~in_stripe(pixels, self._image.pixels[j], self._guard, columns=self._columns)
        return levels_at(picture, pixels), clear

    def _project(
        self, j: int, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points"]]:
        """Pixels and ranges of points as the motion has carried them in frame j."""
        seen = self._poses[j].apply(np.asarray(points, np.float64))
        ranges = self._camera.chart.range_of(seen)
        ranges = np.where(ranges > 0, ranges, np.nan)
        # Few sizes, so that little is compiled.
        filled = np.ones((max(_LEAST_SIZE, 1 << (len(seen) - 1).bit_length()), 3), np.float32)
        filled[: len(seen)] = seen
        return np.asarray(_pixels(self._camera, jnp.asarray(filled)), np.float64)[: len(seen)], ranges

    def _around(self, i: int, start: int, stride: int) -> list[int]:
        """Photographs on one side of frame i in their order: the same few for neighbouring frames."""
        onto = -(-(i + start) // stride) * stride
        these = [onto + stride * k for k in range(_LOOKED_AT)]
        return [j % self._count for j in these if self._closed or 0 <= j < self._count]

    def _steps_to_leave_the_stripe(self) -> int:
        """After how many steps the scan's points are clear of the stripe, in the median."""
        image, count = self._image, self._count
        shift = [
            np.nanmedian(
                np.linalg.norm(np.subtract(*(self._project(j, image.points[i])[0] for j in (i, i + 1))), axis=1)
            )
            for i in range(0, count - 1, max(1, count // 8))
            if image.valid[i].any()
        ]
        apart = float(np.median(shift)) if shift else 0.0
        return min(int(np.ceil(self._guard / apart)) if apart > 0 and self._guard else 1, count)

    def _points_between(self) -> Float[np.ndarray, "occluders 3"]:
        """The points of the scan, and enough between neighbouring frames that each is within a pixel of the next."""
        image = self._image
        every = max(1, int(np.ceil(image.valid.sum() / _OCCLUDERS)))
        P = image.points[:, ::every]
        apart = np.linalg.norm(P[1:] - P[:-1], axis=2)
        usual = np.nanmedian(apart) if np.isfinite(apart).any() else 0.0
        parts = [P[image.valid[:, ::every]]]
        with np.errstate(invalid="ignore"):
            joined = apart < 3 * usual
        if joined.any():
            i = int(np.flatnonzero(joined.any(axis=1))[joined.any(axis=1).sum() // 2])
            there = [self._project(i, each)[0] for each in (P[i], P[i + 1])]
            px = float(np.nanmedian(np.linalg.norm(there[1] - there[0], axis=1)[joined[i]]))
            between = min(int(px), _FILLED)
            for t in np.arange(1, between + 1) / (between + 1):
                parts.append(((1 - t) * P[:-1] + t * P[1:])[joined].astype(P.dtype))
        return np.concatenate(parts)


def levels(numbers: Float[np.ndarray, "*points 3"]) -> UInt8[np.ndarray, "*points 3"]:
    """8 bits of numbers in grey levels; 0, 0, 0 for NaN, and for nothing else."""
    known = np.clip(np.round(np.nan_to_num(numbers)), _LEAST, 255)
    return np.where(np.isnan(numbers), 0, known).astype(np.uint8)


def _agreed(samples: Float[np.ndarray, "samples points 3"]) -> UInt8[np.ndarray, "points 3"]:
    """The median; 0, 0, 0 where not two of them are alike, or no more than half of them are like it."""
    taken = np.isfinite(samples[..., 0])
    none = ~np.any(taken, axis=0)
    middle = np.nanmedian(np.where(none[..., None], 0.0, samples), axis=0)
    part, least = _ALIKE
    with np.errstate(invalid="ignore"):
        alike = (np.abs(samples - middle) <= np.maximum(part * middle, least)).all(axis=-1).sum(axis=0)
    agreed = ~none & (alike >= _LEAST_ALIKE) & (2 * alike > taken.sum(axis=0))
    return levels(np.where(agreed[:, None], middle, np.nan))


@compiled()
def _pixels(camera: Camera, points: Float[Array, "points 3"]) -> Float[Array, "points 2"]:
    return jax.vmap(camera.project)(points)
