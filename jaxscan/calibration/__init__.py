"""Calibration: from where corners and stripes were seen to a rig with its covariance."""

from jaxscan.calibration.adjustment import Adjustment, refit
from jaxscan.calibration.calibrate import calibrate
from jaxscan.calibration.observations import BoardSequence, Kept, Observations, StripePoints, View
from jaxscan.calibration.result import Calibration, PhotographFit

__all__ = [
    "Adjustment",
    "BoardSequence",
    "Calibration",
    "Kept",
    "Observations",
    "PhotographFit",
    "StripePoints",
    "View",
    "calibrate",
    "refit",
]
