"""What a scan is made of: sweeps, along which the same axes move; and turns, of which some close.

Where one closes, its last frames stand before its first, and its first behind its last.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Int

from jaxscan.axis_details import is_detail
from jaxscan.files.axes import StepRule
from jaxscan.files.scan import Scan
from jaxscan.reconstruction.merged_steps import step_groups
from jaxscan.rig import Motion, played_axes, run_of, runs
from jaxscan.rig.play import FAR

# The last frame of a turn is no further from the first than this multiple of the distance between frames.
_LAST_GAP: Final = 1.5


def sweeps_of(positions: Mapping[str, Int[np.ndarray, "frames"]]) -> list[slice]:
    """The sweeps of a scan: its longest pieces in which from frame to frame the same axes move.

    A scan that turns, is shifted and turns again has two. Where two pieces meet, the frame between them is of the one
    whose axes move the more often. Frames that stand still go with what is before them.

    Args:
        positions: motor steps of each axis at each frame.
    """
    frames = len(next(iter(positions.values()), ()))
    moved = np.stack([np.diff(steps) != 0 for axis, steps in positions.items() if not is_detail(axis)], axis=1)
    which = [frozenset(np.flatnonzero(row).tolist()) for row in moved]
    often = Counter(which)
    starts, last = [0], frozenset[int]()
    for gap, axes in enumerate(which):
        if not axes:
            continue
        rarer = bool(last) and often[axes] < often[last]
        if last not in (axes, frozenset()):
            # The gap behind this frame is between two sweeps, or the one before it.
            starts.append(gap + 1 if rarer else gap)
        last = frozenset() if rarer else axes
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], frames], strict=True)]


def with_runs(scan: Scan, motion: Motion) -> Scan:
    """A scan with the run of each axis that has play among its positions; the same where none has."""
    axes, rules = dict(scan.axes), dict(scan.rules)
    for axis in played_axes(motion):
        if axis in scan.axes:
            axes[run_of(axis)] = tuple(runs(np.asarray(scan.axes[axis])).tolist())
        elif axis in scan.rules:
            by = scan.rules[axis].per_frame
            rules[run_of(axis)] = StepRule(FAR * int(np.sign(by)), by)
    return replace(scan, axes=axes, rules=rules)


def two_frames(scan: Scan) -> dict[str, Int[np.ndarray, "2"]] | None:
    """Positions of the axes, motor steps, at two frames that follow one another; None where there are none."""
    if scan.rules:
        return {axis: np.asarray(rule.positions(0, 2)) for axis, rule in scan.rules.items()}
    starts = [group.start for group in step_groups(scan)]
    if len(starts) < 2:
        return None
    middle = len(starts) // 2
    return {axis: np.asarray(steps)[[starts[middle - 1], starts[middle]]] for axis, steps in scan.axes.items()}


def full_turn(motion: Motion, moving: Sequence[str]) -> int | None:
    """Motor steps of a full turn, to the nearest, where one axis alone moves and turns the object; else None."""
    turns = [part.amount(1.0) for part in motion.parts() if [part.axis] == list(moving)]
    return next((round(360 / amount) for amount, unit in turns if unit == "degrees" and amount > 0), None)


def gaps_between(steps: Int[np.ndarray, "frames"], whole: int | None) -> Int[np.ndarray, "gaps"]:
    """Motor steps from each frame to the next, full turns left out.

    There is one fewer than frames; as many where the object was turned all around: the last is from the last frame to
    the first.

    Args:
        steps: of the axis that moves.
        whole: of a full turn; None where there is none.
    """
    gaps = np.diff(steps)
    if whole is None or len(gaps) < 2:
        return gaps
    around = np.append(gaps, steps[0] - steps[-1])
    around -= whole * np.round(around / whole).astype(around.dtype)
    apart = float(np.median(around[:-1]))
    # The way that is left is that from frame to frame, or less.
    closes = 0 < np.sign(apart) * around[-1] <= _LAST_GAP * abs(apart) and around.sum() != 0
    return around if closes else around[:-1]


def with_ends(scan: Scan, motion: Motion, steps: int, equal: bool = False) -> tuple[Scan, int]:
    """A scan with its last `steps` positions repeated before it, and its first after it, if its turn closes.

    What looks at a frame's neighbours in time has the same of every frame then.

    Args:
        scan: of photographs; a video stays as it is.
        motion: of the object.
        steps: how many.
        equal: stay with the scan as it is where the last gap is not as wide as the others.

    Returns:
        The scan, and how many steps were put before it.
    """
    groups = step_groups(scan) if scan.video is None and len(scan.moving) == 1 else []
    if steps < 1 or len(groups) < steps:
        return scan, 0
    (axis,) = scan.moving
    gaps = gaps_between(np.asarray([scan.axes[axis][group.start] for group in groups]), full_turn(motion, scan.moving))
    if len(gaps) < len(groups) or (equal and len(set(gaps.tolist())) > 1):
        return scan, 0
    n = len(scan.frames)
    order = [*range(groups[-steps].start, n), *range(n), *range(groups[steps - 1].stop)]
    turns = np.repeat([-1, 0, 1], [n - groups[-steps].start, n, groups[steps - 1].stop])
    axes = {name: tuple(positions[i] for i in order) for name, positions in scan.axes.items()}
    axes[axis] = tuple(int(step + turn * gaps.sum()) for step, turn in zip(axes[axis], turns, strict=True))
    exposures = scan.exposures_s
    return replace(
        scan,
        frames=tuple(scan.frames[i] for i in order),
        axes=axes,
        backgrounds=tuple(scan.backgrounds[i] for i in order) if len(scan.backgrounds) == n else scan.backgrounds,
        exposures_s=None if exposures is None else tuple(exposures[i] for i in order),
    ), steps
