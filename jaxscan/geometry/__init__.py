"""Rotations, poses and planes: the geometry that needs no camera."""

from jaxscan.geometry.plane import dual_plane, dual_plane_of
from jaxscan.geometry.pose import Pose
from jaxscan.geometry.rotation import matrix_to_vector, vector_to_matrix

__all__ = ["Pose", "dual_plane", "dual_plane_of", "matrix_to_vector", "vector_to_matrix"]
