"""Whether what was fitted is what was seen."""

from collections.abc import Callable

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.measurement.seen import check_is_one_plane
from jaxscan.measurement.shapes import Plane

SPREAD_MM = 0.05


def face(height: Callable[[np.ndarray], np.ndarray]) -> tuple[Plane, np.ndarray]:
    """Points of such heights over a square of 60 mm, and the plane through them."""
    random = np.random.default_rng(0)
    x, y = random.uniform(-30, 30, (2, 3000))
    points = np.stack([x, y, height(x) + SPREAD_MM * random.standard_normal(len(x))], axis=1)
    A = np.stack([x, y, np.ones_like(x)], axis=1)
    slope = np.linalg.lstsq(A, points[:, 2], rcond=None)[0]
    normal = np.array([-slope[0], -slope[1], 1.0])
    return Plane(np.array([0.0, 0.0, slope[2]]), normal / np.linalg.norm(normal), 30.0), points


def test_several_levels_are_no_plane():
    plane, points = face(lambda x: 10.0 * (x // 20))
    with pytest.raises(
        InputError, match=r"not lie on one plane: they are \d\.\d mm RMS .* \d\d% of them lie on another"
    ):
        check_is_one_plane(plane, points, SPREAD_MM)


@pytest.mark.parametrize("bend", [0.0, 0.2, 2.0])
def test_a_warped_face_is_one(bend):
    plane, points = face(lambda x: bend * (x / 30) ** 2)
    check_is_one_plane(plane, points, SPREAD_MM)
