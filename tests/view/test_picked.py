"""A ray from the viewer, and what it meets."""

import tomllib

import numpy as np
import pytest

from jaxscan.view.picked import hit, region_lines

SQUARE = np.array([[0.0, 0.0, 5.0], [4.0, 0.0, 5.0], [4.0, 4.0, 5.0], [0.0, 4.0, 5.0]])
BOTH = np.concatenate([SQUARE, SQUARE + np.array([0.0, 0.0, 3.0])])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(("sign", "depth"), [(1.0, 5.0), (-1.0, 8.0)])
def test_a_mesh_is_met_where_it_is_nearest(sign: float, depth: float) -> None:
    triangles = np.concatenate([TRIANGLES, TRIANGLES + 4])
    origin = np.array([3.0, 1.0, 6.5 - 10 * sign])
    direction = np.array([0.0, 0.0, 7.0 * sign])
    np.testing.assert_allclose(hit(BOTH, triangles, origin, direction, 1.0), [3.0, 1.0, depth], atol=1e-12)
    assert hit(BOTH, triangles, origin, -direction, 1.0) is None
    assert hit(BOTH, triangles, origin + np.array([2.0, 0.0, 0.0]), direction, 1.0) is None


def test_a_slanting_ray_meets_both_triangles_of_a_square() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        place = np.array([*random.uniform(0.01, 3.99, 2), 5.0])
        origin = place + np.array([*random.normal(size=2), -random.uniform(1, 9)])
        np.testing.assert_allclose(hit(SQUARE, TRIANGLES, origin, place - origin, 1.0), place, atol=1e-9)


def test_of_a_cloud_the_first_point_beside_the_ray() -> None:
    origin, direction = np.array([3.9, 0.2, 0.0]), np.array([0.0, 0.0, 1.0])
    np.testing.assert_array_equal(hit(BOTH, None, origin, direction, 1.0), [4.0, 0.0, 5.0])
    assert hit(BOTH, None, origin - [1.9, 0.0, 0.0], direction, 1.0) is None
    assert hit(BOTH, None, origin, -direction, 1.0) is None


def test_the_lines_are_those_of_a_part_file() -> None:
    ball, box = (tomllib.loads(line) for line in region_lines(np.array([-30.304, 7.4, 350.0]), 8.5))
    assert ball == {"ball": [-30.3, 7.4, 350.0, 8.5]}
    assert box == {"box": [[-38.8, -1.1, 341.5], [-21.8, 15.9, 358.5]]}
