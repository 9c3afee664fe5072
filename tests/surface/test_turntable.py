"""A turntable from the poses of sides, and back."""

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.geometry import Pose
from jaxscan.rig import Covariance, Rotary
from jaxscan.simulation.rig_2003 import simulated_rig
from jaxscan.surface.register import Registration
from jaxscan.surface.turntable import fit_turntable, turntable_poses

AXIS, CENTRE = np.array([0.1, -0.4, -0.9]), np.array([3.0, 40.0, 330.0])
STEPS = np.arange(8) * 400.0 + 100.0


def registered(sigma_rad: float, sigma_mm: float, seed: int = 0) -> Registration:
    """Poses of eight sides 45° apart, with noise."""
    rng = np.random.default_rng(seed)
    poses = []
    for k in range(8):
        T = Pose.about(np.radians(45.0 * k) * AXIS / np.linalg.norm(AXIS), CENTRE).inverse()
        if k:
            T = Pose.about(sigma_rad * rng.normal(size=3), CENTRE, sigma_mm * rng.normal(size=3)) @ T
        poses.append(T)
    covariance = np.diag(np.tile([sigma_rad**2] * 3 + [sigma_mm**2] * 3, 7))
    return Registration(tuple(poses), CENTRE, covariance, (), 1.0, 5, 0.01, True)


def test_recovered_within_the_covariance():
    axis = AXIS / np.linalg.norm(AXIS)
    truth = np.concatenate([np.radians(45.0 / 400.0) * axis, CENTRE - (CENTRE @ axis) * axis])
    chi2 = []
    for seed in range(12):
        found = fit_turntable(registered(1e-3, 0.01, seed), STEPS)
        error = np.array([*map(float, (*found.turntable.per_step, *found.turntable.centre))]) - truth
        chi2.append(error @ np.linalg.pinv(found.covariance.matrix, rcond=1e-10) @ error / 5)
        assert 0.6 < found.misfit < 1.4
    assert 0.4 < np.mean(chi2) < 2.0


def test_its_poses_are_those_it_came_from():
    registration = registered(1e-9, 1e-9)
    found = fit_turntable(registration, STEPS)
    for T, true in zip(turntable_poses(found.turntable, STEPS), registration.poses, strict=True):
        np.testing.assert_allclose(T.matrix(), true.matrix(), atol=1e-7)
        np.testing.assert_allclose(T.translation, true.translation, atol=1e-5)


def test_turned_by_hand_is_told():
    registration = registered(1e-4, 1e-3)
    by_hand = STEPS + np.array([0, 30, -40, 10, 25, -35, 5, 0])
    assert fit_turntable(registration, by_hand).misfit > 100


def test_in_the_rig_file(tmp_path):
    found = fit_turntable(registered(1e-4, 1e-3), STEPS)
    content = RigFile(simulated_rig(0), Covariance(("motion.stage.per_step.0",), np.array([[1e-12]])))
    for rig in (content, found.on(content)):
        write_rig(tmp_path / "rig.json", found.on(rig))
        back = read_rig(tmp_path / "rig.json")
        assert isinstance(back.rig.axis("turntable"), Rotary)
        np.testing.assert_array_equal(back.rig.axis("turntable").centre, found.turntable.centre)
        assert back.covariance is not None
        assert back.covariance.sigma("motion.turntable.centre.0") > 0
        assert back.covariance.sigma("motion.stage.per_step.0") == 1e-6


def test_what_cannot_be_fitted(tmp_path):
    with pytest.raises(InputError, match="3 step counts for 8 scans"):
        fit_turntable(registered(1e-4, 1e-3), [0, 1, 2])
    with pytest.raises(InputError, match="not turned against each other"):
        fit_turntable(registered(1e-4, 1e-3), np.zeros(8))
    write_rig(tmp_path / "rig.json", RigFile(simulated_rig(0)))
    text = (tmp_path / "rig.json").read_text()
    still = '"motion": [{"axis": "turntable", "kind": "rotary", "per_step": [0, 0, 0], "centre": [0, 0, 0]}, '
    (tmp_path / "rig.json").write_text(text.replace('"motion": [', still))
    with pytest.raises(InputError, match="the turntable does not move"):
        read_rig(tmp_path / "rig.json")
