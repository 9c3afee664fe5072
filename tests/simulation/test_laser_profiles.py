"""Cross-sections of the laser's light, as numbers and in photographs."""

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.images import Board
from jaxscan.rig import Rig
from jaxscan.simulation.laser_profiles import LASER_PROFILES, bells
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.shapes import board_plate

DARK = (0.0, 0.0, 0.0)
X = np.linspace(-30, 30, 6001)
_PARTS = (0.9, 1.1), (0.1, 0.9)


def profile(kind: str) -> np.ndarray:
    return sum(height * np.exp(-0.5 * ((X - place) / sigma) ** 2) for height, place, sigma in bells(kind))


@pytest.mark.parametrize("kind", LASER_PROFILES)
def test_peak_and_centre_of_gravity(kind: str) -> None:
    p = profile(kind)
    assert p.max() == pytest.approx(1, abs=1e-4)
    assert (X * p).sum() / p.sum() == pytest.approx(0, abs=1e-6)


def test_each_kind_is_what_it_is_called() -> None:
    np.testing.assert_array_equal(bells("gaussian"), [[1, 0, 1]])
    bell, flat, two, skewed, halo, lobe = (profile(kind) for kind in LASER_PROFILES)
    # How much of the cross-section is top, against its flanks.
    tops, flanks = (np.array([np.mean((p > low) & (p <= high)) for p in (bell, flat)]) for low, high in _PARTS)
    assert (tops / flanks)[1] > 2 * (tops / flanks)[0]
    assert two[len(X) // 2] < 0.6 < 0.99 < two.max()
    assert (skewed * X**3).sum() > 0
    assert halo[np.abs(X) > 4].max() > 0.05
    rises = np.flatnonzero(np.diff(np.sign(np.diff(lobe))) < 0)
    assert len(rises) == 2
    assert lobe[rises].min() == pytest.approx(0.15, abs=0.03)


@pytest.mark.parametrize("kind", LASER_PROFILES)
def test_photographs_show_the_cross_section(rig: Rig, kind: str) -> None:
    wall = board_plate(Board.checkerboard((4, 3), 16.0), margin_mm=300, ink=1.0, white=1.0)
    scene = Scene((wall.moved(np.eye(3), np.array([0.0, 0.0, 300.0])),), DARK)
    light = Lighting(0, 0, laser_power=200.0, sheet_sigma_mm=6.0, laser_profile=kind, laser_colour=(1, 1, 1))
    column = render(rig, scene, laser=0, lighting=light, sensor=Sensor(0.0, 0.0, bits=16))[:, 80, 0].astype(float)
    # Distance of the wall from the sheet along the column, in units of its σ.
    omega = np.array([0.0, -0.00494, 0.00303])
    rows = (np.arange(120) - 57.0) / 172.6
    d = (300 * (omega[1] * rows + omega[2]) - 1) / np.linalg.norm(omega) / 6.0
    expected = np.interp(d, X, profile(kind))
    np.testing.assert_allclose(column / column.max(), expected / expected.max(), atol=0.02)


def test_what_is_no_profile_is_refused() -> None:
    with pytest.raises(InputError, match='laser_profile = "square": give one of gaussian, flat-top'):
        Lighting(laser_profile="square")
