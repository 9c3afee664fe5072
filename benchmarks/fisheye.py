"""A fisheye at 90° to its axis and beyond: round trip, OpenCV's minimum, kernel, predicted against actual scatter.

Boards are held all around a camera of 640 × 480 that sees 92° above and below its axis and 122° to its sides: their
corners are up to 115° off it. The stripe is that of a flat sheet above the camera, which goes on behind it. What
`cv2.fisheye` makes of corners is compared where it can see them, within 75° of the axis.
"""

import cv2
import jax
import numpy as np
from jaxtyping import Float

from benchmarks.drawn import Noise, project, redrawn
from benchmarks.drawn_bent import Height, flat
from benchmarks.metric import Metric
from benchmarks.montecarlo import DRAWS_QUICK, Session, compared
from benchmarks.montecarlo_fisheye import fisheye_session
from benchmarks.throughput import kernel_beside_the_plain
from jaxscan.calibration import Observations, View, calibrate
from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from jaxscan.rig.projection import off_axis, pixel_rays, project_points
from jaxscan.simulation import rig_2003

_DRAWS = 900
_VIEWS = 16
_FOCAL, _PRINCIPAL, _ANGULAR = (151.0, 149.0), (316.3, 242.8), (0.012, -0.006, 0.0012, -0.00008)
_OMEGA = np.array([0.002, -0.027, 0.004])
_PER_STEP = 0.001 * np.array([0.92, 0.13, -0.39])
_NEAREST, _FARTHEST, _BORDER_PX = 110.0, 190.0, 4.0
# The middle of a board is this far off the axis at most, degrees; of those that OpenCV sees, its corners.
_MIDDLES_DEG, _OPENCV_DEG = 95.0, 75.0
_OPENCV_VIEWS = 14
# Boards to the sides, their least angle from the axis (degrees), and how far up or down they are at most (radians).
_TO_THE_SIDES, _SIDES_DEG, _ABOUT_SIDE = 7, 55.0, 0.25
# Pixels that see the sheet 49 to 104° off the axis, and points up to 113° off it.
_PIXELS = np.array([[u, v] for u in (60.0, 140.0, 316.0, 500.0, 580.0) for v in (60.0, 120.0)])
_BEYOND = np.array([[x, y, z] for x in (-150.0, 150.0) for y in (-50.0, 50.0) for z in (-60.0, 20.0)])
_ROUND_TRIP_DEG = np.array([0.0, 1e-6, 30.0, 60.0, 89.999, 90.0, 90.001, 100.0, 110.0, 120.0])


def measure(quick: bool) -> list[Metric]:
    """All of it."""
    with float64():
        camera = Camera.create(rig_2003.IMAGE_SIZE, _FOCAL, _PRINCIPAL, "fisheye", _ANGULAR)
        sheet = LightPlane.create(_OMEGA)
        rig = as_numpy(Rig(camera, (sheet,), Linear.create(_PER_STEP)))
    metrics = [*_round_trip(camera), *_minimum(camera)]
    metrics += kernel_beside_the_plain("fisheye.kernel", "a radial lens's", 0.5, quick, camera=camera, light=sheet)
    session, furthest = wide_session(rig)
    return [
        *metrics,
        Metric("fisheye.furthest_corner_deg", furthest, "deg"),
        *compared(session, DRAWS_QUICK if quick else _DRAWS, quick),
    ]


def wide_session(rig: Rig, height: Height = flat) -> tuple[Session, float]:
    """Boards all around, with the stripes, and one on a stage; and how far off the axis the furthest corner is, deg.

    Args:
        rig: the true one.
        height: the board's shape.
    """
    boards = _poses(rig.camera, _VIEWS, _MIDDLES_DEG, 180.0, sides=_TO_THE_SIDES)
    on_stage = Pose(*_facing(np.array([np.radians(62), 0.4]), 130.0, np.array([0.2, -0.3, 0.5])))
    places = {"projected_beyond_90_deg": _BEYOND}
    session = fisheye_session("fisheye", rig, boards, on_stage, _PIXELS, places, height)
    seen = np.concatenate([view.corners for view in session.exact.photographs()])
    return session, float(np.degrees(off_axis(pixel_rays(rig.camera, seen))).max())


