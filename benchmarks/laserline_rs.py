"""Camera and light plane in one solve by calibration-rs (`pip install vision-calibration`), where that is installed.

What it is given is what the careful OpenCV pipeline has: corners of `cornerSubPix`, centres of gravity, and, since it
has no stage, PnP and a least-squares line for that. Its lens is Brown's with k1, k2, p1 and p2; fewer cannot be asked.
"""

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.found import Found
from benchmarks.opencv_pipeline import found, stripe_rows
from benchmarks.sequential import stage_by_line
from jaxscan.calibration import Observations
from jaxscan.files.scan import Scan
from jaxscan.images import read_image

INSTALLED: Final = find_spec("vision_calibration") is not None
_ITERATIONS = 200


def laserline_rs(observations: Observations, folder: Path, scans: Sequence[Scan]) -> Found:
    """Calibrate, then reconstruct."""
    vc = import_module("vision_calibration")
    points, views, lit = observations.board.points(), [], []
    for view in observations.views:
        rows, used = stripe_rows(read_image(folder / view.name), careful=True), view.used()
        lit.append(np.isfinite(rows))
        stripe = np.column_stack([np.flatnonzero(lit[-1]), rows[lit[-1]]])
        corners = vc.Observation(points[used].tolist(), view.corners[used].tolist(), [1.0] * int(used.sum()))
        views.append(vc.LaserlineView(corners, stripe.tolist(), [1.0] * len(stripe)))
    result = vc.run_laserline_device(
        vc.LaserlineDataset(views),
        vc.LaserlineDeviceCalibrationConfig(
            # By itself it holds the first board where its start put it, and measures a stripe point's distance from the
            # line where plane and board meet: one that it can't measure so costs 1e4 whatever the estimate, and some
            # ninety a session end its solve before the minimum.
            optimize=vc.LaserlineDeviceOptimizeConfig(fix_poses=[], laser_residual_type="PointToPlane"),
            solver=vc.SolverConfig(max_iters=_ITERATIONS),
        ),
    )
    estimate = result.estimate.params
    camera, lens, plane = estimate.intrinsics, estimate.distortion, estimate.plane
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    k = np.array([lens.k1, lens.k2, lens.p1, lens.p2])
    omega = -np.asarray(plane.normal_xyz) / plane.distance
    return found(observations.image_size, K, k, omega, stage_by_line(observations, K, k), scans, np.stack(lit))
