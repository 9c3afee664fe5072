"""Predicted against actual scatter of a rig with a fisheye, as `montecarlo` has it of one of a plain lens.

Boards are held all over an image whose corners are 73° off the axis, with the stripe of a flat sheet on those that it
meets, and one is on a stage. Asked besides are the camera's and the other parts' numbers, each by itself, and the
pixels of points 48° and 66° off the axis.
"""

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import CubicSpline

from benchmarks.drawn import project
from benchmarks.drawn_bent import Height, flat
from benchmarks.metric import Metric
from benchmarks.montecarlo import DRAWS_QUICK, Session, compared, leaves, projected
from jaxscan.calibration import BoardSequence, Observations, StripePoints, View
from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from jaxscan.simulation import rig_2003

_DRAWS = 900
_VIEWS, _STAGE_VIEWS, _STEPS_APART = 14, 11, 5000
_FOCAL, _PRINCIPAL, _ANGULAR = (322.0, 318.0), (312.3, 244.8), (-0.03, 0.012, -0.006, 0.001)
_OMEGA = np.array([0.0, -0.0085, 0.0035])
_PER_STEP = 0.001 * np.array([0.03, 0.92, -0.39])
_NEAREST, _FARTHEST, _LEAST_DEPTH, _BORDER_PX = 90.0, 160.0, 25.0, 2.0
# Places along the stripe of a board; and columns from one point of it to the next: with all a draw takes long.
_ALONG, _COLUMNS_APART = 6001, 8
# Steps onto a board that is bent; points of a stripe that are one.
_NEWTON, _FEWEST_ALONG = 6, 2
# Where the stripe is seen: 105 to 165 mm deep in the middle of the image.
_PIXELS = np.stack(np.meshgrid([80.0, 320.0, 560.0], [50.0, 100.0, 150.0]), axis=-1).reshape(-1, 2)
_AT_THE_BORDER = np.array([[x, y, 100.0] for x in (-200.0, 0.0, 200.0) for y in (-110.0, 110.0)])


def measure(quick: bool) -> list[Metric]:
    """Draw, solve, compare."""
    with float64():
        camera = Camera.create(rig_2003.IMAGE_SIZE, _FOCAL, _PRINCIPAL, "fisheye", _ANGULAR)
        rig = as_numpy(Rig(camera, (LightPlane.create(_OMEGA),), Linear.create(_PER_STEP)))
    on_stage = Pose(np.array([0.1, -0.15, 0.05]), np.array([-60.0, -62.0, 125.0]))
    session = fisheye_session(
        "montecarlo_fisheye", rig, _poses(rig), on_stage, _PIXELS, {"projected_at_the_border": _AT_THE_BORDER}
    )
    return compared(session, DRAWS_QUICK if quick else _DRAWS, quick)


def fisheye_session(
    stem: str,
    rig: Rig,
    boards: Pose,
    on_stage: Pose,
    pixels: Float[np.ndarray, "points 2"],
    places: Mapping[str, Float[np.ndarray, "points 3"]],
    height: Height = flat,
) -> Session:
    """Boards by themselves, with the stripe, and one on the stage.

    Args:
        stem: how its figures begin.
        rig: the true one.
        boards: T_cam_board of the views, stacked.
        on_stage: T_cam_board of the board on the stage, at step 0.
        pixels: of stripe points to triangulate.
        places: of the camera frame, by names, mm: their pixels are asked for, besides the numbers of each part.
        height: the board's shape.
    """
    steps = _STEPS_APART * np.arange(_STAGE_VIEWS, dtype=float)
    board = _on(rig_2003.BOARD.points()[:, :2], height)
    points, travel = on_stage.apply(board), rig_2003.stage_travel(rig, steps)
    along = tuple(View(f"stage-{i}", project(rig.camera, points + moved)) for i, moved in enumerate(travel))
    views = tuple(
        view_of(i, rig, vector_to_matrix(rotation), translation, height)
        for i, (rotation, translation) in enumerate(zip(boards.rotation, boards.translation, strict=True))
    )
    seen = np.concatenate([view.corners for view in (*views, *along)])
    assert ((seen > 0) & (seen < np.array(rig_2003.IMAGE_SIZE) - 1)).all()
    sequence, lasers = BoardSequence({"stage": steps}, along), tuple(light.name for light in rig.lights)

    def pixels_of(X: Float[np.ndarray, "points 3"]) -> Callable[[Rig], Float[Array, "_"]]:
        return lambda rig: projected(rig, jnp.asarray(X)).ravel()

    return Session(
        stem,
        rig,
        Observations(rig_2003.IMAGE_SIZE, rig_2003.BOARD, views, (sequence,), lasers=lasers),
        boards,
        (on_stage,),
        pixels,
        {"stage": np.full(len(pixels), steps[-1])},
        {
            "focal": lambda rig: leaves(rig.camera.focal),
            "principal_point": lambda rig: leaves(rig.camera.principal),
            "lens": lambda rig: leaves(rig.camera.lens),
            "light_plane": lambda rig: leaves(rig.lights),
            "stage": lambda rig: leaves(rig.axis("stage")),
            **{name: pixels_of(X) for name, X in places.items()},
        },
    )


