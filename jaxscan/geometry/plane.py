"""Planes in dual space: the points X with ω · X = 1, for planes that miss the origin.

ω is the normal divided by the distance from the origin (1/mm). A ray x from the origin meets the plane in
X = x / (ω · x), so 1 / depth is linear in the ray, and so is the difference of two planes' inverse depths.
"""

from jaxtyping import Float

from jaxscan.geometry.pose import Pose
from jaxscan.geometry.rotation import A, namespace


def dual_plane(pose: Pose[A]) -> Float[A, "3"]:
    """The plane z = 0 of frame b, in frame a of a pose T_a_b (1/mm)."""
    return dual_plane_of(pose.matrix(), pose.translation)


def dual_plane_of(R: Float[A, "*stack 3 3"], t: Float[A, "*stack 3"]) -> Float[A, "*stack 3"]:
    """The same of a rotation matrix and a translation (mm): ω = n / (n · t), n the third column of R."""
    normal = R[..., 2]
    return normal / namespace(R, t).vecdot(normal, t)[..., None]
