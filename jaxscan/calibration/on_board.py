"""Which stripe points lie on the board, and where.

A stripe runs on beyond the board's plate, onto a table or a background, where it says nothing of the board's plane. So
only what falls on the pattern and a margin around it is used; what is on the margin but not on the plate is left to
the robust solve. Where the reflectance changes within the stripe's own width, at the edge of a square that runs along
the stripe, its centre is pulled to the bright side: such points are left out too.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.calibration.observations import Observations, StripePoints, Unused
from jaxscan.geometry import Pose, dual_plane
from jaxscan.images import Board
from jaxscan.rig import Camera

# How far beyond the outermost points the board is taken to reach, in pitches: the outer squares and their quiet zone.
_MARGIN = 2.0


def stripe_on_board(
    observations: Observations, camera: Camera, poses: Float[Array, "blocks 6"]
) -> tuple[Observations, Unused]:
    """The observations with only those stripe points that lie on their board; the others become NaN.

    Returns:
        The observations, and in words how many points of which view do not take part.
    """
    views, unused = [], Unused()
    for i, view in enumerate(observations.views):
        stripes, points, off, edge = [], 0, 0, 0
        for stripe in view.stripes:
            seen = np.isfinite(stripe.pixels).all(axis=1)
            at, before, after = _board_positions(camera, poses[i], stripe)
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
        views.append(replace(view, stripes=tuple(stripes)))
    return replace(observations, views=tuple(views)), unused


def stripe_points_in_space(
    observations: Observations, camera: Camera, poses: Float[Array, "blocks 6"], laser: int
) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "points"]]:
    """Where the stripes of one laser lie in the camera frame (mm), by their boards, and the view of each."""
    points, view = [np.zeros((0, 3))], [np.zeros(0, int)]
    for i, each in enumerate(observations.views):
        for stripe in each.stripes:
            if stripe.laser != laser:
                continue
            X, _ = _meet_board(camera, poses[i], _padded(stripe.pixels))
            X = np.asarray(X)[: len(stripe.pixels)]
            X = X[np.isfinite(X).all(axis=1) & (X[:, 2] > 0)]
            points.append(X)
            view.append(np.full(len(X), i))
    return np.concatenate(points), np.concatenate(view)


def _board_positions(camera: Camera, pose: Float[Array, "6"], stripe: StripePoints) -> Any:
    """Board coordinates (mm) of each stripe point, and half a stripe's width before and after it."""
    n = len(stripe.pixels)
    along = np.array([0.0, 1.0]) if stripe.columns else np.array([1.0, 0.0])
    reach = stripe.half_width_px * along
    return (
        np.asarray(_meet_board(camera, pose, _padded(stripe.pixels + shift))[1])[:n, :2]
        for shift in (0 * reach, -reach, reach)
    )


def _padded(pixels: Float[np.ndarray, "points 2"]) -> Float[Array, "padded 2"]:
    """To a multiple of 256, so that stripes of different length share one compiled function."""
    return jnp.asarray(np.pad(pixels, ((0, -len(pixels) % 256), (0, 0)), constant_values=np.nan))


@eqx.filter_jit
def _meet_board(
    camera: Camera, pose: Float[Array, "6"], pixels: Float[Array, "points 2"]
) -> tuple[Float[Array, "points 3"], Float[Array, "points 3"]]:
    """Where pixels' rays meet the board: in the camera frame and in the board frame (mm)."""
    T = Pose.from_vector(pose)
    x = jax.vmap(camera.ray)(pixels)
    X = x / (x @ dual_plane(T))[:, None]
    return X, (X - T.translation[None]) @ T.matrix()


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

    columns, rows = board.counts
    # The square diagonally outside the first corner is dark wherever an order of the corners can make it so; where it
    # cannot, the margin counts as a colour of its own.
    first_is_dark = (columns + rows) % 2 == 1 or (columns == rows and columns % 2 == 1)

    def colour(x: Float[np.ndarray, "points 2"]) -> Int[np.ndarray, "points"]:
        cell = np.floor(np.nan_to_num(x) / board.pitch_mm).astype(int)
        printed = np.all((cell >= -1) & (cell < np.asarray(board.counts)), axis=1)
        dark = cell.sum(axis=1) % 2 == 0
        return np.where(printed, dark, 0 if first_is_dark else 2).astype(int)

    return (colour(at) == colour(before)) & (colour(at) == colour(after))
