"""How thick a sheet is, from stripes whose widths are those of a blur and of two sheets a little apart."""

import cv2
import numpy as np
import pytest

from jaxscan.calibration import Observations, StripePoints, View
from jaxscan.calibration.sheet_thickness import sheet_sigma_mm
from jaxscan.geometry import Pose
from jaxscan.images.stripes.bell import FWHM
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from tests.calibration.synthetic import BOARD, FOCAL, IMAGE_SIZE, K1, OMEGA, PER_STEP, PRINCIPAL, board_pose, stripe_on

BLUR_PX, APART_MM = 0.6, 0.01


@pytest.fixture(scope="module")
def rig() -> Rig:
    with float64():
        camera = Camera.create(IMAGE_SIZE, np.asarray(FOCAL), np.asarray(PRINCIPAL), "radial1", np.asarray([K1]))
        return as_numpy(Rig(camera, (LightPlane.create(OMEGA),), Linear.create(PER_STEP)))


def seen(
    sigma_mm: float, views: int = 14, seed: int = 0, noise: float = 0.0, defocus: float = 0.0
) -> tuple[Observations, Pose[np.ndarray]]:
    """Stripes on boards at known poses; the blur grows with the distance from 345 mm by `defocus` px for each 50 mm."""
    random = np.random.default_rng(seed)
    photographs, poses = [], []
    off = OMEGA / (1 + APART_MM * np.linalg.norm(OMEGA))
    for i in range(views):
        R, t = board_pose(random)
        middle, aside = (stripe_on(R, t, True, omega) for omega in (OMEGA, off))
        blur = np.hypot(BLUR_PX, defocus * ((R @ BOARD.points().mean(axis=0) + t)[2] - 345) / 50)
        spread = (aside[:, 1] - middle[:, 1]) / APART_MM
        slope = np.gradient(middle[:, 1])
        w2 = blur**2 * (1 + slope**2) + (sigma_mm * spread) ** 2
        widths = FWHM * np.sqrt(w2) * (1 + noise * random.standard_normal(len(w2)))
        stripes = (StripePoints(middle, widths=widths),)
        photographs.append(View(f"view-{i}", np.zeros((len(BOARD.points()), 2)), stripes=stripes))
        poses.append(np.concatenate([cv2.Rodrigues(R)[0].ravel(), t]))
    observations = Observations(IMAGE_SIZE, BOARD, tuple(photographs), (), ("",))
    return observations, Pose.from_vector(np.array(poses))


@pytest.mark.parametrize("sigma_mm", [0.1, 0.25, 0.6])
def test_it_is_found(rig, sigma_mm):
    observations, poses = seen(sigma_mm)
    assert sheet_sigma_mm(observations, rig, poses, 0) == pytest.approx(sigma_mm, rel=0.02)
    observations, poses = seen(sigma_mm, noise=0.1, seed=3)
    assert sheet_sigma_mm(observations, rig, poses, 0) == pytest.approx(sigma_mm, rel=0.15)


def test_a_lens_that_is_out_of_focus_is_no_thickness(rig):
    observations, poses = seen(0.25, views=20, noise=0.05, defocus=0.5)
    assert sheet_sigma_mm(observations, rig, poses, 0) == pytest.approx(0.25, rel=0.15)


def test_where_widths_do_not_tell_it_nothing_is_said(rig):
    observations, poses = seen(0.0, noise=0.1)
    assert sheet_sigma_mm(observations, rig, poses, 0) is None
    observations, poses = seen(0.25, views=6)
    assert sheet_sigma_mm(observations, rig, poses, 0) is None


def test_one_stripe_that_is_far_too_wide_counts_little(rig):
    observations, poses = seen(0.25, views=16)
    first, *others = observations.views
    (stripe,) = first.stripes
    wide = View(first.name, first.corners, stripes=(StripePoints(stripe.pixels, widths=3 * stripe.widths),))
    observations = Observations(IMAGE_SIZE, BOARD, (wide, *others), (), ("",))
    assert sheet_sigma_mm(observations, rig, poses, 0) == pytest.approx(0.25, rel=0.05)
