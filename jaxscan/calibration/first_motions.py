"""The motion of each axis in closed form: from the board's pose in each photograph, found by itself."""

from itertools import pairwise

import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration import initial
from jaxscan.calibration.blocks import reference_positions
from jaxscan.calibration.hand import moves_by_poses
from jaxscan.calibration.observations import BoardSequence, Observations
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, as_jax, as_numpy
from jaxscan.rig import MOTIONS, AxisMotion, Motion, motion_of


def no_motion_yet(observations: Observations) -> Motion:
    """Axes that do not move, in the order and of the kinds that `first_motions` will find."""
    axes = tuple(MOTIONS[each[0].kind].at_rest(axis) for axis, each in _by_axis(observations).items())
    return motion_of((*axes, *moves_by_poses(observations)))


def first_motions(
    observations: Observations, stood: Pose[np.ndarray]
) -> tuple[Motion, tuple[Float[Array, "_ 6"], ...]]:
    """The motion, and the pose of each sequence's board at its positions of reference, one group of them or none.

    Args:
        observations: with the sequences.
        stood: the board's pose in each photograph, the views' first.

    Raises:
        InputError: a board that did not move as its axis does.
    """
    if not observations.sequences:
        return as_float64(no_motion_yet(observations)), ()
    middle = observations.board.points().mean(axis=0)
    ends = np.cumsum([len(observations.views), *(len(sequence.views) for sequence in observations.sequences)])
    photographs = [Pose(stood.rotation[start:end], stood.translation[start:end]) for start, end in pairwise(ends)]
    parts: list[AxisMotion] = []
    for axis, sequences in _by_axis(observations).items():
        # What is known of the axes that carry this one is taken back; the longest travel determines it best.
        longest = max(sequences, key=lambda sequence: float(np.ptp(sequence.steps)))
        poses = photographs[observations.sequences.index(longest)]
        carried = motion_of(tuple(parts)).pose(longest.positions)
        found = _fitted(longest, axis, carried.inverse() @ poses, middle)
        parts.append(as_numpy(found))
    motion = motion_of(tuple(parts))
    first = [
        _at_reference(motion, sequence, poses, middle)
        for sequence, poses in zip(observations.sequences, photographs, strict=True)
    ]
    return as_float64(motion), (as_jax(np.stack(first)),)


def _by_axis(observations: Observations) -> dict[str, list[BoardSequence]]:
    """The sequences of each axis, from the room to the object: lines carry turns."""
    axes: dict[str, list[BoardSequence]] = {}
    for sequence in sorted(observations.sequences, key=lambda each: list(MOTIONS).index(each.kind)):
        axes.setdefault(sequence.axis, []).append(sequence)
    return axes


def _fitted(sequence: BoardSequence, axis: str, poses: Pose[np.ndarray], middle: Float[np.ndarray, "3"]) -> AxisMotion:
    try:
        return MOTIONS[sequence.kind].fitted(axis, sequence.steps, poses, middle)
    except InputError as error:
        raise InputError(f"{sequence.views[0].name} … {sequence.views[-1].name}: {error}") from error


def _at_reference(
    motion: Motion, sequence: BoardSequence, poses: Pose[np.ndarray], middle: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "6"]:
    """Where a sequence's board stands at its reference: what most photographs say."""
    there = motion.pose(reference_positions(sequence)) @ motion.pose(sequence.positions).inverse() @ poses
    rotation = initial.usual_rotation(there.rotation)
    place = np.median(there.apply(middle[None])[:, 0], axis=0)
    return np.concatenate([rotation, place - Pose(rotation, np.zeros(3)).apply(middle)])
