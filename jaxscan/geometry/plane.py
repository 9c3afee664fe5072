"""Planes in dual space: the points X with ω · X = 1, for planes that miss the origin.

ω is the normal divided by the distance from the origin (1/mm). A ray x from the origin meets the plane in
X = x / (ω · x), so 1 / depth is linear in the ray, and so is the difference of two planes' inverse depths.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.geometry.pose import Pose


def dual_plane(pose: Pose) -> Float[Array, "3"]:
    """The plane z = 0 of frame b, in frame a of a pose T_a_b: ω = n / (n · t), n the third column of R (1/mm)."""
    normal = pose.matrix()[:, 2]
    return normal / (normal @ pose.translation)


def fit_plane(points: Float[Array, "points 3"], weights: Float[Array, "points"]) -> Float[Array, "3"]:
    """The dual plane nearest to weighted points, in the sense of summed squared distances (total least squares).

    Args:
        points: millimetres.
        weights: not negative; a point of weight zero is not used, but must be finite.
    """
    total = weights.sum()
    centre = (weights[:, None] * points).sum(0) / total
    centred = points - centre
    _, vectors = jnp.linalg.eigh((weights[:, None] * centred).T @ centred)
    normal = vectors[:, 0]
    return normal / (normal @ centre)
