"""The system: the rig together with everything else that its calibration has to find."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.geometry import Pose
from jaxscan.precision import Leaf
from jaxscan.rig.rig import Rig, parameter_names


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

    def height(self, relative: Float[Array, "*points 2"]) -> Float[Array, "*points"]:
        """Z at relative board coordinates (mm)."""
        bulge = 4 * relative * (1 - relative)
        return bulge @ jnp.stack([self.x, self.y])


class System(eqx.Module):
    """What the joint solve refines, all of it.

    Attributes:
        rig: camera, lights, motion: shared by all photographs.
        poses: for each group of blocks (blocks, 6), rotation vector and translation: T_cam_board of each view; then of
            each board that was moved by an axis, at its positions of reference; then of each gauge, T_object_gauge.
        warp: the board's shape, shared as well, or None for a flat one.
    """

    rig: Rig
    poses: tuple[Float[Array, "_ _"], ...]
    warp: BoardWarp | None = None

    @property
    def shared(self) -> tuple[Rig, BoardWarp | None]:
        """What all residuals depend on, in the order of its leaves."""
        return self.rig, self.warp

    @property
    def boards(self) -> Pose:
        """T_cam_board of each view, stacked (views, 3)."""
        return Pose.from_vector(self.poses[0])

    @property
    def moved(self) -> Pose:
        """T_cam_board of each board that an axis moved, stacked; of a finished calibration with all axes at 0."""
        return Pose.from_vector(self.poses[1] if len(self.poses) > 1 else jnp.zeros((0, 6)))

    def shared_names(self) -> list[str]:
        """The names of what is shared, in the order of its leaves."""
        return [*parameter_names(self.rig), *(("warp.x", "warp.y") if self.warp is not None else ())]

    def values(self) -> list[float]:
        """Of what is shared."""
        return [float(leaf) for leaf in jax.tree.leaves(self.shared)]
