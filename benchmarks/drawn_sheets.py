"""Stripes of sheets of light that may be curved, drawn, not photographed: what a detector sees on boards, with errors.

Sheets are surfaces by formulas of their own, not the lights that are fitted, and pixels are OpenCV's.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float

from benchmarks.drawn_bent import projected_by_opencv
from jaxscan.calibration import StripePoints, View
from jaxscan.rig import Rig
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation import rig_2003
from jaxscan.simulation.render import plane_of

# Of points in the camera frame, mm: 0 on the sheet.
Level = Callable[[Float[np.ndarray, "points 3"]], Float[np.ndarray, "points"]]

CORNER_PX: Final = 0.03
STRIPE_PX: Final = 0.1
# The sag of a sheet is given at ± this distance across the fan, at this depth; mm.
HALF, DEPTH = 100.0, 345.0
# Places along the stripe of a board, and Newton's steps to the sheet from each.
_ALONG, _STEPS = 2000, 20


def plane(rig: Rig) -> Level:
    """Mm beyond the plane of a rig of 2003."""
    omega = plane_of(rig.lights[0])
    return lambda X: (X @ omega - 1) / np.linalg.norm(omega)


def cone(rig: Rig, sag: float, beside: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Level:
    """About a normal of the plane; its apex is where the plane crosses the camera's v axis, plus `beside` (mm)."""
    omega = plane_of(rig.lights[0])
    normal = omega / np.linalg.norm(omega)
    apex = np.array([0.0, 1 / omega[1], 0.0]) + np.asarray(beside)
    apex -= normal * (normal @ apex - 1 / np.linalg.norm(omega))
    away = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    away /= np.linalg.norm(away)
    middle = (DEPTH - apex[2]) / away[2]
    slope = sag / (np.hypot(middle, HALF) - middle)

    def level(X: np.ndarray) -> np.ndarray:
        P = X - apex
        high = P @ normal
        return high + slope * (np.linalg.norm(P - high[:, None] * normal, axis=1) - P @ away)

    return level


def view(
    name: str,
    rig: Rig,
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, "3"],
    level: Level,
    random: np.random.Generator,
) -> View:
    """The board in a pose, corners and stripe with errors."""
    pixels, _ = stripe(rig, R, t, level, random)
    corners = projected_by_opencv(rig, rig_2003.BOARD.points() @ R.T + t)
    corners = corners + CORNER_PX * random.normal(size=corners.shape)
    # No squares were drawn, so that their edges need not be kept away from.
    return View(name, corners, stripes=(StripePoints(pixels, half_width_px=1e-6),))


def stripe(
    rig: Rig, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"], level: Level, random: np.random.Generator
) -> tuple[Float[np.ndarray, "columns 2"], Float[np.ndarray, "columns 3"]]:
    """Where the stripe on a board is seen, with errors, and the true points; NaN where it is not."""
    board, size = rig_2003.BOARD, rig.camera.image_size
    furthest, columns = board.points().max(axis=0)[:2], np.arange(float(size[0]))
    x = np.linspace(-board.pitch_mm, furthest[0] + board.pitch_mm, _ALONG)
    on, y = (x[:, None] * R[:, 0]) + t, np.zeros_like(x)
    for _ in range(_STEPS):
        X = on + y[:, None] * R[:, 1]
        y -= level(X) * 1e-3 / (level(X + 1e-3 * R[:, 1]) - level(X))
    within = (y > -board.pitch_mm) & (y < furthest[1] + board.pitch_mm)
    X = (on + y[:, None] * R[:, 1])[within]
    seen = projected_by_opencv(rig, X)
    order = np.argsort(seen[:, 0])
    u = seen[order, 0]
    rows, *truth = (np.interp(columns, u, part[order], left=np.nan, right=np.nan) for part in (seen[:, 1], *X.T))
    rows = np.where((rows < 0) | (rows > size[1] - 1), np.nan, rows) + STRIPE_PX * random.normal(size=size[0])
    return np.stack([columns, rows], axis=1), np.stack(truth, axis=1)


def unseen(
    rig: Rig, seed: int, views: int, level: Level
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points 3"]]:
    """Pixels of stripes, with errors, on boards that no session of the seed shows, and their true points, mm."""
    random = np.random.default_rng(81)
    poses = rig_2003.board_poses(rig, 1000 + seed, views)
    stripes = [
        stripe(rig, R, np.asarray(t), level, random) for R, t in zip(poses.matrix(), poses.translation, strict=True)
    ]
    pixels, truth = (np.concatenate(parts) for parts in zip(*stripes, strict=True))
    there = np.isfinite(pixels).all(axis=1)
    return pixels[there], truth[there]


def triangulated(rig: Rig, pixels: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 3"]:
    """Points of the stripe of a rig's one laser, camera frame, mm."""
    rays = pixel_rays(rig.camera, pixels)
    return rays / rig.lights[0].inverse_depth(rays)[:, None]
