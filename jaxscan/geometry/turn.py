"""The axis about which a body turned by known step counts, from where it stood: a start for a fit.

At step n the body's points stand at exp(n w) (x − c) + c, w the rotation vector of one step and c a point of the axis.
"""

import numpy as np
from jaxtyping import Float

from jaxscan.geometry.rotation import matrix_to_vector, vector_to_matrix

_ROUNDS = 20


def rate_of_turn(
    rotations: Float[np.ndarray, "places 3 3"], steps: Float[np.ndarray, "places"]
) -> Float[np.ndarray, "3"]:
    """w, by the median over neighbouring places: one that is wrong has no say. Radians for each step.

    Args:
        rotations: of the body, at two or more places; less than half a turn from one to the next.
        steps: step count of each; two at least differ.
    """
    order = np.argsort(steps, kind="stable")
    R, apart = rotations[order], np.diff(steps[order])
    turned = apart > 0
    rates = matrix_to_vector(R[1:] @ R[:-1].swapaxes(-1, -2))[turned] / apart[turned, None]
    return np.quantile(rates, 0.5, axis=0, weights=apart[turned], method="inverted_cdf")


def axis_point(
    points: Float[np.ndarray, "places 3"], steps: Float[np.ndarray, "places"], w: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """c, the point of the axis that is nearest to the origin, and where the body's point stood from it at step 0.

    points = exp(n w) a + c is linear in a and in c at right angles to w. Least absolute distances, by weights.
    """
    E = vector_to_matrix(steps[:, None] * w)
    across = np.linalg.svd(w[None])[2][1:]
    A = np.concatenate([E, np.broadcast_to(across.T, (len(E), 3, 2))], axis=2)
    weights, found = np.ones(len(E)), np.zeros(5)
    for _ in range(_ROUNDS):
        found = np.linalg.lstsq((A * weights[:, None, None]).reshape(-1, 5), (points * weights[:, None]).ravel())[0]
        distance = np.linalg.norm(points - A @ found, axis=1)
        # Below the usual distance squares count: there is no outlier to be held down.
        weights = np.maximum(distance, np.median(distance) + np.finfo(float).tiny) ** -0.5
        weights /= weights.max()
    return across.T @ found[3:], found[:3]
