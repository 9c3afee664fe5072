"""Given poses: where the hand is against its σ and against a closed form, scans of photographs at poses with errors.

The sessions are drawn: corners of 8 boards in the hand and of others at given poses, with noise of 0.1 px; the robot's
errors are normal, or go on from pose to pose. The textbook's closed form (F. C. Park and B. J. Martin 1994) gets the
same board poses.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.calibration.observations import HandSettings
from jaxscan.calibration.observe import observe
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.geometry import Pose, matrix_to_vector
from jaxscan.precision import float64
from jaxscan.reconstruction import reconstruct
from jaxscan.rig import CARRIED_BY
from jaxscan.simulation import rig_2003
from jaxscan.simulation.robot import Robot, simulate_robot_scan, simulate_robot_session, with_robot
from jaxscan.simulation.shapes import figure

_SEEDS, _FEW = 60, 4
_SCANS, _ONE = 4, 1
_VIEWS, _POSED = 8, 16
_CORNER_PX: Final = 0.1
# Errors of the poses: mm and degrees.
_ERRORS: Final = {"exact": (0.002, 0.001), "good": (0.05, 0.02), "bad": (0.5, 0.2)}
_FAR_MM: Final = 2.0


def measure(quick: bool) -> list[Metric]:
    """Sessions of 60 seeds and scans of four; or of a few."""
    seeds, metrics = range(_FEW if quick else _SEEDS), []
    for moves in CARRIED_BY:
        for name, (mm, degrees) in _ERRORS.items():
            metrics += _hands(f"{moves}.{name}", seeds, Robot(moves, mm, degrees), peers=moves == "head")
    metrics += _hands("head.six_photographs", seeds, Robot("head"), posed=6, peers=True)
    metrics += _hands("head.errors_that_go_on", seeds, Robot("head"), drifting=True)
    metrics += _hands("head.two_wrong", seeds, Robot("head"), wrong=2, peers=True)
    for moves in CARRIED_BY:
        metrics += _scans(moves, range(_ONE if quick else _SCANS))
    return metrics


def _hands(name: str, seeds: range, robot: Robot, *, peers: bool = False, **how: Any) -> list[Metric]:
    """Errors of K over their σ, and over those of the closed form on the same board poses."""
    squares, places, others, found, left_out = [], [], [], [], []
    for seed in seeds:
        drawn, true = _session(seed, robot, **how)
        result = calibrate(drawn)
        assert result.hand is not None
        names = [f"motion.poses.{part}.{i}" for part in ("rotation", "offset") for i in range(3)]
        at = [result.covariance.names.index(each) for each in names]
        motion = result.rig.axes()["poses"]
        got = np.array([float(leaf) for leaf in jax.tree.leaves(motion)])
        off = got - np.concatenate([matrix_to_vector(true.matrix()), true.matrix().T @ true.translation])
        squares.append(off @ np.linalg.solve(result.covariance.matrix[np.ix_(at, at)], off) / len(at))
        places.append(np.linalg.norm(motion.to_camera().translation - true.translation))  # type: ignore[attr-defined]
        found.append((result.hand.found_mm, result.hand.found_deg))
        left_out.append(int((~result.hand.kept).sum()))
        if peers:
            others.append(np.linalg.norm(_by_park(result) - true.translation))
    ratio = np.sqrt(np.mean(np.square(found), axis=0)) / [robot.sigma_mm, robot.sigma_deg]
    z = float(np.sqrt(np.mean(squares)))
    judged = "drifting" not in how
    metrics = [
        Metric(f"robot.{name}.z_off_1", abs(z - 1), "", "lower" if judged else "shown", 0.15, floor=0.1),
        Metric(f"robot.{name}.place_mm", float(np.sqrt(np.mean(np.square(places)))), "mm"),
        Metric(f"robot.{name}.sigma_mm_over_true", float(ratio[0])),
        Metric(f"robot.{name}.sigma_deg_over_true", float(ratio[1])),
        Metric(f"robot.{name}.left_out", float(np.mean(left_out))),
    ]
    if others:
        theirs = float(np.sqrt(np.mean(np.square(others))))
        metrics.append(Metric(f"robot.{name}.place_over_park", metrics[1].value / theirs, "", "lower", 1.0))
    print(f"  {name}: " + ", ".join(f"{m.name.split('.')[-1]} {m.value:.3g}" for m in metrics), flush=True)
    return metrics


def _session(
    seed: int, robot: Robot, *, posed: int = _POSED, drifting: bool = False, wrong: int = 0
) -> tuple[Observations, Pose[np.ndarray]]:
    """Drawn corners, and the true K."""
    random = np.random.default_rng([62, seed])
    rig = with_robot(rig_2003.simulated_rig(seed), robot, seed)
    K = rig.motion.to_camera()  # type: ignore[attr-defined]
    at = rig_2003.board_poses(rig, seed, _VIEWS + posed)
    boards = Pose(np.asarray(at.rotation, np.float64), np.asarray(at.translation, np.float64))
    mounted = Pose(random.normal(0, 1, 3), random.normal(0, 200, 3))
    last = Pose(boards.rotation[_VIEWS:], boards.translation[_VIEWS:])
    true = robot.kind.carry(K.inverse() @ last @ mounted.inverse())
    given = robot.given(true, random)
    if drifting:
        # A random walk of the same size.
        walk = np.cumsum(random.normal(0, 1, (posed, 6)), axis=0) / np.sqrt(posed / 2)
        turn = Rotation.from_rotvec(np.radians(robot.sigma_deg) * walk[:, :3])
        rotation = (Rotation.from_rotvec(true.rotation) * turn).as_rotvec()
        given = Pose(rotation, true.translation + robot.sigma_mm * walk[:, 3:])
    for i in range(wrong):
        given.translation[3 + 5 * i] += [0.0, 8.0, 0.0]
    with float64():
        project = jax.jit(jax.vmap(rig.camera.project))
        views = []
        for i in range(_VIEWS + posed):
            X = Pose(boards.rotation[i], boards.translation[i]).apply(rig_2003.BOARD.points())
            pixels = np.asarray(project(jnp.asarray(X))) + random.normal(0, _CORNER_PX, (len(X), 2))
            pose = Pose(given.rotation[i - _VIEWS], given.translation[i - _VIEWS]) if i >= _VIEWS else None
            views.append(View(f"{i:02d}", pixels, given=pose))
    hand = HandSettings(robot.moves)
    return Observations(rig.camera.image_size, rig_2003.BOARD, tuple(views), hand=hand), K


def _by_park(result: Calibration) -> np.ndarray:
    """Where the hand is in the camera's frame, as F. C. Park and B. J. Martin (1994) find it: of all pairs alike."""
    posed = [i for i, view in enumerate(result.observations.views) if view.given is not None]
    given = [view.given for view in result.observations.views if view.given is not None]
    boards = result.system.boards
    A = _of_pairs(np.asarray(boards.matrix())[posed], np.asarray(boards.translation)[posed])
    back = [each.inverse() for each in given]
    B = _of_pairs(np.stack([each.matrix() for each in back]), np.stack([each.translation for each in back]))
    u, _, vt = np.linalg.svd(matrix_to_vector(A[0]).T @ matrix_to_vector(B[0]))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    # A X = X B: (R_A − 1) t_X = R_X t_B − t_A.
    left, right = (A[0] - np.eye(3)).reshape(-1, 3), (B[1] @ R.T - A[1]).ravel()
    return np.linalg.lstsq(left, right)[0]


