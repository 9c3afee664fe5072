"""Patterns at places that are known, and the plate's edges."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.images import Board
from jaxscan.precision import float64
from jaxscan.simulation.plate import Checks, Circles, Plate
from jaxscan.simulation.shapes import board_plate
from jaxscan.simulation.vector import Rays, Vec


def dark(pattern: Checks | Circles, x: float, y: float) -> bool:
    return bool(pattern.dark(jnp.asarray(x), jnp.asarray(y)))


def test_checks() -> None:
    checks = Checks(np.array([9, 6]), 16.0)
    assert dark(checks, -1, -1)
    assert dark(checks, 1, 1)
    assert not dark(checks, 1, -1)
    assert not dark(checks, -1, 1)
    # The last square is at 8 and 5, one more than the last corner; beyond it all is white.
    assert dark(checks, 8 * 16 + 1, 4 * 16 + 1)
    assert not dark(checks, 8 * 16 + 1, 5 * 16 + 1)
    assert dark(checks, 7 * 16 + 1, 5 * 16 + 15)
    assert not dark(checks, 7 * 16 + 1, 6 * 16 + 1)
    assert not dark(checks, -17, -1)


def test_circles() -> None:
    circles = Circles(np.array([7, 5]), 10.0, 3.0)
    assert dark(circles, 0, 2.9)
    assert not dark(circles, 0, 3.1)
    assert dark(circles, 60, 40)
    assert not dark(circles, 70, 40)
    assert not dark(circles, -10, 0)


def test_plate_ends_where_it_ends() -> None:
    plate = board_plate(Board.checkerboard((9, 6), 16.0), margin_mm=8).shape
    assert isinstance(plate, Plate)
    with float64():
        x = jnp.asarray([-23.9, -24.1, 8 * 16 + 23.9, 8 * 16 + 24.1])
        rays = Rays(Vec(x, jnp.zeros(4), jnp.full(4, -50.0)), Vec(jnp.zeros(4), jnp.zeros(4), jnp.ones(4)))
        t, _ = plate.meet(rays)
    np.testing.assert_array_equal(np.asarray(t), [50, np.inf, 50, np.inf])


def test_charuco_is_refused() -> None:
    with pytest.raises(InputError, match="charuco"):
        board_plate(Board.charuco((7, 5), 10.0, 7.0, "DICT_4X4_50"))
