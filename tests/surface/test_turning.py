"""The surface of an object that was turned once all around."""

import numpy as np
import pytest

from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.shapes import figure
from jaxscan.surface.floor import find_floor
from jaxscan.surface.side import error_direction
from jaxscan.surface.triangles import grid_surface


@pytest.fixture(scope="module")
def turning():
    """The true points of the figure, 50 frames, 64 steps of 3200 apart."""
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(3), 3)
    q = {axis: np.array(steps) for axis, steps in rig_2003.turning_axes(64).items()}
    return drawn_scan(rig, rig_2003.scan_scene(rig, figure(rig_2003.OBJECT_Y)), q, 0.05)


def test_points_are_those_of_the_object(turning):
    valid = turning.image.valid
    assert valid.sum() > 5000
    off = np.linalg.norm(turning.image.points[valid] - turning.points[valid], axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.15


def test_the_last_frame_is_joined_to_the_first(turning):
    image = turning.image
    frames, columns = image.valid.shape
    surface = grid_surface(image)
    frame = surface.place[surface.triangles] // columns
    seam = (frame == 0).any(axis=1) & (frame == frames - 1).any(axis=1)
    inside = (frame == 20).any(axis=1) & (frame == 21).any(axis=1)
    assert seam.sum() > 0.5 * inside.sum() > 100
    # One place has one vertex, whichever frame it is reached from.
    assert len(np.unique(surface.place)) == len(surface.place)
    half = image[:25, :]
    assert half.closed() is half
    there = grid_surface(half)
    apart = np.abs(np.diff(there.place[there.triangles] // columns, axis=1)).max()
    assert apart == 1


def test_a_stripes_error_moves_a_point_within_the_sheet_as_it_stood(turning):
    image = turning.image
    e = error_direction(image)[image.valid]
    at = image.from_camera()
    frame = np.nonzero(image.valid)[0]
    seen = np.einsum("pji,pj->pi", at.matrix()[frame], e)
    normal = np.array([float(x) for x in image.sheet.plane])
    assert np.abs(seen @ normal).max() < 1e-6 * np.linalg.norm(normal) * 1e3
    np.testing.assert_allclose(np.linalg.norm(e, axis=1), 1)


def test_the_platform_is_its_floor(turning):
    floor = find_floor(turning.image)
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(3), 3)
    up = rig_2003.platform(rig)[0][:, 2]
    assert floor.up @ up > np.cos(np.radians(0.5))
