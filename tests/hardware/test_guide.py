"""What the guide of a calibration session asks for; the session that comes of it is in `test_end_to_end`."""

import numpy as np

from hardware.guide import Coverage
from jaxscan.simulation import rig_2003


def test_the_guide_asks_for_what_is_missing() -> None:
    board = rig_2003.BOARD
    coverage = Coverage(board)
    assert "fills the middle" in coverage.wish()
    points = board.points()[:, :2]
    coverage.add(points + 100, (640, 480))
    assert "tilt" in coverage.wish()
    assert 0 < coverage.share < 0.5
    x, y = ((points - points.mean(axis=0)) / 60).T
    for lean_x, lean_y in ((0.4, 0), (-0.4, 0), (0, 0.8), (0, -0.8)):
        depth = 1 + lean_x * x + lean_y * y
        coverage.add(np.stack([320 + 60 * x / depth, 240 + 60 * y / depth], axis=1), (640, 480))
    assert "now move the board to the upper" in coverage.wish()
