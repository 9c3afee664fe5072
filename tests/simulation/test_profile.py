"""True profiles against closed forms."""

import cv2
import numpy as np
import pytest

from jaxscan.rig import Rig
from jaxscan.simulation.light import Lighting
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import floor, grey
from jaxscan.simulation.solids import Box, Sphere

OMEGA = np.array([0.0, -0.00494, 0.00303])
FLOOR_Z = 320.0


def flat() -> Body:
    """A floor across the optical axis, fixed."""
    turned = np.diag([1.0, -1.0, -1.0])
    body = floor((-50, -80), (60, 80)).moved(turned, np.array([0.0, 0.0, FLOOR_Z]))
    return Body(body.shape, body.albedo, on_stage=False)


def to_pixels(rig: Rig, points: np.ndarray) -> np.ndarray:
    f, c = (np.array([float(x) for x in pair]) for pair in (rig.camera.focal, rig.camera.principal))
    K = np.array([[f[0], 0, c[0]], [0, f[1], c[1]], [0, 0, 1]])
    k1 = float(rig.camera.lens.radial[0])
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array([k1, 0, 0, 0]))[0].reshape(-1, 2)


def test_floor_through_a_lens(lens_rig: Rig) -> None:
    profile = true_profile(lens_rig, Scene((flat(),)), {"stage": 500})
    seen = np.isfinite(profile.position)
    y = (1 - OMEGA[2] * FLOOR_Z) / OMEGA[1]
    x = np.linspace(-50, 60, 2001)
    u, v = to_pixels(lens_rig, np.column_stack([x, np.full(2001, y), np.full(2001, FLOOR_Z)])).T
    np.testing.assert_array_equal(np.flatnonzero(seen), np.arange(np.ceil(u[0]), np.floor(u[-1]) + 1))
    np.testing.assert_allclose(profile.position[seen], np.interp(np.flatnonzero(seen), u, v), atol=1e-5)
    # Points are in the object frame: the floor does not stand on the stage, so it seems to have moved back.
    moved = profile.points[seen] + 500 * np.array([0.00003, 0.00092, -0.00039])
    np.testing.assert_allclose(moved @ OMEGA, 1, atol=1e-9)
    np.testing.assert_allclose(moved[:, 2], FLOOR_Z, atol=1e-9)


def test_points_are_seen_where_they_are_said_to_be(lens_rig: Rig) -> None:
    ball = Body(Sphere(np.array([5.0, -14.0, 300.0]), 18.0), grey(0.6))
    for steps in (0, 4000):
        profile = true_profile(lens_rig, Scene((flat(), ball)), {"stage": steps})
        seen = np.flatnonzero(np.isfinite(profile.position))
        shift = steps * np.array([0.00003, 0.00092, -0.00039])
        pixels = to_pixels(lens_rig, profile.points[seen] + shift)
        np.testing.assert_allclose(pixels, np.column_stack([seen, profile.position[seen]]), atol=1e-6)
        on_ball = np.abs(np.linalg.norm(profile.points[seen] - [5.0, -14.0, 300.0], axis=1) - 18) < 1e-9
        on_floor = np.abs((profile.points[seen] + shift)[:, 2] - FLOOR_Z) < 1e-9
        assert (on_ball | on_floor).all()
        assert on_ball.sum() > 5
        assert on_floor.sum() > 5


def test_outlines_and_shadows_give_no_points(rig: Rig) -> None:
    box = Body(Box(np.array([0.0, 0.0, 305.0]), np.eye(3), np.array([12.0, 30.0, 14.9])), grey(0.6))
    scene = Scene((flat(), box))
    source = (-150.0, 1 / OMEGA[1], 0.0)
    profile = true_profile(rig, scene, lighting=Lighting(laser_source=source))
    seen = np.isfinite(profile.position)
    depths = profile.points[seen, 2]
    # Nothing but the floor and the top of the box: its sides are never lit and seen at once.
    assert (np.isclose(depths, FLOOR_Z) | np.isclose(depths, 290.1)).all()
    # The right upper edge of the box throws the end of the shadow on the floor.
    edge_y = (1 - OMEGA[2] * 290.1) / OMEGA[1]
    edge = np.array([12.0, edge_y, 290.1])
    shadow = np.asarray(source) + (edge - source) * FLOOR_Z / 290.1
    column = to_pixels(rig, shadow[None])[0, 0]
    top_end = to_pixels(rig, edge[None])[0, 0]
    columns = np.arange(len(seen))
    assert not seen[(columns > top_end) & (columns < column)].any()
    assert seen[(columns > column) & (columns < column + 5)].all()
    assert column - top_end > 3


def test_rows_in_place_of_columns(rig: Rig) -> None:
    from dataclasses import replace

    from jaxscan.precision import as_numpy, float64
    from jaxscan.rig import LightPlane

    with float64():
        across = as_numpy(LightPlane.create(np.array([-0.005, 0.0, 0.003])))
    profile = true_profile(replace(rig, lights=(across,)), Scene((flat(),)), columns=False)
    seen = np.isfinite(profile.position)
    assert profile.position.shape == (120,)
    assert seen.sum() > 50
    x = (1 - 0.003 * FLOOR_Z) / -0.005
    np.testing.assert_allclose(profile.points[seen, 0], x, atol=1e-9)
    np.testing.assert_allclose(to_pixels(rig, profile.points[seen])[:, 1], np.flatnonzero(seen), atol=1e-6)


def test_a_sheet_that_meets_nothing(rig: Rig) -> None:
    far_away = Body(Sphere(np.array([0.0, 0.0, 3000.0]), 10.0), grey(0.5))
    profile = true_profile(rig, Scene((far_away,)))
    assert np.isnan(profile.position).all()
    assert profile.points.shape == (160, 3)
    assert np.isnan(profile.points).all()


@pytest.mark.parametrize("steps", [0, 20000])
def test_same_points_whatever_the_light(rig: Rig, steps: int) -> None:
    scene = Scene((flat(),))
    a, b = (true_profile(rig, scene, {"stage": steps}, lighting=Lighting(laser_power=p)) for p in (10.0, 2000.0))
    np.testing.assert_array_equal(a.points, b.points)
