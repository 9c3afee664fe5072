"""Two lasers on one camera in one solve: what they see agrees, within the σ that is predicted, and no better."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from benchmarks.drawn import Noise, exact_session, redrawn
from benchmarks.gauge import HEIGHTS, faces
from benchmarks.lasers import BLOCK_Y, face_distance
from jaxscan import calibrate
from jaxscan.calibration.gauge_points import GaugeScan
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.shapes import stair

# Two lasers are a rig of their own shape, which compiles all of the solve again.
pytestmark = pytest.mark.long

STEPS = 6000.0 * np.arange(12)


@pytest.fixture(scope="module")
def true_rig():
    return rig_2003.simulated_rig(0, lasers=2)


@pytest.fixture(scope="module")
def calibration():
    _, exact = exact_session(0, lasers=2)
    return calibrate(redrawn(exact, Noise(), np.random.default_rng(0)))


@pytest.fixture(scope="module")
def scans_and_faces(true_rig):
    scene, random = rig_2003.scan_scene(true_rig, stair(BLOCK_Y, HEIGHTS)), np.random.default_rng(1)
    scans, on = [], []
    for i, laser in enumerate(true_rig.lights):
        profiles = [true_profile(true_rig, scene, {"stage": n}, laser=i) for n in STEPS]
        rows = np.stack([profile.position for profile in profiles])
        rows += Noise().stripe * random.normal(size=rows.shape)
        scans.append(GaugeScan(rows, {"stage": STEPS}, laser=laser.name))
        on.append(faces(np.stack([profile.points for profile in profiles]), true_rig, HEIGHTS, BLOCK_Y))
    return scans, list(zip(*on, strict=True))


def test_both_light_planes_are_found_in_one_solve(calibration, true_rig):
    names = parameter_names(true_rig)
    assert "lights.0.plane.0" in names
    assert calibration.covariance.names == tuple(names)
    found, truth = (np.array([float(x) for x in jax.tree.leaves(rig)]) for rig in (calibration.rig, true_rig))
    assert (np.abs(found - truth) < 4 * np.sqrt(np.diagonal(calibration.covariance.matrix))).all()


def test_what_two_lasers_see_agrees(calibration, scans_and_faces):
    scans, on = scans_and_faces
    found = [face_distance(calibration, scans, masks) for masks in on]
    assert len(found) == len(HEIGHTS) + 1
    assert all(abs(face.each.mean()) < 4 * face.mean_sigma < 0.04 for face in found)
    each, sigma = (np.concatenate(x) for x in zip(*((f.each, f.sigma) for f in found), strict=True))
    assert np.sqrt((each**2).mean() / (sigma**2).mean()) == pytest.approx(1, abs=0.15)


def test_a_light_plane_that_is_wrong_shows(calibration, scans_and_faces):
    scans, on = scans_and_faces
    upper, lower = calibration.rig.lights
    wrong = replace(upper, plane=tuple(np.asarray(1.002 * float(x)) for x in upper.plane))
    pushed = replace(calibration, rig=replace(calibration.rig, lights=(wrong, lower)))
    face = face_distance(pushed, scans, on[-1])
    assert abs(face.each.mean()) > 10 * face.mean_sigma