def _of_pairs(R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From each photograph to each other: rotation and translation."""
    i, j = np.triu_indices(len(R), 1)
    turn = R[i] @ R[j].swapaxes(-1, -2)
    return turn, t[i] - (turn @ t[j][..., None])[..., 0]


def _scans(moves: str, seeds: range) -> list[Metric]:
    """Scans of a figure by photographs: errors along the ray, and how many lie within their σ."""
    within, rms, poses = [], [], []
    for seed in seeds:
        errors, sigma, of_poses = _scan(moves, seed)
        within.append([np.mean(np.abs(errors) < k * sigma) for k in (1, 2, 3)])
        rms.append(np.sqrt(np.mean(errors**2)))
        poses.append(of_poses)
    low = [f"robot.{moves}.scan.within_{k}_sigma" for k in (1, 2, 3)]
    shares = np.mean(within, axis=0)
    # Four scans have four errors of the rig, and 37 of the robot each.
    metrics = [
        Metric(name, float(share), "", "higher", goal, floor=0.05)
        for name, share, goal in zip(low, shares, (0.55, 0.88, 0.97), strict=True)
    ]
    metrics.append(Metric(f"robot.{moves}.scan.along_the_ray_mm", float(np.sqrt(np.mean(np.square(rms)))), "mm"))
    metrics.append(Metric(f"robot.{moves}.scan.over_the_pixels_alone", float(np.mean(poses))))
    print(f"  {moves}, scans: " + ", ".join(f"{m.name.split('.')[-1]} {m.value:.3g}" for m in metrics), flush=True)
    return metrics


def _scan(moves: str, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    plain, robot = rig_2003.simulated_rig(seed), Robot(moves)
    rig = with_robot(plain, robot, seed)
    steps = np.linspace(0, 72_000, rig_2003.SCAN_FRAMES)
    with TemporaryDirectory() as name:
        folder = Path(name)
        simulate_robot_session(folder / "session", seed, rig, robot)
        scene = rig_2003.scan_scene(plain, _bodies(figure(rig_2003.OBJECT_Y)))
        middle = rig_2003.middle_of_object(plain)
        truth = simulate_robot_scan(
            folder / "scan", rig, robot, scene, rig_2003.stage_travel(plain, steps), middle, seed
        )
        result = calibrate(observe(read_session(folder / "session")))
        image = reconstruct(result.rig_file(), read_scan(folder / "scan"))
    rays = image.points - image.cameras()[:, None]
    errors = ((image.points - truth.points) * rays / np.linalg.norm(rays, axis=-1, keepdims=True)).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        near = image.valid & (np.abs(errors) < _FAR_MM)
    return errors[near], image.sigma[near], float(np.median(image.sigma[near] / image.sigma_pixel[near]))


def _bodies(body: Any) -> tuple[Any, ...]:
    return body if isinstance(body, tuple) else (body,)
