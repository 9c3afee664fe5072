"""The colours of a scan's points, from photographs without the laser or from beside its stripe.

Of a frame with a photograph of the same step with the laser off, each point's colour is in the very pixel in which the
stripe was seen: nothing can be in front of it there, and nothing has moved (`own_colours`).

Other scans have the light of the room in the same photographs as the stripe. A point is clear of the stripe some frames
before and after its own. Its pixel there is where the rig's motion has carried it, and it counts where it is on the
photograph, clear of the stripe, and nothing that the scan has seen is before it. Its colour is the median of the
nearest such photographs, up to three before and three after, so that what changes evenly with the motion, like the
shade on a turning object, is that of the point's own step. Photographs that disagree with it are outvoted, and a point
has no colour where no two agree: what was never scanned can hide it without being known (`neighbour_colours`).
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt, UInt8

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.geometry import Pose
from jaxscan.images.decode import NUMBERS_PER_LEVEL, Image, read_image
from jaxscan.images.sampled import sampled
from jaxscan.precision import as_numpy
from jaxscan.reconstruction.merged_steps import step_groups
from jaxscan.reconstruction.point_colours import STRIPE_PX, in_stripe, least_depths, visible
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.rig import Camera, Rig

# Photographs whose colours are taken on either side of a point's own.
_EACH_SIDE: Final = 3
# Photographs that are looked at on either side.
_LOOKED_AT: Final = 10
# In how many strides of the photographs the stripe is left behind.
_STRIDES: Final = 3
# Columns for which the stripe counts as this wide.
_COLUMNS: Final = 640
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


def object_stands(rig: Rig, scan: Scan) -> bool:
    """Whether the object stands still before the camera all along a scan, so that one photograph shows it for all."""
    axes = {axis: np.asarray(rule.positions(0, 2)) for axis, rule in scan.rules.items()} or scan.axes
    if not axes or not len(next(iter(axes.values()))):
        return True
    pose = as_numpy(rig.pose({axis: np.asarray(steps, np.float64) for axis, steps in axes.items()}))
    parts = (pose.rotation, pose.translation)
    return all(bool((part.reshape(-1, 3) == part.reshape(-1, 3)[0]).all()) for part in parts)


def own_colours(
    photographs: UInt[np.ndarray, "photographs rows columns *rgb"],
    position: Float[np.ndarray, "frames lines"],
    *,
    columns: bool,
) -> UInt8[np.ndarray, "frames lines 3"]:
    """The colour in the pixel of each stripe point, of the photograph of its step with the laser off.

    Args:
        photographs: one for each frame, or one for all of them; 8 or 16 bits, grey or RGB.
        position: of the stripe, the row of each column, or the column of each row; NaN for none.
        columns: whether it has a row for each column.

    Returns:
        8 bits; 0, 0, 0 for none.
    """
    frames, lines = position.shape
    line = np.arange(lines, dtype=np.float64)
    colours = np.zeros((frames, lines, 3), np.uint8)
    for i in range(frames):
        pixels = np.stack([line, position[i]] if columns else [position[i], line], axis=-1)
        photograph = photographs[min(i, len(photographs) - 1)]
        found = np.where(np.isfinite(position[i])[:, None], sampled(photograph, pixels), np.nan)
        colours[i] = _levels(found, photograph.dtype)
    return colours


def neighbour_colours(rig: Rig, scan: Scan, image: RangeImage) -> UInt8[np.ndarray, "frames columns 3"]:
    """The colours of a whole scan's points, from photographs in which they are clear of the stripe.

    Args:
        rig: as the scan was reconstructed with.
        scan: its photographs are read once more, each once; those with the laser off where there is one for each.
        image: all its points.

    Returns:
        8 bits; 0, 0, 0 for a point that no other photograph shows.

    Raises:
        InputError: as `colours_at`.
    """
    found = colours_at(rig, scan, image, [image.points[i, image.valid[i]] for i in range(len(image.valid))])
    colours = np.zeros((*image.valid.shape, 3), np.uint8)
    colours[image.valid] = np.concatenate(found)
    return colours


def colours_at(
    rig: Rig, scan: Scan, image: RangeImage, points: Sequence[Float[np.ndarray, "_ 3"]]
) -> list[UInt8[np.ndarray, "_ 3"]]:
    """The colours of any points of a scan's surface, from photographs in which they are clear of the stripe.

    Args:
        rig: as the scan was reconstructed with.
        scan: as `neighbour_colours` has it.
        image: all its points, which hide what is behind them.
        points: for each frame those whose colour is wanted as that frame's light has it, object frame, mm.

    Returns:
        8 bits, for each frame; 0, 0, 0 for a point that no photograph shows.

    Raises:
        InputError: the scan is a video, has other frames than the range image, or a photograph cannot be read.
    """
    check_photographs(scan)
    photographs = _one_of_each_step(scan)
    if len(photographs) != len(image.valid):
        raise InputError(
            f"{scan.path}: has {len(photographs)} steps, and the range image {len(image.valid)}: give the scan that "
            "it was reconstructed from"
        )
    dark = len(scan.backgrounds) == len(scan.frames) > 1
    back = image.from_camera().inverse()
    poses = [Pose(back.rotation[i], back.translation[i]) for i in range(len(image.valid))]
    project = _Projector(rig.camera)
    guard = 0.0 if dark else STRIPE_PX * max(1.0, rig.camera.image_size[0] / _COLUMNS)
    stride, around = _neighbours(project, poses, image, guard)
    occluders = _occluders(image, project, poses)
    kept: dict[int, _Shown] = {}
    colours = [np.zeros((len(these), 3), np.uint8) for these in points]
    for i, wanted_points in enumerate(points):
        if not len(wanted_points):
            continue
        sides = [around(i, side) for side in (-1, 1)]
        wanted = [*sides[0], *sides[1], *([i] if dark and i % stride == 0 else [])]
        for j in [j for j in kept if j < min(wanted, default=0)]:
            del kept[j]
        samples = []
        for these in [*sides, [i] if i in wanted else []]:
            taken = np.zeros(len(wanted_points), int)
            for j in these:
                if (taken >= _EACH_SIDE).all():
                    break
                if j not in kept:
                    kept[j] = _Shown(read_image(photographs[j]), project, poses[j], occluders)
                pixels, depths = project(poses[j], wanted_points)
                clear = visible(kept[j].nearest, pixels, depths) & (taken < _EACH_SIDE)
                if guard:
                    clear &= ~in_stripe(pixels, image.pixels[j], guard, columns=scan.laser.columns)
                samples.append(np.where(clear[:, None], sampled(kept[j].photograph, pixels), np.nan))
                taken += clear
        if samples:
            dtype = next(iter(kept.values())).photograph.dtype
            colours[i] = _levels(_agreed(np.stack(samples), dtype), dtype)
    return colours


def check_photographs(scan: Scan) -> None:
    """Refuse a scan from whose frames no colours can be taken.

    Raises:
        InputError: it is a video.
    """
    if scan.video is not None:
        raise InputError(
            f"{scan.path}: colours from other frames are taken of single photographs, and {scan.video.name} is a "
            "video: save its frames as photographs, or leave --colour frames out"
        )


class _Projector:
    """Pixels and ranges of points that the motion has carried."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def __call__(
        self, pose: Pose, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points"]]:
        seen = pose.apply(np.asarray(points, np.float64))
        ranges = self._camera.chart.range_of(seen)
        ranges = np.where(ranges > 0, ranges, np.nan)
        # Few sizes, so that little is compiled.
        filled = np.ones((max(_LEAST_SIZE, 1 << (len(seen) - 1).bit_length()), 3), np.float32)
        filled[: len(seen)] = seen
        return np.asarray(_pixels(self._camera, jnp.asarray(filled)), np.float64)[: len(seen)], ranges


