"""Nearest points of triangles, against all triangles one by one."""

import numpy as np
import trimesh

from jaxscan.geometry.closest import ClosestOnTriangles


def test_nearest_points_are_those_of_the_nearest_triangle():
    rng = np.random.default_rng(0)
    # Triangles of very different size.
    corners = rng.normal(size=(60, 1, 3)) * 10 + rng.normal(size=(60, 3, 3)) * rng.choice([0.1, 1.0, 15.0], (60, 1, 1))
    points = rng.normal(size=(300, 3)) * 15
    on, triangle = ClosestOnTriangles(corners)(points)
    every = np.stack([trimesh.triangles.closest_point(corners, np.tile(p, (60, 1))) for p in points])
    away = np.linalg.norm(every - points[:, None], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(on - points, axis=1), away.min(axis=1), atol=1e-9)
    np.testing.assert_allclose(on, every[np.arange(300), triangle], atol=1e-12)


def test_no_points_have_no_nearest():
    on, triangle = ClosestOnTriangles(np.eye(3)[None])(np.zeros((0, 3)))
    assert on.shape == (0, 3)
    assert triangle.shape == (0,)
