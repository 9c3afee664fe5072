"""Sessions of the rig of 2003 whose sheet of light, or whose board, is not flat."""

from collections.abc import Callable

import numpy as np

from jaxscan.calibration import Observations, StripePoints, View
from tests.calibration import synthetic

Level = Callable[[np.ndarray], np.ndarray]

DEPTH = 345.0


def cone(sag: float, source=(0.0, -202.0, 0.0), omega=synthetic.OMEGA) -> Level:
    """A circular cone about a normal of the plane, its apex at a laser: `sag` mm at ± 100 mm, at 345 mm depth.

    What a cylinder lens makes that is not square to its beam, to all orders.
    """
    normal, source = omega / np.linalg.norm(omega), np.asarray(source)
    # On the plane, and straight away from the apex in the view's middle.
    apex = source - normal * (normal @ source - 1 / np.linalg.norm(omega))
    away = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    away /= np.linalg.norm(away)
    middle = (DEPTH - apex[2]) / away[2]
    slope = sag / (np.hypot(middle, 100.0) - middle)

    def level(X: np.ndarray) -> np.ndarray:
        P = X - apex
        high = P @ normal
        flat = np.linalg.norm(P - high[:, None] * normal, axis=1)
        return high + slope * (flat - P @ away)

    return level


def session(
    seed: int,
    level: Level,
    n_views: int = 11,
    corner: float = 0.05,
    stripe: float = 0.1,
    board_mm: tuple[float, float] = (0.0, 0.0),
    pose=synthetic.board_pose,
) -> Observations:
    """Views alone; the board bulges along its columns and rows by `board_mm`."""
    rng, views, board = np.random.default_rng(seed), [], synthetic.BOARD
    furthest = board.points().max(axis=0)[:2]

    def surface(at: np.ndarray) -> np.ndarray:
        a = at / furthest
        return np.column_stack([at, (4 * a * (1 - a)) @ np.asarray(board_mm)])

    for i in range(n_views):
        R, t = pose(rng)
        corners = synthetic.project(surface(board.points()[:, :2]) @ R.T + t)
        # Along the board's x, the y of the stripe by Newton's steps.
        x = np.linspace(-board.pitch_mm, furthest[0] + board.pitch_mm, 3000)
        y = np.zeros_like(x)
        for _ in range(30):
            X, Y = (surface(np.stack([x, y + step], axis=1)) @ R.T + t for step in (0.0, 1e-4))
            y = y - level(X) * 1e-4 / (level(Y) - level(X))
        on = (y > -board.pitch_mm) & (y < furthest[1] + board.pitch_mm)
        seen = synthetic.project((surface(np.stack([x, y], axis=1)) @ R.T + t)[on])
        columns = np.arange(float(synthetic.IMAGE_SIZE[0]))
        order = np.argsort(seen[:, 0])
        rows = np.interp(columns, *seen[order].T, left=np.nan, right=np.nan)
        rows[(rows < 0) | (rows > synthetic.IMAGE_SIZE[1] - 1)] = np.nan
        rows += stripe * rng.normal(size=len(rows))
        pixels = np.stack([np.where(np.isfinite(rows), columns, np.nan), rows], axis=1)
        noisy = corners + corner * rng.normal(size=corners.shape)
        views.append(View(f"view-{i}", noisy, stripes=(StripePoints(pixels, half_width_px=1e-6),)))
    return Observations(synthetic.IMAGE_SIZE, board, tuple(views), (), ("",))