@jax.jit
def _pixels(camera: Camera, points: Float[Array, "points 3"]) -> Float[Array, "points 2"]:
    return jax.vmap(camera.project)(points)


class _Shown:
    """A photograph, and how near what it shows is."""

    def __init__(
        self, photograph: Image, project: _Projector, pose: Pose, occluders: Float[np.ndarray, "occluders 3"]
    ) -> None:
        self.photograph = photograph
        self.nearest = least_depths(*project(pose, occluders), photograph.shape[:2])


def _neighbours(
    project: _Projector, poses: list[Pose], image: RangeImage, guard: float
) -> tuple[int, Callable[[int, int], list[int]]]:
    """Which photographs a frame's points are looked for in: the stride between these, and they in their order."""
    count = len(poses)
    shift = [
        np.nanmedian(np.linalg.norm(np.subtract(*(project(poses[j], image.points[i])[0] for j in (i, i + 1))), axis=1))
        for i in range(0, count - 1, max(1, count // 8))
        if image.valid[i].any()
    ]
    apart = float(np.median(shift)) if shift else 0.0
    first = min(int(np.ceil(guard / apart)) if apart > 0 and guard else 1, count)
    stride = max(1, first // _STRIDES)
    closed = len(image.gaps()) == count

    def around(i: int, side: int) -> list[int]:
        start = i + side * max(1, first // 2)
        onto = -(-start // stride) * stride if side > 0 else start // stride * stride
        these = [onto + side * stride * k for k in range(_LOOKED_AT)]
        return [j % count for j in these if closed or 0 <= j < count]

    return stride, around


def _occluders(image: RangeImage, project: _Projector, poses: list[Pose]) -> Float[np.ndarray, "occluders 3"]:
    """The points of a scan, and enough between neighbouring frames that each is within a pixel of the next."""
    every = max(1, int(np.ceil(image.valid.sum() / _OCCLUDERS)))
    P = image.points[:, ::every]
    apart = np.linalg.norm(P[1:] - P[:-1], axis=2)
    usual = np.nanmedian(apart) if np.isfinite(apart).any() else 0.0
    parts = [P[image.valid[:, ::every]]]
    with np.errstate(invalid="ignore"):
        joined = apart < 3 * usual
    if joined.any():
        i = int(np.flatnonzero(joined.any(axis=1))[joined.any(axis=1).sum() // 2])
        there = [project(poses[i], each)[0] for each in (P[i], P[i + 1])]
        px = float(np.nanmedian(np.linalg.norm(there[1] - there[0], axis=1)[joined[i]]))
        between = min(int(px), _FILLED)
        for t in np.arange(1, between + 1) / (between + 1):
            parts.append(((1 - t) * P[:-1] + t * P[1:])[joined].astype(P.dtype))
    return np.concatenate(parts)


def _one_of_each_step(scan: Scan) -> list[Path]:
    """The photographs to take colours from: of several exposures of a step the longest one that all steps have."""
    some = scan.backgrounds if len(scan.backgrounds) == len(scan.frames) else scan.frames
    groups, times = step_groups(scan), scan.exposures_s
    if times is None:
        return list(some)
    common = set.intersection(*({times[i] for i in group} for group in groups))
    longest = max(common, default=None)
    return [some[next((i for i in group if times[i] == longest), group.start)] for group in groups]


def _agreed(samples: Float[np.ndarray, "samples points 3"], dtype: np.dtype) -> Float[np.ndarray, "points 3"]:
    """The median, NaN where not two of them are alike, or no more than half of them are like it."""
    taken = np.isfinite(samples[..., 0])
    none = ~np.any(taken, axis=0)
    middle = np.nanmedian(np.where(none[..., None], 0.0, samples), axis=0)
    part, levels = _ALIKE
    least = levels * (NUMBERS_PER_LEVEL if dtype == np.uint16 else 1)
    with np.errstate(invalid="ignore"):
        alike = (np.abs(samples - middle) <= np.maximum(part * middle, least)).all(axis=-1).sum(axis=0)
    agreed = ~none & (alike >= _LEAST_ALIKE) & (2 * alike > taken.sum(axis=0))
    return np.where(agreed[:, None], middle, np.nan)


def _levels(numbers: Float[np.ndarray, "points 3"], dtype: np.dtype) -> UInt8[np.ndarray, "points 3"]:
    """8 bits, 0, 0, 0 for NaN."""
    levels = numbers / (NUMBERS_PER_LEVEL if dtype == np.uint16 else 1)
    known = np.clip(np.round(np.nan_to_num(levels)), _LEAST, 255)
    return np.where(np.isnan(levels), 0, known).astype(np.uint8)
