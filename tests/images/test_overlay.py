import numpy as np
import pytest

from jaxscan.images.overlay import draw_board, draw_stripe


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(60, 80), (60, 80, 3)])
def test_a_stripe_is_drawn_where_it_is(dtype, shape):
    image = np.full(shape, 30, dtype)
    stripe = np.full(80, 20.0)
    stripe[40:] = np.nan
    picture = draw_stripe(image, stripe, columns=True)
    assert picture.shape == (60, 80, 3)
    assert picture.dtype == np.uint8
    green = (picture[..., 1].astype(int) - picture[..., 0]) > 60
    assert green[20, 2:38].all()
    assert not green[:, 44:].any()
    assert not green[30:].any()
    turned = draw_stripe(np.swapaxes(image, 0, 1), stripe, columns=False)
    assert ((turned[..., 1].astype(int) - turned[..., 0]) > 60)[2:38, 20].all()
    assert turned.shape == (80, 60, 3)
    assert (image == 30).all()


def test_a_dark_photograph_is_brightened_and_a_light_one_is_not():
    nothing = np.full(80, np.nan)
    assert draw_stripe(np.full((60, 80), 12, np.uint8), nothing, columns=True).mean() > 60
    np.testing.assert_array_equal(draw_stripe(np.full((60, 80), 150, np.uint8), nothing, columns=True), 150)
    np.testing.assert_array_equal(draw_stripe(np.zeros((60, 80), np.uint8), nothing, columns=True), 0)


def test_a_board_is_drawn_without_the_corners_that_were_not_seen():
    corners = np.stack(np.meshgrid([40.0, 100.0, 160.0], [40.0, 100.0, 160.0]), axis=-1).reshape(-1, 2)
    corners[8] = np.nan
    picture = draw_board(np.full((200, 200), 90, np.uint8), corners, (3, 3))
    changed = (picture != 90).any(axis=-1)
    assert changed[40, 40]
    assert changed[100, 160]
    assert not changed[145:, 145:].any()
