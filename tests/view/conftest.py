"""One calibrated synthetic session with its report, shared by the tests of the report."""

import pytest

from jaxscan.calibration import Calibration, calibrate
from jaxscan.view.calibration_report import calibration_report
from jaxscan.view.report import Report
from tests.calibration import synthetic


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    return calibrate(synthetic.observations(seed=0, n_stage=5))


@pytest.fixture(scope="session")
def report(calibration: Calibration) -> Report:
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    return calibration_report(calibration)
