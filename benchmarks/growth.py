"""How the time of a calibration grows with the number of views, and `cv2.calibrateCamera` on the same corners.

Both get corners alone, in float32 precision, and start up by themselves; both find the same minimum. Compile time is
measured apart. Times are medians of several runs in turn. In full also dense normal equations and SciPy, of few views.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.dense import PEERS
from benchmarks.metric import Metric, ratio
from benchmarks.timing import timed
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import solve
from jaxscan.calibration.residuals import Noise
from jaxscan.images import Board
from jaxscan.precision import as_float64, float64
from jaxscan.rig import System

BOARD = Board.checkerboard([9, 6], 16.0)
IMAGE_SIZE = (640, 480)
K = np.array([[697.70833, 0, 310.29604], [0, 690.43328, 228.14934], [0, 0, 1]])
K1 = -0.13396
NOISE_PX = 0.05
# With more views dense matrices take minutes.
_PEERS_UP_TO = 40


def observations(n_views: int, seed: int = 0) -> Observations:
    """Boards in random poses before the camera of 2003."""
    rng = np.random.default_rng(seed)
    points = BOARD.points()
    views = []
    for i in range(n_views):
        w = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.2, 0.2)])
        t = np.array([*rng.uniform(-15, 15, 2), rng.uniform(310, 380)]) - cv2.Rodrigues(w)[0] @ points.mean(axis=0)
        seen = cv2.projectPoints(points, w, t, K, np.array([K1, 0, 0, 0]))[0].reshape(-1, 2)
        seen = (seen + NOISE_PX * rng.normal(size=seen.shape)).astype(np.float32).astype(np.float64)
        views.append(View(f"{i}", seen))
    return Observations(IMAGE_SIZE, BOARD, tuple(views))


def ours(session: Observations) -> Calibration:
    """Least squares over all corners."""
    return calibrate(session, plain=True)


def opencvs(session: Observations) -> float:
    """The same by OpenCV, run to its minimum; its RMS distance."""
    return cv2.calibrateCamera(
        [BOARD.points().astype(np.float32)] * len(session.views),
        [view.corners.astype(np.float32)[:, None] for view in session.views],
        IMAGE_SIZE,
        None,  # pyright: ignore[reportArgumentType]
        None,  # pyright: ignore[reportArgumentType]
        flags=cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
        # As many steps as its default allows, and no tolerance that would let it stop short of ours.
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, np.finfo(float).eps),
    )[0]


def timed_step(session: Observations, found: Calibration) -> Callable[[], float]:
    """A function that times one step of the solve alone, in seconds, from a focal length 2 % off."""
    with float64():
        rig = as_float64(found.rig)
        f = rig.camera.focal
        rig = replace(rig, camera=replace(rig.camera, focal=(1.02 * f[0], 1.02 * f[1])))
        groups = (view_blocks(session),)
        poses = as_float64(found.system.boards).as_vector()
        padded = jnp.pad(poses, ((0, len(groups[0].corners) - len(poses)), (0, 0)), constant_values=1.0)
        free = jnp.ones(len(jax.tree.leaves(rig)), bool)
        noise = Noise.create(found.corner_sigma_px)

    def seconds() -> float:
        with float64():
            begin = time.perf_counter()
            outcome = jax.block_until_ready(solve(System(rig, (padded,)), free, groups, noise))
            return (time.perf_counter() - begin) / int(outcome.steps)

    seconds()
    return seconds


def measure(quick: bool) -> list[Metric]:
    """Time, steps and cost over the number of views."""
    sizes = (160, 640) if quick else (10, 40, 160, 640)
    repeats = 5 if quick else 7
    metrics: list[Metric] = []
    steps: dict[int, int] = {}
    solves: dict[int, Callable[[], float]] = {}
    for n in sizes:
        session = observations(n)
        begin = time.perf_counter()
        first = ours(session)
        compiling = time.perf_counter() - begin
        times: dict[str, list[float]] = {"ours": [], "opencv": []}
        rms = 0.0
        for _ in range(repeats):
            begin = time.perf_counter()
            ours(session)
            times["ours"].append(time.perf_counter() - begin)
            begin = time.perf_counter()
            rms = opencvs(session)
            times["opencv"].append(time.perf_counter() - begin)
        mine, theirs = (statistics.median(times[key]) for key in ("ours", "opencv"))
        # Each run against the one that followed it: what else the machine does slows both.
        in_turn = statistics.median(a / b for a, b in zip(times["ours"], times["opencv"], strict=True))
        steps[n], solves[n] = first.steps, timed_step(session, first)
        metrics += [
            Metric(f"growth.{n}_views.ours", 1000 * mine, "ms"),
            Metric(f"growth.{n}_views.opencv", 1000 * theirs, "ms"),
            Metric(f"growth.{n}_views.first_call_with_compiling", compiling, "s"),
            Metric(f"growth.{n}_views.steps", first.steps, ""),
        ]
        if n <= _PEERS_UP_TO:
            for name, peer in PEERS.items():
                _, seconds, its_rms = timed(lambda peer=peer, session=session: peer(session), 3)
                metrics += [
                    Metric(f"growth.{n}_views.{name}", 1000 * seconds, "ms"),
                    Metric(f"growth.{n}_views.{name}_over_ours", seconds / mine),
                    Metric(f"growth.{n}_views.{name}.rms_above_opencv", its_rms / rms - 1),
                ]
        if n >= 160:
            excess = (first.corner_rms_px / rms) ** 2 - 1
            metrics += [
                ratio(f"growth.{n}_views.ours_over_opencv", in_turn, 1.0),
                Metric(f"growth.{n}_views.cost_above_opencv", excess, "", "lower", 1e-9, floor=1e-9),
            ]
    # In turn as well, so that what slows one size slows the others.
    rounds = [{n: seconds() for n, seconds in solves.items()} for _ in range(3 * repeats)]
    metrics += [
        *(Metric(f"growth.{n}_views.one_step", 1000 * statistics.median(r[n] for r in rounds), "ms") for n in sizes),
        ratio("growth.time_of_a_step_640_over_160", statistics.median(r[640] / r[160] for r in rounds), 5.0),
        Metric("growth.more_steps_at_640", steps[640] - steps[160], "", "lower", 3, floor=1),
    ]
    return metrics
