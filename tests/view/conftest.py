"""The report of the calibrated synthetic session, shared by the tests of the report."""

import pytest

from jaxscan.calibration import Calibration
from jaxscan.view.calibration_report import calibration_report
from jaxscan.view.report import Report


@pytest.fixture(scope="session")
def report(calibration: Calibration) -> Report:
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    return calibration_report(calibration)[0]
