"""Calibration: from where corners and stripes were seen to a rig with its covariance."""

from jaxscan.calibration.calibrate import calibrate
from jaxscan.calibration.observations import Observations, StageSequence, StripePoints, View
from jaxscan.calibration.result import Calibration, PhotographFit

__all__ = [
    "Calibration",
    "Observations",
    "PhotographFit",
    "StageSequence",
    "StripePoints",
    "View",
    "calibrate",
]
