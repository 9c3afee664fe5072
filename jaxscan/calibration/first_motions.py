"""Stage and turntable in closed form: from the board's pose in each photograph, found by itself."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration import initial
from jaxscan.calibration.blocks import reference_turn, view_blocks
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.observations import Observations, StageSequence
from jaxscan.errors import InputError
from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix
from jaxscan.geometry.turn import axis_point, rate_of_turn
from jaxscan.rig import Camera, Stage, Turntable

# Less is not told from the noise of single poses, radians.
_LEAST_TURN = 0.05


def first_motions(
    observations: Observations, camera: Camera
) -> tuple[Stage | None, Turntable | None, Float[Array, "sequences 6"]]:
    """Stage, turntable, and the pose of each sequence's board at its step counts of reference.

    Raises:
        InputError: a board on the turntable that did not turn.
    """
    middle = observations.board.points().mean(axis=0)
    slopes, tables, first = [], [], []
    # Those on the stage first: a turned board is placed in the frame of the stage's step 0.
    each = sorted(enumerate(observations.stages), key=lambda pair: pair[1].turns is not None)
    for _, sequence in each:
        blocks = view_blocks(replace(observations, views=sequence.views))
        vectors = np.asarray(first_poses(camera, blocks))[: len(sequence.views)]
        if sequence.turns is None:
            start, per_step = initial.stage_line(np.asarray(sequence.steps, float), vectors[:, 3:])
            slopes.append(per_step)
            first.append(np.concatenate([initial.usual_rotation(vectors[:, :3]), start]))
        else:
            travel = np.median(slopes, axis=0) if slopes else np.zeros(3)
            moved = sequence.steps[:, None] * np.concatenate([np.zeros(3), travel])
            table, pose = _turned(sequence, vectors - moved, middle)
            tables.append(table)
            first.append(pose)
    order = np.argsort([i for i, _ in each])
    stage = Stage.create(np.median(slopes, axis=0)) if slopes else None
    return stage, tables[0] if tables else None, jnp.asarray(np.stack(first)[order])


def _turned(
    sequence: StageSequence, vectors: Float[np.ndarray, "images 6"], middle: Float[np.ndarray, "3"]
) -> tuple[Turntable, Float[np.ndarray, "6"]]:
    """The turntable of one sequence, and its board at the reference.

    Args:
        sequence: of a turned board.
        vectors: its pose in each photograph, in the frame of the stage's step 0.
        middle: of the board, mm.
    """
    steps = np.asarray(sequence.turns, float) - reference_turn(sequence)
    poses = Pose.from_vector(vectors)
    w = rate_of_turn(poses.matrix(), steps)
    if (turn := float(np.linalg.norm(w) * np.ptp(steps))) < _LEAST_TURN:
        raise InputError(
            f"{sequence.views[0].name} … {sequence.views[-1].name}: the board on the turntable turned by "
            f"{np.degrees(turn):.1f}° in {np.ptp(steps):g} steps: turn it by 30° or more in all, and check the step "
            "counts under [turntable] and that the board turns with the table"
        )
    centre, arm = axis_point(poses.apply(middle), steps, w)
    back = vector_to_matrix(-steps[:, None] * w)
    rotation = initial.usual_rotation(matrix_to_vector(back @ poses.matrix()))
    start = centre + arm - vector_to_matrix(rotation) @ middle
    return Turntable.create(w, centre), np.concatenate([rotation, start])
