"""Circles to the centres of gravity of their images, whatever their size and the board's tilt."""

import cv2
import numpy as np
import pytest
import render

from jaxscan.images import Board
from jaxscan.images.circles import radius_in_pitches, refine_circles

SHAPE = (180, 240)
BOARD = Board.circles((5, 4), 10.0)
_TURNS = np.linspace(0, 2 * np.pi, 720, endpoint=False)


def seen(tilt):
    """The homography of the board turned about its upright, from millimetres to pixels."""
    R = cv2.Rodrigues(np.array([0.05, tilt, 0.1]))[0]
    t = np.array([0, 0, 95.0]) - R @ BOARD.points().mean(axis=0)
    return np.array([[300.0, 0, 119.5], [0, 300.0, 89.5], [0, 0, 1]]) @ np.column_stack([R[:, 0], R[:, 1], t])


def centres_of_gravity(H, radius):
    """The centres of gravity of the images of all circles, taken as polygons, px."""
    outline = radius * np.stack([np.cos(_TURNS), np.sin(_TURNS), 0 * _TURNS], axis=-1)
    at = render.project(H, (BOARD.points()[:, None] + outline).reshape(-1, 3)).reshape(-1, len(_TURNS), 2)
    middle = at.mean(axis=1)
    x, y = np.moveaxis(at - middle[:, None], -1, 0)
    cross = x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y
    moments = [((c + np.roll(c, -1, 1)) * cross).sum(1) / (3 * cross.sum(1)) for c in (x, y)]
    return (middle + np.stack(moments, axis=-1)).reshape(4, 5, 2)


@pytest.mark.parametrize(
    ("part", "tilt", "bound"),
    [(0.25, 0.1, 0.015), (0.5, 0.9, 0.01), (0.7, 0.9, 0.01), (0.85, 0.6, 0.01), (0.85, 0.9, 0.01), (0.93, 0.6, 0.02)],
)
def test_small_and_large_circles_on_tilted_boards(part, tilt, bound):
    """`part` is the diameter in pitches: tilted, large circles are longer than the distance to the nearest one."""
    H = seen(tilt)
    image = render.photograph(render.circles(BOARD.counts, 10.0, 5 * part), H, SHAPE, blur=0.7, noise=1.0)
    start = render.project(H, BOARD.points()).reshape(4, 5, 2) + 0.3
    found = refine_circles(np.rint(image).clip(0, 255).astype(np.uint8), start)
    off = np.linalg.norm(found[..., :2] - centres_of_gravity(H, 5 * part), axis=-1)
    assert np.sqrt(np.mean(off**2)) < bound
    np.testing.assert_allclose(radius_in_pitches(found), part / 2, rtol=0.02)


def test_a_circle_that_the_border_cuts_is_none():
    H = seen(0.1)
    image = render.photograph(render.circles(BOARD.counts, 10.0, 3.5), H, SHAPE, blur=0.7)
    start = render.project(H, BOARD.points()).reshape(4, 5, 2)
    cut = int(start[:, 1, 0].max())
    found = refine_circles(np.rint(image).astype(np.uint8)[:, : cut + 3], start)
    assert np.isfinite(found[:, 0]).all()
    assert np.isnan(found[:, 1]).all()
