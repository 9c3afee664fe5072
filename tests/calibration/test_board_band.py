"""Where in a photograph the board can be, and stripes on walls behind it."""

import numpy as np
import pytest

from jaxscan.calibration.board_band import board_band
from jaxscan.calibration.observe import stripe_points
from jaxscan.images import StripeSettings
from tests.calibration.synthetic import BOARD, IMAGE_SIZE, board_pose, project


@pytest.mark.parametrize("columns", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_it_covers_the_board_and_its_margin(seed, columns):
    R, t = board_pose(np.random.default_rng(seed))
    seen = project(BOARD.points() @ R.T + t)
    low, high = board_band(BOARD, seen, IMAGE_SIZE, columns=columns)
    # Two pitches beyond the outermost points a stripe may still take part.
    x, y = (np.linspace(-2 * BOARD.pitch_mm, (n + 1) * BOARD.pitch_mm, 40) for n in BOARD.counts)
    plate = np.stack([*np.meshgrid(x, y), np.zeros((40, 40))], axis=-1).reshape(-1, 3)
    pixels = project(plate @ R.T + t)
    line, across = (pixels[:, 0], pixels[:, 1]) if columns else (pixels[:, 1], pixels[:, 0])
    inside = (line >= 0) & (line <= len(low) - 1)
    line, across = np.rint(line[inside]).astype(int), across[inside]
    assert ((across >= low[line] - 1) & (across <= high[line] + 1)).all()
    # And not much more: four pitches beyond, in the middle of a side, is out.
    middle = np.array([[0.5 * (BOARD.counts[0] - 1), -4.5, 0.0]]) * BOARD.pitch_mm
    u, v = project(middle @ R.T + t)[0]
    at, off = (u, v) if columns else (v, u)
    if 0 <= at <= len(low) - 1 and columns:
        assert not low[round(at)] <= off <= high[round(at)]


def test_corners_that_no_homography_follows_say_nothing():
    R, t = board_pose(np.random.default_rng(0))
    seen = project(BOARD.points() @ R.T + t)
    middle = seen.mean(axis=0)
    off = seen - middle
    bent = middle + off * (1 - 3e-5 * (off**2).sum(axis=1, keepdims=True))
    assert board_band(BOARD, bent, IMAGE_SIZE, columns=True) is None
    assert board_band(BOARD, seen, IMAGE_SIZE, columns=True) is not None


def test_lines_beside_the_board_have_no_stripe():
    R, t = board_pose(np.random.default_rng(1))
    small = project(BOARD.points() @ R.T * 0.3 + t)
    low, high = board_band(BOARD, small, IMAGE_SIZE, columns=True)
    assert np.isinf(low[0])
    assert np.isneginf(high[0])
    assert np.isfinite(low[round(small[:, 0].mean())])


@pytest.mark.parametrize("wall", [60.0, 200.0])
def test_the_stripe_on_a_wall_does_not_take_that_on_the_board(wall):
    """The wall's stripe runs through all columns, dimmer or brighter than that on the board."""
    random, columns = np.random.default_rng(2), np.arange(640)
    rows = np.arange(480)[:, None]
    corners = np.stack(np.meshgrid(np.linspace(220, 420, 9), np.linspace(180, 300, 6)), axis=-1).reshape(-1, 2)
    on_board = (columns > 180) & (columns < 460)
    image = 20 + 130 * np.exp(-((rows - 240) ** 2) / 4.5) * on_board + wall * np.exp(-((rows - 420) ** 2) / 4.5)
    photograph = np.clip(random.normal(image, 2.0), 0, 255).astype(np.uint8)
    settings = StripeSettings(color="grey")
    band = board_band(BOARD, corners, (640, 480), columns=True)
    found = stripe_points(photograph, settings, 0, band=band).pixels
    assert np.isfinite(found[200:440, 1]).mean() > 0.98
    np.testing.assert_allclose(found[200:440, 1][np.isfinite(found[200:440, 1])], 240.0, atol=0.5)
    assert not np.isfinite(found[:120, 1]).any()
