"""One calibrated synthetic session, shared: its solve compiles once for all tests that look at it."""

import pytest
import synthetic

from jaxscan.calibration import Calibration, Observations, calibrate


@pytest.fixture(scope="session")
def session() -> Observations:
    """Eleven views and five stage photographs of the rig of 2003, with noise."""
    return synthetic.observations(seed=0, n_stage=5)


@pytest.fixture(scope="session")
def calibration(session: Observations) -> Calibration:
    """What `calibrate` makes of it."""
    return calibrate(session)
