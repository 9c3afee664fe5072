"""The colours of a scan's points, from photographs without the laser or from beside its stripe.

Of a frame with a photograph of the same step with the laser off, each point's colour is in the very pixel in which the
stripe was seen: nothing can be in front of it there, and nothing has moved (`own_colours`).

Other scans have the light of the room in the same photographs as the stripe. A point is clear of the stripe some frames
before and after its own. Its pixel there is where the rig's motion has carried it, and it counts where it is on the
photograph, clear of the stripe, and nothing that the scan has seen is before it. Its colour is the median of the
nearest such photographs, up to three before and three after, so that what changes evenly with the motion, like the
shade on a turning object, is that of the point's own step. Photographs that disagree with it are outvoted, and a point
has no colour where no two agree: what was never scanned can hide it without being known (`neighbour_colours`).

How far the light of the stripe reaches is measured in the photographs (`jaxscan.reconstruction.stripe_reach`). Points
that no neighbour shows are looked for all over the scan: near the axis of a turn the stripe leaves them only slowly.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt, UInt8

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.images.sampled import levels_at
from jaxscan.precision import as_numpy
from jaxscan.reconstruction.merged_steps import step_groups
from jaxscan.reconstruction.photographs import Photographs, levels
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.rig import Rig


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
        colours[i] = levels(np.where(np.isfinite(position[i])[:, None], levels_at(photograph, pixels), np.nan))
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
    found = Photographs(rig.camera, image, photographs, columns=scan.laser.columns, stripe=not dark)
    colours = found.near(points)
    missing = [~some.any(axis=1) for some in colours]
    if any(some.any() for some in missing):
        far = found.far([these[some] for these, some in zip(points, missing, strict=True)])
        for some, colour, more in zip(missing, colours, far, strict=True):
            colour[some] = more
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


def _one_of_each_step(scan: Scan) -> list[Path]:
    """The photographs to take colours from: of several exposures of a step the longest one that all steps have."""
    some = scan.backgrounds if len(scan.backgrounds) == len(scan.frames) else scan.frames
    groups, times = step_groups(scan), scan.exposures_s
    if times is None:
        return list(some)
    common = set.intersection(*({times[i] for i in group} for group in groups))
    longest = max(common, default=None)
    return [some[next((i for i in group if times[i] == longest), group.start)] for group in groups]
