"""Nearest points of triangles: against all triangles one by one, and how many are looked at for it."""

import time

import numpy as np
import pytest
import trimesh

from jaxscan.geometry.closest import ClosestOnTriangles

RNG = np.random.default_rng(0)


def on_segment(p, a, b):
    """The nearest point of a segment."""
    length = ((b - a) ** 2).sum(axis=-1)
    t = np.clip(((p - a) * (b - a)).sum(axis=-1) / np.where(length > 0, length, 1), 0, 1)
    return a + t[..., None] * (b - a)


def brute_force(corners, points):
    """How far each point is from the nearest triangle: from its plane where the foot is inside, or from its sides."""
    a, b, c = np.moveaxis(corners, 1, 0)
    p = points[:, None]
    least = np.min([np.linalg.norm(p - on_segment(p, *side), axis=-1) for side in ((a, b), (b, c), (c, a))], axis=0)
    n = np.cross(b - a, c - a)
    size = np.linalg.norm(n, axis=-1)
    n = n / np.where(size > 0, size, 1)[:, None]
    height = ((p - a) * n).sum(axis=-1)
    foot = p - height[..., None] * n
    turns = [(np.cross(y - x, foot - x) * n).sum(axis=-1) for x, y in ((a, b), (b, c), (c, a))]
    # What is nearly a line has no plane.
    longest = np.max([((x - y) ** 2).sum(axis=-1) for x, y in ((a, b), (b, c), (c, a))], axis=0)
    inside = (np.min(turns, axis=0) >= 0) & (size > 1e-9 * longest)
    return np.where(inside, np.abs(height), least).min(axis=1)


def sheet(side, pitch=0.5):
    """A wavy sheet of 2 side² small triangles around the origin, 5 mm above z = 0."""
    x, y = np.meshgrid(*[pitch * (np.arange(side + 1) - side / 2)] * 2)
    P = np.stack([x, y, 5 + np.sin(x / 3) * np.cos(y / 4)], axis=-1)
    a, b, c, d = P[:-1, :-1], P[:-1, 1:], P[1:, :-1], P[1:, 1:]
    return np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, d), (a, d, c))])


PLATE = 40.0 * np.array([[[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[-1, -1, 0], [1, 1, 0], [-1, 1, 0]]])


def needles(count):
    """From the origin's surroundings outwards, 30 mm long and 0.001 to 0.1 mm wide, in all directions."""
    along = RNG.normal(size=(count, 3))
    along *= 30 / np.linalg.norm(along, axis=1, keepdims=True)
    start = RNG.normal(size=(count, 3))
    aside = RNG.normal(size=(count, 3)) * 10.0 ** RNG.uniform(-3, -1, (count, 1))
    return np.stack([start, start + along, start + RNG.uniform(0, 1, (count, 1)) * along + aside], axis=1)


def any_size(count, sizes):
    return RNG.normal(size=(count, 1, 3)) * 10 + RNG.normal(size=(count, 3, 3)) * RNG.choice(sizes, (count, 1, 1))


def degenerate():
    """Points, lines with the third corner anywhere on them, and triangles that are nearly lines."""
    a, b = RNG.normal(size=(2, 30, 3)) * 10
    t = np.repeat([0.0, 0.5, 1.0, -1.0, 2.0], 6)[:, None]
    lines = np.stack([a, b, a + t * (b - a)], axis=1)
    return np.concatenate([lines, np.repeat(a[:, None], 3, axis=1), lines + RNG.normal(size=lines.shape) * 1e-13])


@pytest.mark.parametrize(
    "corners",
    [
        any_size(60, [0.1, 1.0, 15.0]),
        any_size(300, [30.0]),
        any_size(300, [0.1]),
        np.concatenate([sheet(12), PLATE]),
        needles(200),
        degenerate(),
        np.concatenate([sheet(6), PLATE, needles(20), degenerate()]),
        PLATE[:1],
    ],
    ids=["any size", "all large", "all small", "sheet over a plate", "needles", "degenerate", "all kinds", "one"],
)
def test_nearest_points_are_those_of_the_nearest_triangle(corners):
    centres = corners.mean(axis=1)
    points = np.concatenate(
        [
            RNG.normal(size=(100, 3)) * 15,
            RNG.normal(size=(20, 3)) * 3000,
            centres[RNG.integers(0, len(corners), 80)] + RNG.normal(size=(80, 3)) * 0.1,
            corners.reshape(-1, 3)[RNG.integers(0, 3 * len(corners), 40)],
        ]
    )
    on, triangle = ClosestOnTriangles(corners)(points)
    away = np.linalg.norm(on - points, axis=1)
    np.testing.assert_allclose(away, brute_force(corners, points), atol=1e-9)
    # The nearest point is on the triangle that is named.
    assert max(brute_force(corners[[k]], on[[i]])[0] for i, k in enumerate(triangle)) < 1e-9


def test_work_does_not_grow_with_the_largest_triangle():
    small = sheet(50)
    over = small.mean(axis=1)[RNG.integers(0, len(small), 4000)] + RNG.normal(size=(4000, 3)) * 0.2
    with_plate = np.concatenate([small, PLATE])
    for corners, points in ((small, over), (with_plate, over), (with_plate, over - [0.0, 0.0, 5.0])):
        closest = ClosestOnTriangles(corners)
        away = np.linalg.norm(closest(points)[0] - points, axis=1)
        np.testing.assert_allclose(away[::400], brute_force(corners, points[::400]), atol=1e-9)
        assert closest.looked_at <= 5.0 * len(points)


def test_work_of_needles_is_a_small_part_of_all():
    corners = needles(2000)
    closest = ClosestOnTriangles(corners)
    closest(RNG.normal(size=(500, 3)) * 15)
    assert closest.looked_at < 0.02 * 500 * len(corners)


def ball(count):
    """A round surface of 8 count² triangles and radius 1, askew."""
    corners = np.asarray(trimesh.creation.uv_sphere(radius=1.0, count=[2 * count, 2 * count]).triangles)
    return corners @ np.linalg.qr(RNG.normal(size=(3, 3)))[0]


def test_far_points_of_a_round_surface_are_told_apart():
    """From afar all of its triangles are about as near."""
    corners, points = ball(50), RNG.normal(size=(4000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    closest, used = ClosestOnTriangles(corners), []
    for distance in (1.02, 10.0, 1000.0):
        begin, looked_at = time.process_time(), closest.looked_at
        away = np.linalg.norm(closest(distance * points)[0] - distance * points, axis=1)
        used.append(time.process_time() - begin)
        np.testing.assert_allclose(away[::1000], brute_force(corners, distance * points[::1000]), rtol=1e-12)
        assert closest.looked_at - looked_at < 100 * len(points)
    assert max(used) < 10 * max(used[0], 0.05)


def test_no_points_have_no_nearest():
    on, triangle = ClosestOnTriangles(np.eye(3)[None])(np.zeros((0, 3)))
    assert on.shape == (0, 3)
    assert triangle.shape == (0,)
