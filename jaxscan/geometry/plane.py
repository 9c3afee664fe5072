"""Planes in dual space: the points X with ω · X = 1, for planes that miss the origin.

ω is the normal divided by the distance from the origin (1/mm). A ray x from the origin meets the plane in
X = x / (ω · x), so 1 / depth is linear in the ray, and so is the difference of two planes' inverse depths.
"""

from jaxtyping import Float

from jaxscan.geometry.pose import Pose
from jaxscan.geometry.rotation import A


def dual_plane(pose: Pose[A]) -> Float[A, "3"]:
    """The plane z = 0 of frame b, in frame a of a pose T_a_b: ω = n / (n · t), n the third column of R (1/mm)."""
    normal = pose.matrix()[:, 2]
    return normal / (normal @ pose.translation)
