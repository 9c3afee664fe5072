"""Patterns at places that are known, and the plate's edges."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.observe import observe
from jaxscan.errors import InputError
from jaxscan.files.session import read_session
from jaxscan.images import Board
from jaxscan.precision import float64
from jaxscan.simulation.bent_plate import BentPlate
from jaxscan.simulation.folders import simulate_session
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


@pytest.fixture
def bent_board() -> BentPlate:
    plate = (
        board_plate(Board.checkerboard((9, 6), 16.0), bend_mm=0.4).moved(np.eye(3), np.array([1.0, 2.0, 300.0])).shape
    )
    assert isinstance(plate, BentPlate)
    return plate


def test_a_bent_plate_is_a_cylinder(bent_board: BentPlate) -> None:
    random = np.random.default_rng(0)
    direction = np.array([*random.uniform(-0.15, 0.25, (2, 400)), np.ones(400)])
    with float64():
        rays = Rays(Vec(jnp.zeros(400), jnp.zeros(400), jnp.zeros(400)), Vec(*jnp.asarray(direction)))
        t, patch = bent_board.meet(rays)
        points = np.asarray(t) * direction
        met = np.isfinite(points[2])
        assert 200 < met.sum() < 400
        x = points[:, met] - np.array([1.0, 2.0, 300.0])[:, None]
        u = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)]) @ (x[:2] - np.array([[64.0], [40.0]]))
        r = (64.0**2 + 0.4**2) / 0.8
        np.testing.assert_allclose(u**2 + (x[2] - r) ** 2, r**2, rtol=1e-12)
        normal = bent_board.normal_at(Vec(*jnp.asarray(points[:, met])), patch[met])
        expected = np.array([-u * np.cos(np.pi / 6), -u * np.sin(np.pi / 6), r - x[2]]) / r
        np.testing.assert_allclose(np.stack(normal), expected, atol=1e-12)
    # Over the 128 mm of a row its middle is 0.4 mm off the ends of the bend.
    assert np.ptp(x[2][np.abs(u) < 64]) == pytest.approx(0.4, abs=0.03)


def test_a_pattern_keeps_its_lengths_on_a_bent_plate(bent_board: BentPlate) -> None:
    strong = board_plate(Board.checkerboard((9, 6), 16.0), bend_mm=5.0).shape
    assert isinstance(strong, BentPlate)
    with float64():
        # Where the paper's u is 60 mm, the cylinder's is r sin(60 / r).
        u = strong.radius * np.sin(60 / strong.radius)
        point = strong.middle + u * strong.across
        paper = strong._paper(Vec(*(jnp.asarray([c]) for c in (*point, 0.0))))
    np.testing.assert_allclose(np.stack(paper)[:2, 0], strong.middle + 60 * strong.across, atol=1e-9)


def test_a_photographed_board_is_bent_as_it_was_drawn(tmp_path) -> None:
    """0.3 mm across its rows; 30° askew its corners reach further, by 64 cos 30° + 40 sin 30° for 64 mm, squared."""
    simulate_session(tmp_path, 3, bend_mm=0.3, views=7, stage_views=5)
    found = calibrate(observe(read_session(tmp_path)))
    assert found.flatness is not None
    half = 64 * np.cos(np.pi / 6) + 40 * np.sin(np.pi / 6)
    assert found.flatness.bent_mm == pytest.approx(0.3 * (half / 64) ** 2, rel=0.1)


def test_a_plate_that_hardly_bends_is_flat() -> None:
    flat, nearly = (board_plate(Board.checkerboard((9, 6), 16.0), bend_mm=mm).shape for mm in (0.0, 1e-7))
    random = np.random.default_rng(0)
    direction = jnp.asarray(np.array([*random.uniform(-0.1, 0.4, (2, 200)), np.ones(200)]))
    with float64():
        rays = Rays(Vec(*jnp.full((3, 200), -1.0)), Vec(*direction))
        for a, b in zip(flat.meet(rays), nearly.meet(rays), strict=True):
            np.testing.assert_allclose(np.asarray(b), np.asarray(a), atol=1e-6)
