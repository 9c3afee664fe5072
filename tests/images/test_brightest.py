"""In which colour a stripe is brightest."""

import numpy as np
import pytest

from jaxscan.images import StripeSettings
from jaxscan.images.stripes.brightest import brighter_color

PIXELS = np.column_stack([np.arange(100), np.full(100, 40.0)])
PIXELS[3] = np.nan


def photograph(red: float, ground: tuple[int, int, int] = (60, 60, 60)) -> np.ndarray:
    """A red stripe along row 40."""
    light = red * np.exp(-0.5 * ((np.arange(80)[:, None] - 40) / 2.0) ** 2)
    levels = np.broadcast_to(np.asarray(ground, float), (80, 100, 3)) + light[..., None] * [1.0, 0.1, 0.1]
    return np.rint(levels.clip(0, 255)).astype(np.uint8)


@pytest.mark.parametrize(("color", "found"), [("red", None), ("green", "red"), ("blue", "red"), ("grey", None)])
def test_a_red_stripe(color, found):
    assert brighter_color(photograph(150.0), PIXELS, StripeSettings(color)) == found


def test_a_red_stripe_along_the_columns():
    turned = photograph(150.0).transpose(1, 0, 2)
    assert brighter_color(turned, PIXELS[:, ::-1], StripeSettings("green", columns=False)) == "red"


def test_a_burnt_stripe_on_a_warm_ground_says_nothing():
    """Red was light before, so that it rises least; how much further it would rise is not known."""
    assert brighter_color(photograph(2000.0, (200, 60, 60)), PIXELS, StripeSettings("red")) is None


def test_a_few_points_say_nothing():
    assert brighter_color(photograph(150.0), PIXELS[:15], StripeSettings("green")) is None
