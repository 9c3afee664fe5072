"""The careful sequential calibration: camera, then light plane, then stage, each with what came before held fixed.

On the same corners and stripe points as the joint solve: least squares over the corners for camera and poses, the light
plane by total least squares through the triangulated stripe points (outliers beyond 4 σ left out), each stage pose by
OpenCV's iterative PnP, the stage by a least-squares line.
"""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from benchmarks.real import corners_only
from jaxscan.calibration import Observations, calibrate
from jaxscan.calibration.first_poses import poses_of_photographs
from jaxscan.calibration.on_board import stripe_on_board, stripe_points_in_space
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import LightPlane, Linear, Rig

_OUTLIER_SIGMA = 4.0


def sequential(observations: Observations) -> Rig:
    """Camera → plane → stage."""
    first = calibrate(corners_only(observations))
    with float64():
        camera = as_float64(first.rig.camera)
        poses = poses_of_photographs(observations, first.rig.camera, np.asarray(first.system.boards.as_vector()))
        on_board, _ = stripe_on_board(observations, camera, poses)
        points, _, _ = stripe_points_in_space(on_board, camera, poses, 0)
        plane = LightPlane.create(total_least_squares(points))
        K = np.array(
            [
                [float(camera.focal[0]), 0, float(camera.principal[0])],
                [0, float(camera.focal[1]), float(camera.principal[1])],
                [0, 0, 1],
            ]
        )
        k = np.array([*(float(c) for c in jax.tree.leaves(camera.lens)), 0, 0, 0])[:4]
        per_step = stage_by_line(observations, K, k)
        return as_numpy(Rig(camera, (plane,), Linear.create(jnp.asarray(per_step))))


def stage_by_line(
    observations: Observations, K: Float[np.ndarray, "3 3"], k: Float[np.ndarray, "coefficients"]
) -> Float[np.ndarray, "3"]:
    """The stage's motion for one step, mm: a least-squares line through the board's translations."""
    steps, translations = [], []
    for stage in (sequence for sequence in observations.sequences if sequence.kind == "linear"):
        for count, view in zip(stage.steps, stage.views, strict=True):
            used = view.used()
            _, _, t = cv2.solvePnP(observations.board.points()[used], view.corners[used], K, k)
            steps.append(count)
            translations.append(np.ravel(t))
    A = np.stack([np.ones(len(steps)), np.asarray(steps)], axis=1)
    return np.linalg.lstsq(A, np.stack(translations), rcond=None)[0][1]


def total_least_squares(points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "3"]:
    """The dual plane nearest to the points, without those beyond 4 σ."""
    kept = np.ones(len(points), bool)
    omega = np.zeros(3)
    for _ in range(10):
        centre = points[kept].mean(axis=0)
        normal = np.linalg.svd(points[kept] - centre, full_matrices=False)[2][2]
        omega = normal / (normal @ centre)
        distance = (points - centre) @ normal
        kept = np.abs(distance) <= _OUTLIER_SIGMA * distance[kept].std()
    return omega
