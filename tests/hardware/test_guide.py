"""What the guide of a calibration session asks for; the session that comes of it is in `test_end_to_end`."""

import numpy as np

from hardware.coverage import ViewsSoFar, draw_coverage
from jaxscan.simulation import rig_2003


def test_the_guide_asks_for_what_is_missing() -> None:
    board = rig_2003.BOARD
    views = ViewsSoFar(board)
    assert "fills the middle" in views.wish()
    points = board.points()[:, :2]
    views.add(points + 100, (640, 480))
    assert "tilt" in views.wish()
    assert 0 < views.share < 0.5
    x, y = ((points - points.mean(axis=0)) / 60).T
    for lean_x, lean_y in ((0.4, 0), (-0.4, 0), (0, 0.8), (0, -0.8)):
        depth = 1 + lean_x * x + lean_y * y
        views.add(np.stack([320 + 60 * x / depth, 240 + 60 * y / depth], axis=1), (640, 480))
    assert "now move the board to the upper" in views.wish()
    assert views.tilted == dict.fromkeys(("right", "left", "lower", "upper"), True)


def test_covered_cells_are_drawn_where_they_are() -> None:
    views = ViewsSoFar(rig_2003.BOARD)
    corners = np.full((len(rig_2003.BOARD.points()), 2), np.nan)
    # The last pixel of a cell, the first of the next, and the edges of the image.
    corners[:6] = [(159, 100), (160, 200), (639.4, 479.4), (-0.4, 479), (10, 10), (20, 20)]
    views.add(corners, (640, 480))
    assert np.argwhere(views.covered).tolist() == [[0, 0], [1, 1], [2, 0], [2, 3]]
    shown = draw_coverage(np.zeros((480, 640, 3), np.uint8), views.covered)
    tint = shown[80::160, 80::160]
    assert np.array_equal(tint[..., 1] > 20, views.covered)