def _round_trip(camera: Camera) -> list[Metric]:
    """Points at angles up to 120° through their pixels to their rays: the largest error, relative to the distance."""
    angle, around = (x.ravel() for x in np.meshgrid(np.radians(_ROUND_TRIP_DEG), np.radians(np.arange(0, 360, 7))))
    way = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=1)
    back = pixel_rays(camera, project_points(camera, 170.0 * way).pixels)
    return [
        Metric("fisheye.round_trip_to_120_deg", float(np.abs(back - way).max()), "rad", "lower", 1e-12, floor=1e-12)
    ]


def _minimum(camera: Camera) -> list[Metric]:
    """The same corners, seen with noise, through `cv2.fisheye.calibrate` and `calibrate --plain`."""
    poses, random = _poses(camera, _OPENCV_VIEWS, _OPENCV_DEG, _OPENCV_DEG), np.random.default_rng(90)
    board = rig_2003.BOARD.points()
    views = tuple(
        View(f"view-{i}", project(camera, board @ vector_to_matrix(rotation).T + translation))
        for i, (rotation, translation) in enumerate(zip(poses.rotation, poses.translation, strict=True))
    )
    session = redrawn(Observations(rig_2003.IMAGE_SIZE, rig_2003.BOARD, views, ()), Noise(), random)
    ours = calibrate(session, lens="fisheye", plain=True).rig.camera
    _, K, D, _, _ = cv2.fisheye.calibrate(
        list(np.tile(board[None], (len(views), 1, 1, 1)).astype(np.float64)),
        [view.corners[None].astype(np.float64) for view in session.views],
        session.image_size,
        # From its own start it ends elsewhere.
        np.array([[150.0, 0, 319.5], [0, 150.0, 239.5], [0, 0, 1]]),
        np.zeros(4),
        flags=cv2.CALIB_FIX_SKEW | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-14),
    )
    theirs = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D.ravel()])
    off = np.array([float(leaf) for leaf in jax.tree.leaves(ours)]) - theirs
    return [
        Metric(
            "fisheye.from_opencvs_minimum", float(np.abs(off[:4] / theirs[:4]).max()), "", "lower", 1e-6, floor=1e-6
        ),
        Metric("fisheye.from_opencvs_terms", float(np.abs(off[4:]).max()), "", "lower", 1e-6, floor=1e-6),
    ]


def _poses(camera: Camera, count: int, middles_deg: float, corners_deg: float, sides: int = 0) -> Pose:
    """T_cam_board of boards that face the camera more or less, stacked.

    Args:
        camera: in whose view they are.
        count: how many.
        middles_deg: how far off the axis their middles are at most.
        corners_deg: their corners.
        sides: how many of them, the first, are to the left or the right, where the stripe goes on behind the camera.
    """
    random, points = np.random.default_rng(2007), rig_2003.BOARD.points()
    size, rotations, translations = np.array(camera.image_size), [], []
    while len(rotations) < count:
        least, around = 0.0, random.uniform(0, 2 * np.pi)
        if len(rotations) < sides:
            least, around = _SIDES_DEG, np.pi * random.integers(2) + random.uniform(-_ABOUT_SIDE, _ABOUT_SIDE)
        towards = np.array([np.radians(random.uniform(least, middles_deg)), around])
        tilt = np.array([*random.uniform(-0.6, 0.6, 2), random.uniform(-np.pi, np.pi)])
        rotation, translation = _facing(towards, random.uniform(_NEAREST, _FARTHEST), tilt)
        X = points @ vector_to_matrix(rotation).T + translation
        if np.degrees(off_axis(X)).max() > corners_deg:
            continue
        seen = project(camera, X)
        if ((seen > _BORDER_PX) & (seen < size - 1 - _BORDER_PX)).all():
            rotations.append(rotation)
            translations.append(translation)
    return Pose(np.stack(rotations), np.stack(translations))


def _facing(
    towards: Float[np.ndarray, "2"], distance: float, tilt: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Rotation vector and translation of a board whose middle is at an angle from the axis, and in a way around it."""
    angle, around = towards
    turn = vector_to_matrix(angle * np.array([-np.sin(around), np.cos(around), 0.0]))
    R = turn @ vector_to_matrix(tilt)
    pose = Pose.from_matrix(R, distance * turn[:, 2] - R @ rig_2003.BOARD.points().mean(axis=0))
    return np.asarray(pose.rotation), np.asarray(pose.translation)
