"""Calibrations of cameras whose sensor is tilted against the lens."""

import cv2
import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics.ladder import climb
from jaxscan.calibration.diagnostics.missing_terms import missing_terms
from jaxscan.errors import InputError, ObservabilityError
from jaxscan.precision import float64
from jaxscan.rig import Camera
from tests.calibration import synthetic

TILT = np.radians([8.0, -6.0])
K = np.array(
    [[synthetic.FOCAL[0], 0, synthetic.PRINCIPAL[0]], [0, synthetic.FOCAL[1], synthetic.PRINCIPAL[1]], [0, 0, 1]]
)


def project(X):
    k = np.array([synthetic.K1, *[0.0] * 11, *TILT])
    return cv2.projectPoints(X.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, k)[0].reshape(-1, 2)


def session(monkeypatch, views=11, seed=0):
    """As others' sessions, by OpenCV's camera of 14 coefficients."""
    monkeypatch.setattr(synthetic, "project", project)
    return synthetic.observations(seed, n_views=views, n_stage=5)


@pytest.fixture
def tilted(monkeypatch):
    return calibrate(session(monkeypatch), tilted=True)


def test_tilt_and_all_other_numbers_are_found_within_their_sigma(tilted):
    truth = synthetic.TRUTH | {f"camera.tilt.{i}": TILT[i] for i in range(2)}
    values = dict(zip(tilted.system.shared_names(), map(float, tilted.system.values()), strict=True))
    for name in tilted.covariance.names:
        assert abs(values[name] - truth[name]) < 4 * tilted.covariance.sigma(name), name
    assert tilted.covariance.sigma("camera.tilt.0") < 0.02
    assert tilted.corner_rms_px < 0.09


def test_diagnostics_know_the_tilt(tilted):
    ladder = climb(tilted)
    assert ladder is not None
    assert ladder.supported == "radial1"
    assert missing_terms(tilted) is not None


def test_a_start_that_is_tilted_is_gone_on_with_and_can_be_held(monkeypatch):
    with float64():
        start = Camera.create(
            synthetic.IMAGE_SIZE, synthetic.FOCAL, synthetic.PRINCIPAL, "radial1", [synthetic.K1], tilt=TILT
        )
    held = calibrate(session(monkeypatch), start=start, hold=["camera.tilt.0", "camera.tilt.1"])
    assert tuple(map(float, held.rig.camera.tilt)) == tuple(TILT)
    assert "camera.tilt.0" not in held.covariance.names


def test_a_lens_without_distortion_does_not_tell_the_tilt(monkeypatch):
    with pytest.raises(InputError, match="cannot be distinguished from the principal point: ask for lens"):
        calibrate(session(monkeypatch), lens="none", tilted=True)
    # One whose terms are held at 0 was said to lack boards that are tilted more.
    with pytest.raises(InputError, match="none of its terms held at 0"):
        calibrate(session(monkeypatch), hold=["camera.radial.0"], tilted=True)


def test_a_tilt_that_is_held_needs_no_distortion(monkeypatch):
    """It was refused as if it were sought."""
    with float64():
        start = Camera.create(synthetic.IMAGE_SIZE, synthetic.FOCAL, synthetic.PRINCIPAL, "none", tilt=TILT)
    monkeypatch.setattr(synthetic, "K1", 0.0)
    held = calibrate(session(monkeypatch), start=start, hold=["camera.tilt.0", "camera.tilt.1"])
    assert held.corner_rms_px < 0.09
    assert abs(float(held.rig.camera.focal[0]) - synthetic.FOCAL[0]) < 4 * held.covariance.sigma("camera.focal.0")


def test_what_a_weak_lens_does_not_tell_is_named(monkeypatch):
    monkeypatch.setattr(synthetic, "K1", -0.002)
    with pytest.raises(
        ObservabilityError,
        match=r"tilt of the sensor and the principal point cannot be distinguished.*corners of the image",
    ):
        calibrate(session(monkeypatch, views=4), tilted=True)
