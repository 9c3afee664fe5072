"""The two cameras of calibration-rs, each by itself: how far from the published values, in pixels and in our σ?

What is published is not the minimum on the published corners: there residuals would sum up to 0 in u and in v, for the
sum is the derivative by the principal point. Those of the published camera and poses do not
(`mean_residual_at_published`, in its standard errors). OpenCV's least squares on these corners are where ours are, with
the same σ.
"""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.images import Board


def calibration_rs(data: Path) -> list[Metric]:
    """Both cameras against the published values and against OpenCV on the same corners."""
    content = read(data)
    metrics = []
    for side in ("left", "right"):
        observations, published = corners(content, side), focal_and_principal_of(content["intrinsics"][side])
        ours = calibrate(observations, lens="brown", plain=True)
        values, sigma = focal_and_principal(ours)
        theirs, their_sigma = opencv_focal_and_principal(observations)
        off = np.abs(values - published)
        stem = f"real.calibration_rs.{side}"
        metrics += [
            *(
                Metric(f"{stem}.{name}_from_published{unit}", float(x), unit[1:] or "px", "lower", goal, floor=0.01)
                for unit, goal, distances in (("", 4.0, off), ("_σ", 1.0, off / sigma))
                for name, x in zip(("focal_u", "focal_v", "principal_u", "principal_v"), distances, strict=True)
            ),
            Metric(
                f"{stem}.from_opencv", float((np.abs(values - theirs) / sigma).max()), "σ", "lower", 0.01, floor=0.01
            ),
            Metric(
                f"{stem}.sigma_over_opencv_minus_1", float(np.abs(sigma / their_sigma - 1).max()), "", "lower", 0.02
            ),
            Metric(f"{stem}.mean_residual_at_published", _mean_residual(content, side, observations), "σ"),
        ]
    return metrics


def read(data: Path) -> dict[str, Any]:
    """Corners, cameras and poses as they were published."""
    return json.loads((data / "calibration-rs" / "stereo_linear.json").read_text())


def corners(content: dict[str, Any], side: str) -> Observations:
    """What one camera saw.

    The size of the photographs is not published. Here it moves nothing but the start: one is taken that holds all
    corners.
    """
    board = Board.checkerboard([content["board"]["cols"], content["board"]["rows"]], content["board"]["square_size"])
    views = []
    for view in content["views"]:
        column, row, *pixel = np.array(view[side]["corners"]).T
        seen = np.full((len(board.points()), 2), np.nan)
        seen[(row * board.counts[0] + column).astype(int)] = np.stack(pixel, axis=-1)
        views.append(View(view[side]["image"], seen))
    return Observations((1024, 768), board, tuple(views))


def focal_and_principal_of(K: Float[np.ndarray, "3 3"] | list[list[float]]) -> Float[np.ndarray, "4"]:
    """f_u, f_v, u₀, v₀ of a camera matrix, pixels."""
    return np.asarray(K)[[0, 1, 0, 1], [0, 1, 2, 2]]


def focal_and_principal(result: Calibration) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4"]]:
    """f_u, f_v, u₀, v₀ and their σ, pixels."""
    names = [f"camera.{part}.{i}" for part in ("focal", "principal") for i in range(2)]
    camera = result.rig.camera
    sigma = np.array([result.covariance.sigma(name) or np.nan for name in names])
    return np.array([float(x) for x in (*camera.focal, *camera.principal)]), sigma


def opencv_focal_and_principal(observations: Observations) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4"]]:
    """The same by OpenCV, with a Brown lens."""
    _, K, *_, deviations, _, _ = cv2.calibrateCameraExtended(  # pyright: ignore[reportCallIssue]
        [observations.board.points().astype(np.float32)] * len(observations.views),
        [view.corners.astype(np.float32)[:, None] for view in observations.views],
        observations.image_size,
        None,  # pyright: ignore[reportArgumentType]
        None,  # pyright: ignore[reportArgumentType]
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-15),
    )
    return focal_and_principal_of(K), deviations.ravel()[:4]


def _mean_residual(content: dict[str, Any], side: str, observations: Observations) -> float:
    """With the published camera and poses: the mean residual over its standard error, of u or of v, the larger."""
    K, lens = (np.array(content[key][side]) for key in ("intrinsics", "distortion"))
    residuals = []
    for view, T in zip(observations.views, np.array(content["extrinsics"][side]), strict=True):
        seen, _ = cv2.projectPoints(observations.board.points(), cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, lens)
        residuals.append(seen[:, 0] - view.corners)
    all_of_them = np.concatenate(residuals)
    return float((np.abs(all_of_them.mean(axis=0)) / all_of_them.std(axis=0)).max() * np.sqrt(len(all_of_them)))
