"""Rigid transformations, named T_a_b: they take coordinates in frame b to coordinates in frame a."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.geometry.rotation import matrix_to_vector, vector_to_matrix


class Pose(eqx.Module):
    """A rigid transformation x ↦ R(rotation) x + translation.

    Attributes:
        rotation: rotation vector, radians. A stack of poses has leading axes here and in `translation`.
        translation: millimetres.
    """

    rotation: Float[Array | np.ndarray, "*stack 3"]
    translation: Float[Array | np.ndarray, "*stack 3"]

    @staticmethod
    def from_matrix(R: Float[Array, "3 3"], translation: Float[Array, "3"]) -> "Pose":
        """The pose of a rotation matrix and a translation (mm)."""
        return Pose(matrix_to_vector(R), translation)

    @staticmethod
    def from_vector(vector: Float[Array, "*stack 6"]) -> "Pose":
        """The inverse of `as_vector`."""
        return Pose(vector[..., :3], vector[..., 3:])

    def as_vector(self) -> Float[Array, "*stack 6"]:
        """Rotation vector, then translation: the order of a pose's parameters everywhere."""
        return jnp.concatenate([self.rotation, self.translation], axis=-1)

    def matrix(self) -> Float[Array, "3 3"]:
        """The rotation matrix of a single pose."""
        return vector_to_matrix(jnp.asarray(self.rotation))

    def apply(self, point: Float[Array | np.ndarray, "3"]) -> Float[Array, "3"]:
        """A point of frame b in frame a (mm)."""
        return self.matrix() @ point + self.translation

    def inverse(self) -> "Pose":
        """T_b_a."""
        return Pose(-self.rotation, -(self.matrix().T @ self.translation))

    def __matmul__(self, other: "Pose") -> "Pose":
        """T_a_b @ T_b_c = T_a_c."""
        return Pose.from_matrix(self.matrix() @ other.matrix(), self.apply(other.translation))
