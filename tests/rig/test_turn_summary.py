"""A turntable's one freedom without meaning, and what is said of its axis."""

import numpy as np
import pytest

from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, Covariance, Rig, Rotary
from jaxscan.rig.motion import normal_motion
from jaxscan.rig.rig import held_jacobian, motion_normal_jacobian
from jaxscan.rig.turn_summary import turn_summary

W, C = np.array([0.0002, -0.0008, -0.0018]), np.array([20.0, -40.0, 350.0])
NAMES = tuple(f"motion.turntable.{part}.{i}" for part in ("per_step", "centre") for i in range(3))


def table(w: np.ndarray, c: np.ndarray) -> Rotary:
    with float64():
        return as_numpy(Rotary.create(w, c))


def numbers(turntable: Rotary) -> np.ndarray:
    return np.array([float(x) for x in (*turntable.per_step, *turntable.centre)])


def nearest(each: np.ndarray) -> np.ndarray:
    with float64():
        return numbers(as_numpy(normal_motion(table(each[:3], each[3:]))))


def test_its_jacobian_is_that_of_finite_differences():
    at, J = np.concatenate([W, C]), np.zeros((6, 6))
    for k in range(6):
        step = 1e-6 * abs(at[k]) * np.eye(6)[k]
        J[:, k] = (nearest(at + step) - nearest(at - step)) / (2 * step[k])
    scale = np.concatenate([np.full(3, 1e-3), np.full(3, 1.0)])
    np.testing.assert_allclose(
        motion_normal_jacobian(table(W, C)) * scale / scale[:, None], J * scale / scale[:, None], atol=1e-4
    )


def test_a_covariance_there_and_back():
    """What is known of the nearest point follows from what is known where a coordinate is held, and gives that back."""
    turntable = table(*np.split(nearest(np.concatenate([W, C])), 2))
    rig = Rig(Camera.create((640, 480), [700.0, 700.0], [320.0, 240.0]), (), turntable)
    assert rig.surplus() == {"motion.turntable.centre.2"}
    root = np.random.default_rng(0).normal(size=(6, 6)) * np.array([1e-6] * 3 + [0.05] * 3)[:, None]
    root[5] = 0.0
    held = root @ root.T
    N, H = motion_normal_jacobian(turntable), held_jacobian(rig)[-6:, -6:]
    scale = np.array([1e-6] * 3 + [0.05] * 3)
    known = N @ held @ N.T
    np.testing.assert_allclose(H @ known @ H.T / np.outer(scale, scale), held / np.outer(scale, scale), atol=1e-9)
    assert np.linalg.matrix_rank(known / np.outer(scale, scale), tol=1e-9) == 5


@pytest.mark.parametrize(
    ("axis", "way"),
    [
        ([0.1, -0.4, -0.9], "anticlockwise"),
        ([0.1, -0.4, 0.9], "clockwise"),
        # A table in front of an upright camera, y down: by the right hand's rule about −y its front goes right.
        ([0.0, -1.0, 0.1], "its near side to the right"),
        ([0.0, 1.0, 0.1], "its near side to the left"),
        ([1.0, 0.0, 0.0], "its near side down"),
    ],
)
def test_which_way_it_turns(axis, way):
    turntable = table(1e-3 * np.array(axis), np.zeros(3))
    assert turntable.way() == way
    with float64():
        moved = np.asarray(turntable.pose({"turntable": 1.0}).apply(np.array([0.0, 0.0, -1.0])))
    if "near" in way:
        assert {"right": moved[0] > 0, "left": moved[0] < 0, "down": moved[1] > 0}[way.split()[-1]]


def test_its_facts_are_those_of_the_place_that_is_asked_for():
    turntable = table(*np.split(nearest(np.concatenate([W, C])), 2))
    angle = np.linalg.norm(W)
    summary = turn_summary(turntable, None, C + 3.0)
    assert summary.steps_per_turn == pytest.approx(2 * np.pi / angle)
    assert summary.axis_sigma_deg is None
    np.testing.assert_allclose(np.cross(np.array(summary.through_mm) - C, W), 0, atol=1e-12)
    # An axis that is known in direction alone to 1 mrad is known at 100 mm from its centre to 0.1 mm.
    u = W / angle
    across = np.eye(3) - np.outer(u, u)
    spread = np.zeros((6, 6))
    spread[:3, :3] = (1e-3 * angle) ** 2 * across
    far = np.array([float(x) for x in turntable.centre]) + 100.0 * u
    summary = turn_summary(turntable, Covariance(NAMES, spread), far)
    assert summary.axis_sigma_deg == pytest.approx(np.degrees(1e-3))
    assert summary.through_sigma_mm == pytest.approx(0.1)
    assert summary.degrees_per_step_sigma == pytest.approx(0.0, abs=1e-10)
