"""Observations of boards that are not flat, drawn, not photographed: what an ideal detector sees of the rig of 2003.

Boards may have any shape z(x, y); the stripe is where the sheet of light meets that surface, found by secants, and
pixels are OpenCV's. Nothing here is shared with the model that is to follow these boards.
"""

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from benchmarks.drawn import Noise, redrawn
from jaxscan.calibration import BoardSequence, Observations, StripePoints, View
from jaxscan.geometry import Pose
from jaxscan.images import Board
from jaxscan.rig import LightPlane, Rig
from jaxscan.rig.opencv_lens import Radial1
from jaxscan.simulation import rig_2003

# Z (mm) at places of a board, mm in its own frame.
Height = Callable[[Float[np.ndarray, "*points"], Float[np.ndarray, "*points"]], Float[np.ndarray, "*points"]]
# Of the board in a view by its number, and of the one on the stage, by −1.
Heights = Callable[[int], Height]

ON_STAGE: Final = -1
_ALONG, _SECANTS, _OUTLINE = 1201, 12, 180


def flat(x: Float[np.ndarray, "*points"], y: Float[np.ndarray, "*points"]) -> Float[np.ndarray, "*points"]:
    """A flat board."""
    return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))


def bent_session(
    seed: int,
    heights: Heights,
    *,
    board: Board = rig_2003.BOARD,
    views: int = rig_2003.BOARD_VIEWS,
    stage_views: int = rig_2003.STAGE_VIEWS,
    stripes: bool = True,
    stripes_on_stage: bool = False,
    columns_apart: int = 1,
    radius_mm: float = 0.0,
    spread: float = 1.0,
) -> tuple[Rig, Observations]:
    """The rig of a seed, and what is seen of boards of some shapes without any noise.

    Args:
        seed: of the rig and the poses.
        heights: the shape of each board.
        board: its points; its middle stands where that of the board of 9 x 6 does.
        views: how many.
        stage_views: how many along the stage.
        stripes: whether there is a laser.
        stripes_on_stage: whether its stripe is in the stage's photographs.
        columns_apart: from one stripe point to the next.
        radius_mm: of circles about the points, whose centres of gravity are seen; 0 for points.
        spread: by this the boards of the views differ in their turns from the mean turn; 0 for parallel boards.
    """
    rig = rig_2003.simulated_rig(seed)
    poses = rig_2003.board_poses(rig, seed, views)
    centre, turns = rig_2003.BOARD.points().mean(axis=0), np.asarray(poses.rotation)
    middles, turns = poses.apply(centre), turns.mean(axis=0) + spread * (turns - turns.mean(axis=0))
    poses = Pose(turns, middles - Pose(turns, np.zeros_like(turns)).apply(centre))
    points = board.points()
    # Its middle stands where that of the board of 9 x 6 does.
    aside = rig_2003.BOARD.points().mean(axis=0) - points.mean(axis=0)

    def view(name: str, R: np.ndarray, t: np.ndarray, height: Height, lit: bool) -> View:
        t = t + R @ aside
        seen = _corners(rig, R, t, points, height, radius_mm)
        inside = np.all((seen >= 0) & (seen <= np.array(rig.camera.image_size) - 1), axis=1)
        seen = np.where(inside[:, None], seen, np.nan)
        lines = (_stripe(rig, R, t, points, board.pitch_mm, height, columns_apart),) if lit else ()
        return View(name, seen, stripes=lines)

    shown = tuple(
        view(f"view-{i}", R, np.asarray(t), heights(i), stripes)
        for i, (R, t) in enumerate(zip(poses.matrix(), poses.translation, strict=True))
    )
    sequences: tuple[BoardSequence, ...] = ()
    if stage_views:
        stage = rig_2003.stage_pose(rig, seed)
        most = (rig_2003.STAGE_VIEWS - 1) * rig_2003.STEPS_APART
        steps = np.round(np.linspace(0, most, stage_views))
        moved = rig_2003.stage_travel(rig, steps)
        along = tuple(
            view(f"stage-{i}", stage.matrix(), np.asarray(stage.translation + by), heights(ON_STAGE), stripes_on_stage)
            for i, by in enumerate(moved)
        )
        sequences = (BoardSequence({"stage": steps}, along),)
    lasers = ("",) if stripes else ()
    return rig, Observations(rig_2003.IMAGE_SIZE, board, shown, sequences, lasers, radius_mm=radius_mm)


