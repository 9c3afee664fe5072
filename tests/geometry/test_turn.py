"""An axis from where a body stood, one place of which is wrong."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxscan.geometry.turn import axis_point, rate_of_turn

W, C, ARM = np.array([0.0002, -0.0008, -0.0018]), np.array([20.0, -150.0, 60.0]), np.array([30.0, 8.0, -4.0])


def stood(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    turns = Rotation.from_rotvec(steps[:, None] * W)
    return (turns * Rotation.from_rotvec([0.3, 2.0, -0.4])).as_matrix(), turns.apply(ARM) + C


def test_exact_places_give_the_axis():
    for steps in (np.array([0.0, 300.0]), np.array([500.0, -100.0, 1300.0, 0.0, 0.0, 3000.0, 2100.0])):
        R, X = stood(steps)
        np.testing.assert_allclose(rate_of_turn(R, steps), W, atol=1e-12)
        centre, arm = axis_point(X, steps, W)
        nearest = C - (C @ W) / (W @ W) * W
        np.testing.assert_allclose(centre, nearest, atol=1e-6)
        np.testing.assert_allclose(arm + centre, ARM + C, atol=1e-6)


def test_one_wrong_place_has_no_say():
    steps = 250.0 * np.arange(9)
    R, X = stood(steps)
    R[4], X[4] = Rotation.from_rotvec([1.0, 0.2, 0.1]).as_matrix() @ R[4], X[4] + [40.0, -20.0, 5.0]
    w = rate_of_turn(R, steps)
    np.testing.assert_allclose(w, W, atol=1e-9)
    centre, _ = axis_point(X, steps, w)
    assert np.linalg.norm(np.cross(centre - C, W)) / np.linalg.norm(W) < 0.5
