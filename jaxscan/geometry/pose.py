"""Rigid motions, named T_a_b: they take coordinates in frame b to coordinates in frame a.

One class for one motion and for a stack of them, for NumPy's arrays and for JAX's. What is given as NumPy's is computed
by NumPy, in the precision of the arrays; where an array is JAX's, JAX computes. Stacks broadcast, as in `matmul`.
"""

from typing import Any, Generic

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.rotation import A, matrix_to_vector, namespace, vector_to_matrix


class Pose(eqx.Module, Generic[A]):
    """A rigid motion x ↦ R(rotation) x + translation.

    Attributes:
        rotation: rotation vector, radians. A stack of poses has leading axes here and in `translation`.
        translation: millimetres.
    """

    rotation: Float[A, "*stack 3"]
    translation: Float[A, "*stack 3"]

    @staticmethod
    def identity() -> "Pose[np.ndarray]":
        """What leaves every point where it is."""
        return Pose(np.zeros(3), np.zeros(3))

    @staticmethod
    def shift(translation: Float[A, "*stack 3"]) -> "Pose[A]":
        """A translation (mm). Its rotation is NumPy's zeros, so that whoever looks need not turn (`only_shifts`)."""
        still: Any = np.zeros(translation.shape, translation.dtype)
        return Pose(still, translation)

    @property
    def only_shifts(self) -> bool:
        """Whether it is known to turn nothing, also where it is traced by JAX."""
        return isinstance(self.rotation, np.ndarray) and not self.rotation.any()

    @staticmethod
    def about(
        rotation: Float[A, "*stack 3"], centre: Float[A, "*#stack 3"], shift: Float[A, "*#stack 3"] | float = 0.0
    ) -> "Pose[A]":
        """A turn about a place, and a shift (mm): x ↦ R (x − centre) + centre + shift."""
        xp = namespace(rotation, centre, shift)
        rotation, centre, shift = (xp.broadcast_to(xp.asarray(x), rotation.shape) for x in (rotation, centre, shift))
        return Pose(rotation, centre + shift - (vector_to_matrix(rotation) @ centre[..., None])[..., 0])

    @staticmethod
    def from_matrix(R: Float[A, "*stack 3 3"], translation: Float[A, "*stack 3"]) -> "Pose[A]":
        """The pose of a rotation matrix and a translation (mm)."""
        return Pose(matrix_to_vector(R), translation)

    @staticmethod
    def from_vector(vector: Float[A, "*stack 6"]) -> "Pose[A]":
        """The inverse of `as_vector`."""
        return Pose(vector[..., :3], vector[..., 3:])

    def as_vector(self) -> Float[A, "*stack 6"]:
        """Rotation vector, then translation: the order of a pose's parameters everywhere."""
        return namespace(self.rotation, self.translation).concatenate([self.rotation, self.translation], axis=-1)

    def matrix(self) -> Float[A, "*stack 3 3"]:
        """The rotation matrix, its columns the axes of frame b in frame a."""
        return vector_to_matrix(self.rotation)

    def apply(self, points: Float[A, "*points 3"]) -> Float[A, "*moved 3"]:
        """Points of frame b in frame a (mm).

        Args:
            points: one point (3,), which every pose of a stack moves; or (…, points, 3), whose axes before the last
                two go with the stack's. So one pose moves any array of points, and a stack of n poses moves
                (n, points, 3) or, each of them, the same (points, 3); one point for each is (n, 1, 3).
        """
        xp = namespace(self.rotation, self.translation, points)
        w, t, points = (xp.asarray(x) for x in (self.rotation, self.translation, points))
        moved = points @ vector_to_matrix(w).swapaxes(-1, -2)
        return moved + xp.broadcast_to(t if points.ndim == 1 else t[..., None, :], moved.shape)

    def inverse(self) -> "Pose[A]":
        """T_b_a."""
        turned = self.translation[..., None, :] @ vector_to_matrix(self.rotation)
        return Pose(-self.rotation, -turned[..., 0, :])

    def __matmul__(self, other: "Pose[A]") -> "Pose[A]":
        """T_a_b @ T_b_c = T_a_c."""
        parts = (self.rotation, self.translation, other.rotation, other.translation)
        xp = namespace(*parts)
        w, t, other_w, other_t = (xp.asarray(x) for x in parts)
        R = vector_to_matrix(w)
        turned = (R @ other_t[..., None])[..., 0]
        return Pose(matrix_to_vector(R @ vector_to_matrix(other_w)), turned + xp.broadcast_to(t, turned.shape))