def clean_session(seed: int) -> Observations:
    """A session with flat boards of another size, number of views and noise by the seed."""
    random = np.random.default_rng([seed, 40])
    board = Board.checkerboard((int(random.integers(5, 13)), int(random.integers(4, 9))), float(random.uniform(9, 15)))
    views, stage = int(random.integers(5, 25)), int(random.integers(0, 3)) * 8
    _, exact = bent_session(seed, lambda _: flat, board=board, views=views, stage_views=stage, columns_apart=3)
    noise = Noise(float(random.uniform(0.01, 0.15)), float(random.uniform(0.03, 0.3)))
    return redrawn(exact, noise, random)


def projected_by_opencv(rig: Rig, X: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 2"]:
    """Where points (camera frame, mm) are seen, by OpenCV."""
    camera = rig.camera
    (fu, fv), (cu, cv) = camera.focal, camera.principal
    K = np.array([[float(fu), 0, float(cu)], [0, float(fv), float(cv)], [0, 0, 1.0]])
    assert isinstance(camera.lens, Radial1)
    (k1,) = camera.lens.radial
    k = np.array([float(k1), *[0.0] * 11, *map(float, camera.tilt or (0.0, 0.0))])
    return cv2.projectPoints(X.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, k)[0].reshape(-1, 2)


def _corners(
    rig: Rig, R: np.ndarray, t: np.ndarray, points: np.ndarray, height: Height, radius: float
) -> Float[np.ndarray, "points 2"]:
    x, y = points[:, 0], points[:, 1]
    if not radius:
        return projected_by_opencv(rig, np.stack([x, y, height(x, y)], axis=-1) @ R.T + t)
    around = np.linspace(0, 2 * np.pi, _OUTLINE, endpoint=False)
    x, y = (p[:, None] + radius * f(around) for p, f in ((x, np.cos), (y, np.sin)))
    ring = projected_by_opencv(rig, (np.stack([x, y, height(x, y)], axis=-1) @ R.T + t).reshape(-1, 3))
    u, v = np.moveaxis(ring.reshape(*x.shape, 2), -1, 0)
    # The centroid of each polygon.
    un, vn = np.roll(u, -1, axis=1), np.roll(v, -1, axis=1)
    cross = u * vn - un * v
    area = cross.sum(axis=1)
    return np.stack([((u + un) * cross).sum(axis=1), ((v + vn) * cross).sum(axis=1)], axis=-1) / (3 * area[:, None])


def _stripe(
    rig: Rig, R: np.ndarray, t: np.ndarray, points: np.ndarray, pitch: float, height: Height, columns_apart: int
) -> StripePoints:
    """Where the sheet is seen on the board, one pixel for each whole column: exact to 1e-6 px."""
    (light,) = rig.lights
    assert isinstance(light, LightPlane)
    omega = np.array([float(x) for x in light.plane])
    across = omega @ R[:, :2]
    across = across / np.hypot(*across)
    along = np.array([-across[1], across[0]])
    low, high = points[:, :2].min(axis=0) - pitch, points[:, :2].max(axis=0) + pitch
    middle = (low + high) / 2
    s = np.linspace(-1, 1, _ALONG) * np.linalg.norm(high - low)

    def at(o: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        xy = middle + s[:, None] * along + o[:, None] * across
        X = np.concatenate([xy, height(xy[:, 0], xy[:, 1])[:, None]], axis=1) @ R.T + t
        return xy, X

    one, other = np.zeros(_ALONG), np.ones(_ALONG)
    f_one, f_other = (at(o)[1] @ omega - 1 for o in (one, other))
    for _ in range(_SECANTS):
        slope = np.where(other != one, (f_other - f_one) / np.where(other != one, other - one, 1.0), 1.0)
        one, f_one = other, f_other
        other = other - np.where(slope != 0, f_other / np.where(slope != 0, slope, 1.0), 0.0)
        f_other = at(other)[1] @ omega - 1
    xy, X = at(other)
    good = (X[:, 2] > 0) & np.isfinite(X).all(axis=1)
    seen = projected_by_opencv(rig, X[good])
    xy = xy[good]
    order = np.argsort(seen[:, 0])
    seen, xy = seen[order], xy[order]
    apart = np.append(True, np.diff(seen[:, 0]) > 1e-6)
    seen, xy = seen[apart], xy[apart]
    columns = np.arange(0, rig.camera.image_size[0], columns_apart, dtype=float)
    v = CubicSpline(seen[:, 0], seen[:, 1], extrapolate=False)(columns)
    on = np.stack([np.interp(columns, seen[:, 0], xy[:, i]) for i in range(2)], axis=-1)
    inside = np.isfinite(v) & (v >= 0) & (v <= rig.camera.image_size[1] - 1)
    inside &= ((on > low) & (on < high)).all(axis=1)
    pixels = np.stack([np.where(inside, columns, np.nan), np.where(inside, v, np.nan)], axis=-1)
    # No squares were drawn, so that their edges need not be kept away from.
    return StripePoints(pixels, half_width_px=1e-6)
