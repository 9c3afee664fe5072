"""Files as each program writes them, from its documentation, all of one camera: what they say is in `CAMERA`."""

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

SIZE = (640, 480)
PINHOLE = (532.795, 532.919, 342.458, 233.901)
TERMS = (-0.281, 0.0252, 0.00122, -0.000135, 0.1634)
K = [PINHOLE[0], 0.0, PINHOLE[2], 0.0, PINHOLE[1], PINHOLE[3], 0.0, 0.0, 1.0]

OPENCV = """%YAML:1.0
---
calibration_time: "Tue 03 Mar 2020 10:00:00"
nframes: 13
image_width: 640
image_height: 480
board_width: 9
flags: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.32795e+02, 0., 3.42458e+02, 0., 5.32919e+02, 2.33901e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.81e-01, 2.52e-02, 1.22e-03, -1.35e-04, 1.634e-01 ]
avg_reprojection_error: 1.95e-01
"""

OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width>
<image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>532.795 0. 342.458 0. 532.919 233.901 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix">
  <rows>5</rows><cols>1</cols><dt>d</dt>
  <data>-0.281 0.0252 0.00122 -1.35e-04 0.1634</data></Distortion_Coefficients>
</opencv_storage>
"""

ROS_K = "[532.795, 0, 342.458, 0, 532.919, 233.901, 0, 0, 1]"
# yaml-cpp writes whole numbers without a point, and exponents without one too.
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [532.795, 0, 342.458, 0, 532.919, 233.901, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.281, 0.0252, 0.00122, -135e-6, 0.1634]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [520.1, 0, 341.2, 0, 0, 522.8, 233.3, 0, 0, 0, 1, 0]
"""

ROS_MESSAGE = """header:
  seq: 7
  stamp: {secs: 1, nsecs: 2}
  frame_id: camera
height: 480
width: 640
distortion_model: plumb_bob
D: [-0.281, 0.0252, 0.00122, -0.000135, 0.1634]
K: [532.795, 0.0, 342.458, 0.0, 532.919, 233.901, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [532.795, 0.0, 342.458, 0.0, 0.0, 532.919, 233.901, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
"""

# Without k3, which Kalibr has not.
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.281, 0.0252, 0.00122, -0.000135]
  distortion_model: radtan
  intrinsics: [532.795, 532.919, 342.458, 233.901]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""

MRCAL = """# generated on 2023-01-01 with   mrcal-calibrate-cameras
{
    'lensmodel':  'LENSMODEL_OPENCV5',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 532.795, 532.919, 342.458, 233.901, -0.281, 0.0252, 0.00122, -0.000135, 0.1634,],

    # extrinsics are rt_fromref
    'extrinsics': [ 0, 0, 0, -0, -0, -0,],

    'imagersize': [ 640, 480,],
}
"""

TEXTS = {
    "opencv.yml": OPENCV,
    "opencv.xml": OPENCV_XML,
    "ros.yaml": ROS,
    "message.yaml": ROS_MESSAGE,
    "kalibr.yaml": KALIBR,
    "mrcal.cameramodel": MRCAL,
}


def board(n_x: int = 8, n_y: int = 5, square: float = 25.0) -> np.ndarray:
    """The points of a board as the toolbox counts them: x fastest, y from the top down to 0."""
    x, y = np.meshgrid(np.arange(n_x + 1.0), np.arange(n_y, -1.0, -1.0))
    return square * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def bouguet(path: Path, **changes: Any) -> Path:
    """`Calib_Results.mat` as the toolbox saves it, two photographs and one that was left out; None takes a key out."""
    rng = np.random.default_rng(3)
    variables: dict[str, Any] = {
        "fc": np.array([PINHOLE[:2]]).T,
        "cc": np.array([PINHOLE[2:]]).T,
        "alpha_c": 0.0,
        "kc": np.array([TERMS]).T,
        "KK": np.reshape(K, (3, 3)),
        "fc_error": np.array([[1.5], [1.8]]),
        "cc_error": np.array([[0.9], [0.6]]),
        "kc_error": np.array([[0.03], [0.06], [0.003], [0.003], [0.0]]),
        "est_dist": np.ones((5, 1)),
        "nx": 640.0,
        "ny": 480.0,
        "n_ima": 3.0,
        "calib_name": "left",
        "small_calib_image": 0.0,
        "map": np.zeros((256, 3)),
    }
    for i in (1, 3):
        variables |= {f"X_{i}": board(), f"x_{i}": rng.uniform(0, 400, (2, 54))}
        variables |= {f"omc_{i}": rng.normal(size=(3, 1)), f"Tc_{i}": rng.uniform(300, 400, (3, 1))}
        variables |= {f"omc_error_{i}": rng.random((3, 1)), f"Tc_error_{i}": rng.random((3, 1))}
    left_out = np.full((3, 1), np.nan)
    variables |= {"X_2": left_out, "x_2": left_out[:2], "omc_2": left_out, "Tc_2": left_out, "n_sq_x_2": np.nan}
    variables = {name: value for name, value in (variables | changes).items() if value is not None}
    scipy.io.savemat(path, variables)
    return path
