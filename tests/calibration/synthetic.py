"""Observations computed from a known rig, without photographs: what a perfect detector would have seen, plus noise."""

from dataclasses import dataclass

import cv2
import numpy as np

from jaxscan.calibration import BoardSequence, Observations, StripePoints, View
from jaxscan.images import Board

IMAGE_SIZE = (640, 480)
FOCAL, PRINCIPAL, K1 = (697.70833, 690.43328), (310.29604, 228.14934), -0.13396
OMEGA = np.array([0.0, -0.00494, 0.00303])
PER_STEP = 0.001 * np.array([0.03, 0.92, -0.39]) / np.linalg.norm([0.03, 0.92, -0.39])
BOARD = Board.checkerboard([9, 6], 16.0)
# Of the turntable, one step of 3200; the axis 25° to the line of sight.
PER_TURN = 2 * np.pi / 3200 * np.array([0.05, -0.42, -0.9]) / np.linalg.norm([0.05, -0.42, -0.9])
ON_AXIS = np.array([3.0, -4.0, 350.0])
TRUTH = {
    "camera.focal.0": FOCAL[0],
    "camera.focal.1": FOCAL[1],
    "camera.principal.0": PRINCIPAL[0],
    "camera.principal.1": PRINCIPAL[1],
    "camera.radial.0": K1,
    **{f"lights.0.plane.{i}": OMEGA[i] for i in range(3)},
    **{f"motion.stage.per_step.{i}": PER_STEP[i] for i in range(3)},
}

CENTRE = ON_AXIS - ON_AXIS @ PER_TURN / (PER_TURN @ PER_TURN) * PER_TURN
TRUTH_WITH_TURNTABLE = {
    **TRUTH,
    **{f"motion.turntable.per_step.{i}": PER_TURN[i] for i in range(3)},
    **{f"motion.turntable.centre.{i}": CENTRE[i] for i in range(3)},
}


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is seen, pixels."""

    corner: float = 0.05
    stripe: float = 0.1


def project(X: np.ndarray) -> np.ndarray:
    """Camera frame to pixels, by OpenCV."""
    K = np.array([[FOCAL[0], 0, PRINCIPAL[0]], [0, FOCAL[1], PRINCIPAL[1]], [0, 0, 1.0]])
    return cv2.projectPoints(X.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, np.array([K1, 0, 0, 0]))[0].reshape(
        -1, 2
    )


def board_pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A pose like those of the rig of 2003: 310 to 380 mm away, tilted by up to 0.6 rad."""
    R = cv2.Rodrigues(np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.2, 0.2)]))[0]
    centre = BOARD.points().mean(axis=0)
    return R, np.array([*rng.uniform(-15, 15, 2), rng.uniform(310, 380)]) - R @ centre


def stripe_on(R: np.ndarray, t: np.ndarray, columns: bool, omega: np.ndarray = OMEGA) -> np.ndarray:
    """Where the sheet is seen on a board, one pixel for each whole column (or row): exact to 1e-9 px."""
    # The line of points X with ω · X = 1 on the board: X = R (x, y, 0) + t.
    a = omega @ R[:, :2]
    start = a * (1 - omega @ t) / (a @ a)
    along = np.array([-a[1], a[0]]) / np.hypot(*a)
    s = np.linspace(-200, 200, 4001)
    XY = start + s[:, None] * along
    seen = project(XY @ R[:, :2].T + t)
    x, y = (seen[:, 0], seen[:, 1]) if columns else (seen[:, 1], seen[:, 0])
    order = np.argsort(x)
    size, other = IMAGE_SIZE if columns else IMAGE_SIZE[::-1]
    index = np.arange(size, dtype=float)
    from scipy.interpolate import CubicSpline

    monotone = np.diff(x[order]) > 0
    keep = np.append(monotone, True)
    position = CubicSpline(x[order][keep], y[order][keep], extrapolate=False)(index)
    position[(position < 0) | (position > other - 1)] = np.nan
    on = np.interp(index, x[order], s[order])
    at = start + on[:, None] * along
    furthest = (np.array(BOARD.counts) - 1) * BOARD.pitch_mm
    position[~((at > -BOARD.pitch_mm) & (at < furthest + BOARD.pitch_mm)).all(axis=1)] = np.nan
    index = np.where(np.isfinite(position), index, np.nan)
    return np.stack([index, position] if columns else [position, index], axis=-1)


def observations(
    seed: int,
    n_views: int = 11,
    n_stage: int = 31,
    noise: Noise = Noise(),
    columns: bool = True,
    first_step: int = 0,
    step: int = 2000,
    laser: bool = True,
    stripes_on_stage: bool = False,
) -> Observations:
    """A session of the rig of 2003."""
    rng = np.random.default_rng(seed)
    points = BOARD.points()
    views = []
    for i in range(n_views):
        R, t = board_pose(rng)
        corners = project(points @ R.T + t) + noise.corner * rng.normal(size=(len(points), 2))
        stripes = ()
        if laser:
            pixels = stripe_on(R, t, columns)
            pixels[:, int(columns)] += noise.stripe * rng.normal(size=len(pixels))
            stripes = (StripePoints(pixels, columns, half_width_px=1e-6),)
        views.append(View(f"view-{i}", corners, stripes=stripes))
    stages = ()
    if n_stage:
        R, t = board_pose(rng)
        t = t - PER_STEP * step * (n_stage - 1) / 2
        steps = first_step + step * np.arange(n_stage, dtype=float)
        stage_views = tuple(
            View(
                f"stage-{i}",
                project(points @ R.T + t + PER_STEP * step * i) + noise.corner * rng.normal(size=(len(points), 2)),
                stripes=noisy_stripe(R, t + PER_STEP * step * i, noise.stripe, seed + i) if stripes_on_stage else (),
            )
            for i in range(n_stage)
        )
        stages = (BoardSequence({"stage": steps}, stage_views),)
    return Observations(IMAGE_SIZE, BOARD, tuple(views), stages, ("",) if laser else ())


def noisy_stripe(R: np.ndarray, t: np.ndarray, noise: float, seed: int) -> tuple[StripePoints, ...]:
    """The stripe on a board, column by column."""
    pixels = stripe_on(R, t, True)
    pixels[:, 1] += noise * np.random.default_rng([seed, 11]).normal(size=len(pixels))
    return (StripePoints(pixels, half_width_px=1e-6),)


def turned(
    seed: int,
    noise: float = 0.05,
    images: int = 8,
    apart: float = 400.0,
    stage_step: int = 0,
    stripes: bool = False,
) -> BoardSequence:
    """Photographs of a board that lies on the turntable, askew and beside its middle."""
    rng = np.random.default_rng([seed, 7])
    points = BOARD.points()
    lying = cv2.Rodrigues(np.array([-0.4, 0.05, 0.3]))[0]
    on_table = (points - points.mean(axis=0) + rng.uniform(-8, 8, 3)) @ lying.T
    views, steps = [], apart * np.arange(images)
    for i, n in enumerate(steps):
        turn = cv2.Rodrigues(n * PER_TURN)[0]
        X = on_table @ turn.T + ON_AXIS + stage_step * PER_STEP
        stripe = noisy_stripe(turn @ lying, X[0] - turn @ lying @ points[0], 2 * noise, seed + i) if stripes else ()
        views.append(View(f"turntable-{i}", project(X) + noise * rng.normal(size=(len(points), 2)), stripes=stripe))
    stood = np.full(len(steps), float(stage_step))
    return BoardSequence({"stage": stood, "turntable": steps}, tuple(views), "turntable", "rotary")
