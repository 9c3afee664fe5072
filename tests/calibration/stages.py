"""Sessions of the rig of 2003 whose stage is drawn as a machine has it, as a detector would have seen them."""

from dataclasses import replace

import numpy as np

from jaxscan.calibration import BoardSequence, Observations, View
from jaxscan.geometry import Pose
from jaxscan.simulation.drawn_stage import DrawnStage
from tests.calibration import synthetic

TRAVEL = 60000.0
BOARD_ROTATION, BOARD_MIDDLE = np.array([0.15, -0.2, 0.05]), np.array([2.0, -1.0, 345.0])


def stage(**how) -> DrawnStage:
    return DrawnStage.create(synthetic.PER_STEP, over_mm=1e-3 * TRAVEL, **how)


def uneven(seed: int = 0, places: int = 31) -> np.ndarray:
    inner = np.random.default_rng([21, seed]).choice(np.arange(1, TRAVEL), places - 2, replace=False)
    return np.concatenate([[0.0], np.sort(inner), [TRAVEL]])


def board_at_0(of: DrawnStage) -> Pose:
    """Such that its middle stands in the middle of the view half-way."""
    middle = synthetic.BOARD.points().mean(axis=0)
    turned = Pose(BOARD_ROTATION, np.zeros(3))
    half_way = Pose(BOARD_ROTATION, BOARD_MIDDLE - turned.apply(middle))
    return of.pose({"stage": np.float64(TRAVEL / 2)}).inverse() @ half_way


def session(
    seed: int,
    of: DrawnStage,
    steps: np.ndarray | None = None,
    *,
    noise: float = 0.03,
    aside: np.ndarray | None = None,
    points: np.ndarray | None = None,
    laser: bool = True,
) -> Observations:
    """Views, and a board on the stage; `aside` is where it stood beside its path, `points` are the board's as it is."""
    known = synthetic.observations(seed, n_stage=0, noise=synthetic.Noise(noise), laser=laser)
    steps = uneven(seed) if steps is None else steps
    random = np.random.default_rng([23, seed])
    points = synthetic.BOARD.points() if points is None else points
    stood = of.pose({"stage": steps}) @ board_at_0(of)
    beside = np.zeros((len(steps), 3)) if aside is None else aside
    views = []
    for i, (R, t) in enumerate(zip(stood.matrix(), stood.translation + beside, strict=True)):
        pixels = synthetic.project(points @ R.T + t)
        views.append(View(f"stage-{i:02d}", pixels + noise * random.normal(size=pixels.shape)))
    return replace(known, sequences=(BoardSequence({"stage": steps}, tuple(views)),))
