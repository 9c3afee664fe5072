"""What the next photographs would bring: σ as the map of the working volume has it, with a laser and without."""

import numpy as np
import pytest

from jaxscan.calibration import Calibration, calibrate
from jaxscan.reconstruction.next_best_views import next_best_views, wanted
from jaxscan.reconstruction.working_volume import WorkingVolume, working_volume
from jaxscan.rig import Covariance
from tests.calibration import synthetic


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return calibrate(synthetic.observations(seed=0, n_stage=5))


def volume_of(calibration: Calibration, covariance: Covariance) -> WorkingVolume:
    sigma = calibration.stripe_sigma_px or 0.0
    volume = working_volume(calibration.rig, "", covariance, sigma, True, (310.0, 380.0))
    assert volume is not None
    return volume


def test_sigma_falls_photograph_by_photograph(calibration: Calibration):
    volume = volume_of(calibration, calibration.covariance)
    planned = next_best_views(calibration, (volume,), count=2)
    assert planned.unit == "mm"
    assert planned.median_now == pytest.approx(volume.median_mm, rel=1e-9)
    assert planned.median_now > planned.medians[0] > planned.medians[1]
    assert len(planned.poses) == len(planned.medians) == 2
    # The map made with the predicted covariance has the predicted median.
    assert planned.medians[1] == pytest.approx(volume_of(calibration, planned.poses[1].covariance).median_mm, rel=1e-9)


def test_without_a_laser_pixels_are_wanted(calibration: Calibration):
    aim = wanted(calibration, ())
    assert aim.unit == "px"
    names = calibration.covariance.names
    of_lasers = [name.startswith(("laser", "stage")) for name in names]
    assert (aim.jacobian[:, of_lasers] == 0).all()
    # A shift of the principal point is a shift of the pixel.
    u = aim.jacobian[::2, names.index("camera.principal.0")]
    np.testing.assert_allclose(u, 1, atol=1e-12)
    planned = next_best_views(calibration, (), count=1)
    assert planned.medians[0] < planned.median_now
    assert planned.median_now < 0.5
