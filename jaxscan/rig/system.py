"""The system: the rig together with everything else that its calibration has to find."""

from typing import Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.geometry import Pose
from jaxscan.rig.board_shape import BoardShape
from jaxscan.rig.rig import Rig, parameter_names

# The names of the terms of a board's shape, in the order of its leaves.
SHAPE_TERMS: Final = ("shape.bulge.0", "shape.bulge.1", "shape.twist.0", "shape.edge.0", "shape.edge.1")
# What the names of `System.earlier` begin with.
EARLIER: Final = "earlier."


class System(eqx.Module):
    """All parameters that the joint solve refines.

    Attributes:
        rig: camera, lights, motion: shared by all photographs.
        poses: for each group of blocks (blocks, 6), rotation vector and translation: T_cam_board of each view; then of
            each board that was moved by an axis, at its positions of reference; then of each gauge, T_object_gauge.
            For a board with its own bends, two bulges follow its pose, mm.
        shape: the board's, shared as well, or None for a flat one.
        earlier: by how much the numbers of the rig were larger in photographs taken before something was changed, leaf
            by leaf; None where there is one rig only.
    """

    rig: Rig
    poses: tuple[Float[Array, "_ _"], ...]
    shape: BoardShape | None = None
    earlier: Rig | None = None

    @property
    def shared(self) -> tuple[Rig, BoardShape | None, Rig | None]:
        """What all residuals depend on, in the order of its leaves."""
        return self.rig, self.shape, self.earlier

    def where(self, before: Bool[Array | np.ndarray, ""] | None) -> "System":
        """As a block of photographs sees it that was taken before the change, or after it; itself where the rig is one.

        Args:
            before: whether it was taken before; None where the rig is one.
        """
        if self.earlier is None or before is None:
            return self
        rig = jax.tree.map(lambda now, more: now + jnp.where(before, more, 0.0), self.rig, self.earlier)
        return System(rig, self.poses, self.shape)

    @property
    def boards(self) -> Pose:
        """T_cam_board of each view, stacked (views, 3)."""
        return Pose.from_vector(self.poses[0][:, :6])

    @property
    def moved(self) -> Pose:
        """T_cam_board of each board that an axis moved, stacked; of a finished calibration with all axes at 0."""
        return Pose.from_vector(self.poses[1][:, :6] if len(self.poses) > 1 else jnp.zeros((0, 6)))

    def bends(self, group: int) -> Float[Array | np.ndarray, "blocks 2"] | None:
        """The bulges (mm) of each board of a group in addition to the common shape; None where it has none."""
        return self.poses[group][:, 6:] if self.poses[group].shape[1] > 6 else None

    def shared_names(self) -> list[str]:
        """The names of what is shared, in the order of its leaves."""
        names = parameter_names(self.rig)
        earlier = [] if self.earlier is None else [f"{EARLIER}{name}" for name in names]
        return [*names, *SHAPE_TERMS[: len(jax.tree.leaves(self.shape))], *earlier]

    def values(self) -> list[float]:
        """The values of the shared parameters, in the order of `shared_names`."""
        return [float(leaf) for leaf in jax.tree.leaves(self.shared)]
