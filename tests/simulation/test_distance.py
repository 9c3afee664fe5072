"""Distances against closed forms."""

from itertools import pairwise

import numpy as np
import pytest

from jaxscan.simulation.distance import distance
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import box, cup, floor, grey, sphere, stair
from jaxscan.simulation.solids import Cylinder, Sphere


def points(n: int, low: list[float], high: list[float], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (n, 3))


def test_sphere_and_floor() -> None:
    scene = Scene((sphere(10.0, radius=25.0), floor((-80, -80), (80, 80))))
    x = points(3000, [-60, -60, -5], [60, 60, 60])
    from_ball = np.abs(np.linalg.norm(x - [0, 10, 25], axis=1) - 25)
    np.testing.assert_allclose(distance(scene, x), np.minimum(from_ball, np.abs(x[:, 2])), atol=1e-9)


def test_box_inside_and_outside() -> None:
    x = points(2000, [-50, -50, -30], [50, 50, 60])
    away = np.abs(x - [0, 5, 15]) - [30, 20, 15]
    expected = np.where((away < 0).all(1), -away.max(1), np.linalg.norm(np.maximum(away, 0), axis=1))
    np.testing.assert_allclose(distance(Scene((box(5.0),)), x), expected, atol=1e-9)


def test_cylinder_with_its_rims() -> None:
    base, axis = np.array([3.0, -2.0, 1.0]), np.array([0.0, 0.6, 0.8])
    scene = Scene((Body(Cylinder(base, axis, 30.0, 20.0), grey(0.5)),))
    random = np.random.default_rng(3)
    # Within 6 mm of the surface, a fifth of the rim's radius.
    along, angle = random.uniform(-6, 26, 3000), random.uniform(0, 2 * np.pi, 3000)
    radius = random.uniform(0, 36, 3000)
    side = np.array([1.0, 0.0, 0.0])
    x = base + along[:, None] * axis
    x = x + radius[:, None] * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side))
    p, q = radius - 30, np.abs(along - 10) - 10
    outside = np.hypot(np.maximum(p, 0), np.maximum(q, 0))
    expected = np.where((p < 0) & (q < 0), -np.maximum(p, q), outside)
    near = expected < 6
    np.testing.assert_allclose(distance(scene, x[near]), expected[near], atol=1e-9)


def test_cup_is_the_polygon_of_its_section() -> None:
    radius, height, wall, bottom = 30.0, 42.0, 3.5, 5.0
    scene = Scene(cup(0.0, radius, height, wall, bottom))
    # Section (r, z) of the pot, away from the handle.
    inner = radius - wall
    section = np.array([[0, 0], [radius, 0], [radius, height], [inner, height], [inner, bottom], [0, bottom]], float)
    random = np.random.default_rng(4)
    r, z, angle = random.uniform(18, 34, 4000), random.uniform(-4, 46, 4000), random.uniform(2.0, 4.0, 4000)
    x = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    expected = np.full(4000, np.inf)
    for a, b in pairwise(section):
        t = np.clip(((np.column_stack([r, z]) - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        expected = np.minimum(expected, np.linalg.norm(np.column_stack([r, z]) - a - t[:, None] * (b - a), axis=1))
    np.testing.assert_allclose(distance(scene, x), expected, atol=1e-9)


def test_what_is_buried_does_not_count() -> None:
    scene = Scene(cup(0.0))
    # In the middle of the wall beside the handle, where the handle's cut-off end is nearer than either face.
    handle_height = 21.0
    buried = np.array([[28.4, 0.0, handle_height + 11.0]])
    assert distance(scene, buried)[0] == pytest.approx(28.4 - 26.5, abs=1e-9)
    # The two steps of a stair touch: the wall between them counts above the lower one only.
    steps = Scene(stair(0.0, (10.0, 30.0)))
    assert distance(steps, np.array([[0.5, 0.0, 4.0]]))[0] == pytest.approx(4.0, abs=1e-9)
    assert distance(steps, np.array([[0.5, 0.0, 20.0]]))[0] == pytest.approx(0.5, abs=1e-9)


def test_not_a_number_stays_one() -> None:
    x = np.array([[0.0, 0.0, 5.0], [np.nan, 0.0, 0.0]])
    np.testing.assert_array_equal(distance(Scene((floor((-9, -9), (9, 9)),)), x), [5.0, np.nan])


def test_inside_a_crease_the_line_where_two_bodies_meet_is_nearest() -> None:
    # Two balls of 10 mm, 12 mm apart, meet in a circle of radius 8 mm in the plane x = 0.
    scene = Scene(tuple(Body(Sphere(np.array([x, 0.0, 0.0]), 10.0), grey(0.5)) for x in (-6.0, 6.0)))
    random = np.random.default_rng(5)
    angle, x, r = random.uniform(0, 2 * np.pi, 2000), random.uniform(-0.5, 0.5, 2000), random.uniform(7.0, 9.0, 2000)
    found = distance(scene, np.column_stack([x, r * np.cos(angle), r * np.sin(angle)]))
    crease = np.hypot(x, r - 8)
    expected = crease.copy()
    for centre in (-6.0, 6.0):
        away = np.hypot(x - centre, r)
        # The nearest point of this ball, unless the other one buries it.
        foot = centre + 10 * (x - centre) / away, 10 * r / away
        free = np.hypot(foot[0] + centre, foot[1]) > 10
        expected = np.where(free, np.minimum(expected, np.abs(away - 10)), expected)
    assert (expected == crease).sum() > 200
    np.testing.assert_allclose(found, expected, atol=1e-6)
