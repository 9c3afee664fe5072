"""Which stripe points lie on the board, and where.

A stripe runs on beyond the board's plate, onto a table or a background, where it says nothing of the board's plane. So
only what falls on the pattern and a margin around it is used; what is on the margin but not on the plate is left to
the robust solve. Where the reflectance changes within the stripe's own width, at the edge of a square that runs along
the stripe, its centre is pulled to the bright side: such points are left out too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.observations import Observations, StripePoints, Unused
from jaxscan.geometry import Pose, dual_plane_of
from jaxscan.images import Board
from jaxscan.rig import Camera
from jaxscan.rig.board_shape import BentBoard
from jaxscan.rig.projection import pixel_rays

# How far beyond the outermost points the board is taken to reach, in pitches: the outer squares and their quiet zone.
_MARGIN = 2.0


def stripe_on_board(observations: Observations, camera: Camera, poses: Pose[np.ndarray]) -> tuple[Observations, Unused]:
    """The observations with only those stripe points that lie on their board; the others become NaN.

    Args:
        observations: the photographs.
        camera: the camera.
        poses: T_cam_board of each photograph, in their order.

    Returns:
        The observations, and in words how many points of which photograph do not take part.
    """
    photographs, unused = [], Unused()
    for i, view in enumerate(observations.photographs()):
        stripes, points, off, edge = [], 0, 0, 0
        for stripe in view.stripes:
            seen = np.isfinite(stripe.pixels).all(axis=1)
            at, before, after = _board_positions(camera, pose_of(poses, i), stripe)
            inside = seen & _inside(observations.board, at)
            clean = inside & _same_reflectance(observations.board, at, before, after)
            points += int(seen.sum())
            off += int((seen & ~inside).sum())
            edge += int((inside & ~clean).sum())
            stripes.append(replace(stripe, pixels=np.where(clean[:, None], stripe.pixels, np.nan)))
        where = [f"{n} {place}" for n, place in ((off, "beyond the board"), (edge, "at the edges of squares")) if n]
        if where:
            none_left = "; none is left" if off + edge == points else ""
            line = f"{view.name}: of {points} stripe points {' and '.join(where)}{none_left}"
            unused = unused.add(line, wholly=bool(none_left))
        photographs.append(replace(view, stripes=tuple(stripes)))
    return observations.with_photographs(photographs), unused


def stripe_points_in_space(
    observations: Observations,
    camera: Camera,
    poses: Pose[np.ndarray],
    laser: int,
    bent: Sequence[BentBoard] | None = None,
) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """Where the stripes of one laser lie in the camera frame (mm), by their boards.

    With the photograph of each point, and the position of the axis that moves the light, motor steps.

    Args:
        observations: the photographs.
        camera: the camera.
        poses: T_cam_board of each photograph, in their order.
        laser: which of the observations' lasers.
        bent: the board of each photograph, where it is not flat.
    """
    points, photograph, position = [np.zeros((0, 3))], [np.zeros(0, int)], [np.zeros(0)]
    for i, each in enumerate(observations.photographs()):
        for stripe in each.stripes:
            if stripe.laser == laser:
                X, _ = meet_board(camera, pose_of(poses, i), stripe.pixels, bent[i] if bent else None)
                X = X[np.isfinite(X).all(axis=1)]
                points.append(X)
                photograph.append(np.full(len(X), i))
                position.append(np.full(len(X), stripe.position))
    return np.concatenate(points), np.concatenate(photograph), np.concatenate(position)


def pose_of(poses: Pose[np.ndarray], i: int) -> Pose[np.ndarray]:
    """One of a stack."""
    return Pose(poses.rotation[i], poses.translation[i])


def _board_positions(
    camera: Camera, pose: Pose[np.ndarray], stripe: StripePoints
) -> Iterator[Float[np.ndarray, "points 2"]]:
    """Board coordinates (mm) of each stripe point, and half a stripe's width before and after it."""
    reach = stripe.half_width_px * (np.array([0.0, 1.0]) if stripe.columns else np.array([1.0, 0.0]))
    shifted = np.concatenate([stripe.pixels, stripe.pixels - reach, stripe.pixels + reach])
    yield from np.split(meet_board(camera, pose, shifted)[1][:, :2], 3)


def meet_board(
    camera: Camera, pose: Pose[np.ndarray], pixels: Float[np.ndarray, "points 2"], bent: BentBoard | None = None
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Where pixels' rays meet the board, flat or bent: in the camera frame and in the board frame (mm), or NaN."""
    x, R, t = pixel_rays(camera, pixels), pose.matrix(), pose.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        w = x @ dual_plane_of(R, t) if bent is None else bent.inverse_depth(x)
        X = x / np.where(w > 0, w, np.nan)[:, None]
    return X, (X - t) @ R


def _inside(board: Board, at: Float[np.ndarray, "points 2"]) -> Bool[np.ndarray, "points"]:
    reach = _MARGIN * board.pitch_mm
    furthest = (np.asarray(board.counts) - 1) * board.pitch_mm
    with np.errstate(invalid="ignore"):
        return np.all((at > -reach) & (at < furthest + reach), axis=1)


def _same_reflectance(
    board: Board,
    at: Float[np.ndarray, "points 2"],
    before: Float[np.ndarray, "points 2"],
    after: Float[np.ndarray, "points 2"],
) -> Bool[np.ndarray, "points"]:
    """Whether a stripe lies on one colour over its whole width; known for a checkerboard alone."""
    if board.kind != "checkerboard":
        return np.ones(len(at), bool)
    return (_colour(board, at) == _colour(board, before)) & (_colour(board, at) == _colour(board, after))


def _colour(board: Board, at: Float[np.ndarray, "points 2"]) -> Int[np.ndarray, "points"]:
    """Of a checkerboard: 1 on a dark square, 0 on a light one, and what the margin is."""
    columns, rows = board.counts
    # The square diagonally outside the first corner is dark wherever an order of the corners can make it so; where it
    # cannot, the margin counts as a colour of its own.
    first_is_dark = (columns + rows) % 2 == 1 or (columns == rows and columns % 2 == 1)
    cell = np.floor(np.nan_to_num(at) / board.pitch_mm).astype(int)
    printed = np.all((cell >= -1) & (cell < np.asarray(board.counts)), axis=1)
    dark = cell.sum(axis=1) % 2 == 0
    return np.where(printed, dark, 0 if first_is_dark else 2).astype(int)
