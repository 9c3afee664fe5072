"""Real photographs: what the published answers say, within bounds. The benchmarks print the figures themselves."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import calibration_rs
from benchmarks.sub_pix import with_sub_pix
from benchmarks.surface import pyramid_of
from jaxscan import Calibration, ObservabilityError, calibrate, observe, read_rig, read_scan, read_session, reconstruct
from jaxscan.surface.clean import clean
from jaxscan.surface.floor import find_floor
from jaxscan.surface.plateaus import plateaus

LEAVES = ("focal.0", "focal.1", "principal.0", "principal.1")


def test_opencvs_sample_photographs(data: Path) -> None:
    folder = data / "opencv-left"
    session = read_session(folder)
    published = np.array([532.795, 532.919, 342.458, 233.901])

    def answer(calibration: Calibration) -> np.ndarray:
        camera = calibration.rig.camera
        return np.array([float(x) for x in (*camera.focal, *camera.principal)])

    own = observe(session)
    theirs = calibrate(with_sub_pix(own, folder), lens=session.camera.lens, plain=True)
    np.testing.assert_allclose(answer(theirs), published, atol=0.1)
    ours = calibrate(own, lens=session.camera.lens)
    sigma = np.array([ours.covariance.sigma(f"camera.{name}") for name in LEAVES])
    assert np.abs((answer(ours) - published) / sigma).max() < 3
    assert ours.corner_rms_px < 0.85 * theirs.corner_rms_px
    assert ours.rig.lights == ()
    assert ours.rig.axes() == {}


@pytest.mark.parametrize("side", [pytest.param("left", marks=pytest.mark.long), "right"])
def test_the_corners_of_two_weakly_determined_cameras(data: Path, side: str) -> None:
    """1 σ of the focal lengths is 4 px. The published values are no minimum on these corners; OpenCV's is ours."""
    content = calibration_rs.read(data)
    observations = calibration_rs.corners(content, side)
    values, sigma = calibration_rs.focal_and_principal(calibrate(observations, lens="brown", plain=True))
    off = np.abs(values - calibration_rs.focal_and_principal_of(content["intrinsics"][side]))
    assert (off < 4.0).all()
    # The left camera's u₀ is 1.6 σ away, all others are within 1 σ.
    assert (off < sigma * np.array([1.0, 1.0, 1.7 if side == "left" else 1.0, 1.0])).all()
    theirs, their_sigma = calibration_rs.opencv_focal_and_principal(observations)
    assert (np.abs(values - theirs) < 0.01 * sigma).all()
    np.testing.assert_allclose(sigma, their_sigma, rtol=0.02)


def test_boards_lying_flat_give_no_focal_length(data: Path) -> None:
    session = read_session(data / "stage-boards")
    with pytest.raises(ObservabilityError, match="focal length"):
        calibrate(observe(session), lens=session.camera.lens)


@pytest.mark.long
def test_a_saturated_stripe_on_a_dark_board(data: Path) -> None:
    session = read_session(data / "etna-2")
    result = calibrate(observe(session), lens=session.camera.lens)
    assert len(result.fits) == 8
    assert result.corner_rms_px < 0.26
    assert result.stripe_rms_px is not None
    assert result.stripe_rms_px < 0.4
    omega = np.stack(result.rig.lights[0].plane)
    # Measured before with OpenCV and a plane by SVD: (−0.00808, −0.00122, 0.00521); weakly tied to the focal length.
    np.testing.assert_allclose(omega, [-0.00808, -0.00122, 0.00521], atol=4e-4)
    assert any("beyond the board" in line for line in (*result.left_out, *result.rejected))


def test_a_pyramid(data: Path) -> None:
    image = reconstruct(read_rig(data / "stage-pyramid" / "rig.json"), read_scan(data / "stage-pyramid"))
    assert image.valid.any(axis=1).all()
    assert image.valid.mean() > 0.9
    # The bed is 80 mm below the camera, the pyramid some tens of millimetres high: nothing lies elsewhere.
    depth = image.points[image.valid][:, 2]
    assert depth.max() < 84
    assert depth.min() > 40
    # Its faces are no plateaus, and its top is smaller than one.
    cleaned = clean(image).image
    assert plateaus(cleaned, find_floor(cleaned)) == ()
    found = {metric.name.removeprefix("surface.pyramid."): metric.value for metric in pyramid_of(image)}
    # As published the stage moves the wrong way, which folds the surface.
    assert found["facing_away.stage_plus"] > 0.05
    assert found["facing_away.stage_minus"] < 0.01
    assert found["share_further_than_1_mm"] < 0.02
    assert max(found[f"{name}.rms"] for name in ("top", "face_0", "face_1", "face_2", "face_3")) < 0.3
    assert max(found["slopes_0_and_2_apart"], found["slopes_1_and_3_apart"]) < 3.0


def test_a_bare_bed_has_no_plateau(data: Path) -> None:
    image = clean(reconstruct(read_rig(data / "stage-pyramid" / "rig.json"), read_scan(data / "stage-flat"))).image
    assert image.valid.any(axis=1).all()
    assert plateaus(image, find_floor(image)) == ()
