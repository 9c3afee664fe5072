"""Rigid motions of points in memory: R, t with p ↦ R p + t, plain arrays."""

import numpy as np
from jaxtyping import Float

Motion = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]


def moved(points: Float[np.ndarray, "points 3"], T: Motion) -> Float[np.ndarray, "points 3"]:
    """Points carried by a motion."""
    return points @ T[0].T + T[1]


def inverse(T: Motion) -> Motion:
    """The motion back."""
    return T[0].T, -T[0].T @ T[1]


def after(T: Motion, other: Motion) -> Motion:
    """The other motion first, then T."""
    return T[0] @ other[0], T[0] @ other[1] + T[1]
