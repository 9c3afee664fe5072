"""Frames of one motor step merged: what a scan with several exposures of each step gives to the detector."""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from jaxscan.errors import InputError, error_context
from jaxscan.files.scan import Scan
from jaxscan.images.decode import Image
from jaxscan.images.exposures import merge_exposures
from jaxscan.reconstruction.frames import Frames


def step_groups(scan: Scan) -> list[range]:
    """Which frames of a scan are of one step and are to be merged: runs of frames with equal positions of all axes.

    A scan without `exposures_s` merges nothing: each of its frames is a group by itself.

    Raises:
        InputError: the axes come back to positions after others, or one background stands for several exposures.
    """
    positions = scan.positions
    if scan.exposures_s is None:
        return [range(i, i + 1) for i in range(len(positions))]
    starts = [0, *(i + 1 for i, (now, then) in enumerate(pairwise(positions)) if now != then)][: len(positions)]
    groups = [range(*ends) for ends in pairwise([*starts, len(positions)])]
    seen: dict[tuple[int, ...], int] = {}
    for group in groups:
        place = positions[group.start]
        if place in seen:
            step = ", ".join(map(str, place))
            raise InputError(
                f"{scan.path}: [scan] steps: step {step} of frame {seen[place]} comes again at frame {group.start}, "
                "after others: with exposures_s list the frames of a step one after another"
            )
        seen[place] = group.start
    if len(scan.backgrounds) == 1 and any(len(group) > 1 for group in groups):
        raise InputError(
            f"{scan.path}: [scan] background: one photograph for frames of several exposures: take one for each frame, "
            "exposed as long as it"
        )
    return groups


def merged_steps(scan: Scan, batches: Iterable[Frames], size: int) -> Iterator[Frames]:
    """One photograph for each step, `size` at a time whatever the size of the batches that come in.

    Args:
        scan: what the frames belong to.
        batches: its frames in their order.
        size: how many merged photographs come at a time; the last time fewer.

    Raises:
        InputError: as `step_groups` and `merge_exposures`.
    """
    groups, exposures = deque(step_groups(scan)), scan.exposures_s
    if exposures is None or all(len(group) == 1 for group in groups):
        yield from batches
        return
    positions = scan.positions
    waiting: list[tuple[Image, Image | None]] = []
    merged: list[tuple[np.ndarray, np.ndarray | None, tuple[int, ...]]] = []
    for batch in batches:
        waiting += ((image, dark) for image, dark, _ in batch.kept())
        while groups and len(waiting) >= len(groups[0]):
            group = groups.popleft()
            lit, dark = zip(*waiting[: len(group)], strict=True)
            waiting = waiting[len(group) :]
            with error_context(f"{scan.path}: [scan] frames {group.start} to {group.stop - 1}"):
                image, ground = merge_exposures(
                    np.stack(lit), exposures[group.start : group.stop], None if dark[0] is None else np.stack(dark)
                )
            merged.append((np.asarray(image), None if ground is None else np.asarray(ground), positions[group.start]))
            if len(merged) == size:
                yield _batch(merged)
                merged = []
    if merged:
        yield _batch(merged)


def _batch(merged: list[tuple[np.ndarray, np.ndarray | None, tuple[int, ...]]]) -> Frames:
    images, grounds, positions = zip(*merged, strict=True)
    darks = None if grounds[0] is None else np.stack(grounds)
    return Frames(np.stack(images), darks, np.asarray(positions, np.int64))