def _poses(rig: Rig) -> Pose:
    """T_cam_board of boards all over the image, stacked."""
    random, points = np.random.default_rng(2006), rig_2003.BOARD.points()
    size, rotations, translations = np.array(rig.camera.image_size), [], []
    while len(rotations) < _VIEWS:
        rotation = np.array([*random.uniform(-0.6, 0.6, 2), random.uniform(-0.2, 0.2)])
        middle = random.uniform(_NEAREST, _FARTHEST) * np.array(
            [random.uniform(-1.3, 1.3), random.uniform(-0.9, 0.9), 1.0]
        )
        pose = Pose(rotation, middle - vector_to_matrix(rotation) @ points.mean(axis=0))
        X = pose.apply(points)
        if X[:, 2].min() < _LEAST_DEPTH:
            continue
        seen = project(rig.camera, X)
        if ((seen > _BORDER_PX) & (seen < size - 1 - _BORDER_PX)).all():
            rotations.append(rotation)
            translations.append(pose.translation)
    return Pose(np.stack(rotations), np.stack(translations))


def view_of(
    number: int,
    rig: Rig,
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, "3"],
    height: Height = flat,
    columns_apart: int = _COLUMNS_APART,
) -> View:
    """What is seen of the board in a pose without any noise: its corners, and the stripes where flat sheets meet it.

    Column by column, so that a stripe which some column has twice is left out.

    Args:
        number: of the view.
        rig: the true one.
        R: of the board.
        t: of the board, mm.
        height: the board's shape.
        columns_apart: from one stripe point to the next.
    """
    board = rig_2003.BOARD.points()
    corners = project(rig.camera, _on(board[:, :2], height) @ R.T + t)
    stripes = (_stripe(rig, n, R, t, height, columns_apart) for n in range(len(rig.lights)))
    return View(f"view-{number}", corners, stripes=tuple(stripe for stripe in stripes if stripe is not None))


def _stripe(
    rig: Rig, laser: int, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"], height: Height, columns_apart: int
) -> StripePoints | None:
    board = rig_2003.BOARD
    low, high = (
        end[:2] + sign * board.pitch_mm / 2
        for end, sign in ((board.points().min(axis=0), -1), (board.points().max(axis=0), 1))
    )
    # The line a · (x, y) = 1 - ω · t of the board's plane, and from there on to the bent one by Newton's steps.
    omega = np.array([float(leaf) for leaf in jax.tree.leaves(rig.lights[laser])])
    a = omega @ R[:, :2]
    nearest, way = a * (1 - omega @ t) / (a @ a), np.array([-a[1], a[0]]) / np.hypot(*a)
    line = nearest + np.linspace(-300, 300, _ALONG)[:, None] * way
    for _ in range(_NEWTON):
        line = line - (((_on(line, height) @ R.T + t) @ omega - 1) / (a @ a))[:, None] * a
    line = line[((line > low) & (line < high)).all(axis=1)]
    if len(line) < _FEWEST_ALONG:
        return None
    seen = project(rig.camera, _on(line, height) @ R.T + t)
    seen = seen if seen[0, 0] < seen[-1, 0] else seen[::-1]
    if not (np.diff(seen[:, 0]) > 0).all():
        return None
    u, v = seen.T
    columns = np.arange(0.0, rig.camera.image_size[0], columns_apart)
    rows = CubicSpline(u, v, extrapolate=False)(columns)
    # No squares were drawn, so that their edges need not be kept away from.
    there = np.where(np.isfinite(rows), columns, np.nan)
    return StripePoints(np.stack([there, rows], axis=1), laser=laser, half_width_px=1e-6)


def _on(xy: Float[np.ndarray, "points 2"], height: Height) -> Float[np.ndarray, "points 3"]:
    """Points of the board at these places, mm."""
    return np.concatenate([xy, height(xy[:, 0], xy[:, 1])[:, None]], axis=1)
