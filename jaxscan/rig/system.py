"""The system: the rig together with everything else that its calibration has to find."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.geometry import Pose
from jaxscan.precision import Leaf
from jaxscan.rig.rig import Rig


class BoardWarp(eqx.Module):
    """How far a printed board bulges out of its plane (mrcal's model).

    A board point with relative coordinates a, b in 0 … 1 along columns and rows stands at
    z = 4 · x · a (1 − a) + 4 · y · b (1 − b).

    Attributes:
        x: bulge along the columns, mm.
        y: bulge along the rows, mm.
    """

    x: Leaf
    y: Leaf

    def height(self, relative: Float[Array, "2"]) -> Float[Array, ""]:
        """Z at relative board coordinates (mm)."""
        bulge = 4 * relative * (1 - relative)
        return jnp.stack([self.x, self.y]) @ bulge


def warp_names(warp: BoardWarp | None) -> tuple[str, ...]:
    """The names of a warp's leaves, in their order; none without one."""
    return () if warp is None else ("warp.x", "warp.y")


class System(eqx.Module):
    """What the joint solve refines, all of it.

    Attributes:
        rig: camera, lasers, stage: shared by all photographs.
        boards: T_cam_board of each view, stacked (views, 3).
        stages: T_cam_board of each sequence on stage or turntable with both at motor step 0, stacked (sequences, 3).
        warp: the board's shape, or None for a flat one.
    """

    rig: Rig
    boards: Pose
    stages: Pose
    warp: BoardWarp | None = None

    def stage_board(self, sequence: int, steps: Leaf, turns: Leaf | None = None) -> Pose:
        """T_cam_board of a sequence: turned by the turntable's step count, if any, then moved by n · per_step."""
        board = Pose(self.stages.rotation[sequence], self.stages.translation[sequence])
        if turns is not None and self.rig.turntable is not None:
            board = self.rig.turntable.turned(turns) @ board
        moved = jnp.zeros(3) if self.rig.stage is None else self.rig.stage.displacement(steps)
        return Pose(board.rotation, board.translation + moved)
