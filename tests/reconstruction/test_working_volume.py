"""σ over the working volume: that of `point_sigma` at the same place, and conditional covariances against NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.reconstruction.point_sigma import point_sigma
from jaxscan.reconstruction.working_volume import given, working_volume, working_volumes
from jaxscan.rig import Camera, Covariance, LightPlane, Rig
from jaxscan.rig.rig import parameter_names

OMEGA = np.array([0.0005, -0.00494, 0.00303])


CAMERA = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "radial1", [-0.134])


def volume_of(rig: Rig, depths_mm: tuple[float, float]):
    sigma = np.array([0.5, 0.5, 0.8, 0.8, 1e-3, 1e-6, 2e-6, 3e-6])
    covariance = Covariance(tuple(parameter_names(rig)), np.diag(sigma**2))
    return covariance, working_volume(rig, "", covariance, 0.1, True, depths_mm)


def test_a_point_of_the_map_is_a_point_of_the_sheet():
    rig = Rig(CAMERA, (LightPlane.create(OMEGA),))
    covariance, volume = volume_of(rig, (310.0, 380.0))
    assert volume is not None
    assert volume.sigma_mm.shape == (len(volume.depths_mm), len(volume.positions_mm))
    assert (volume.sigma_mm >= volume.pixel_mm)[np.isfinite(volume.sigma_mm)].all()
    # The same point by hand: along the sheet from the point of it nearest to the axis, through OpenCV.
    import cv2

    i, j = 7, int(np.argmin(np.abs(volume.positions_mm - 20)))
    z, s = volume.depths_mm[i], volume.positions_mm[j]
    along = np.array([OMEGA[1], -OMEGA[0], 0]) / np.hypot(*OMEGA[:2])
    X = np.append(OMEGA[:2] * (1 - OMEGA[2] * z) / (OMEGA[:2] @ OMEGA[:2]), z) + s * along
    assert pytest.approx(1) == OMEGA @ X
    K = np.array([[697.7, 0, 310.3], [0, 690.4, 228.1], [0, 0, 1]])
    pixel = cv2.projectPoints(X[None, None], np.zeros(3), np.zeros(3), K, np.array([-0.134, 0, 0, 0]))[0].reshape(1, 2)
    total, alone = point_sigma(rig, "", covariance, 0.1, pixel, {}, True)
    assert volume.sigma_mm[i, j] == pytest.approx(total[0], rel=1e-4)
    assert volume.pixel_mm[i, j] == pytest.approx(alone[0], rel=1e-4)
    assert volume.if_known_mm["camera"] < volume.median_mm
    assert volume.if_known_mm["light plane"] < volume.median_mm
    assert volume.travelled_mm is None


def test_a_sheet_out_of_view_has_no_volume():
    far = Rig(CAMERA, (LightPlane.create([0.0, -0.0001, 0.0]),))
    assert volume_of(far, (310.0, 380.0))[1] is None


def test_beyond_the_fold_of_a_lens_nothing_is_seen():
    """With k1 = −1 the lens folds at the undistorted radius 1 / √3; farther out a point has a pixel all the same."""
    folded = Camera.create((640, 480), [400.0, 400.0], [319.5, 239.5], "radial1", [-1.0])
    _, volume = volume_of(Rig(folded, (LightPlane.create(OMEGA),)), (300.0, 320.0))
    assert volume is not None
    assert np.abs(volume.positions_mm).max() < 320 / np.sqrt(3)


def test_given_is_the_conditional_covariance():
    A = np.random.default_rng(0).normal(size=(5, 5))
    S = A @ A.T
    names = ("camera.focal.0", "camera.focal.1", "lights.0.plane.0", "lights.0.plane.1", "lights.0.plane.2")
    found = given(Covariance(names, S), "camera").matrix
    # The inverse of the information's block.
    np.testing.assert_allclose(found[2:, 2:], np.linalg.inv(np.linalg.inv(S)[2:, 2:]), rtol=1e-9)
    assert (found[:2] == 0).all()


def test_another_light_beside_a_stripe_does_not_widen_it(calibration):
    view = next(v for v in calibration.observations.views if v.stripes)
    i = calibration.observations.views.index(view)
    stripe = view.stripes[0]
    pixels = stripe.pixels.copy()
    pixels[::20] += [0.0, -60.0] if stripe.columns else [-60.0, 0.0]
    stripes = (replace(stripe, pixels=pixels), *view.stripes[1:])
    views = [*calibration.observations.views]
    views[i] = replace(view, stripes=stripes)
    disturbed = replace(calibration, observations=replace(calibration.observations, views=tuple(views)))
    (before,), (after,) = working_volumes(calibration), working_volumes(disturbed)
    np.testing.assert_allclose(after.depths_mm[[0, -1]], before.depths_mm[[0, -1]], rtol=0.005)
    depths = [calibration.rig_file().fit["stripe_depths_mm"] for calibration in (calibration, disturbed)]
    np.testing.assert_allclose(*depths, rtol=0.005)
