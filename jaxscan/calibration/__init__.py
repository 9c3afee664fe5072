"""Calibration: from where corners and stripes were seen to a rig with its covariance."""

from jaxscan.calibration.adjustment import Adjustment, refit
from jaxscan.calibration.calibrate import calibrate
from jaxscan.calibration.choose import calibrate_by_evidence
from jaxscan.calibration.model import Choice, Model
from jaxscan.calibration.observations import (
    BoardSequence,
    HandSettings,
    InlierMask,
    Observations,
    StripePoints,
    View,
)
from jaxscan.calibration.result import Calibration, PhotographFit
from jaxscan.calibration.split import Split, calibrate_split

__all__ = [
    "Adjustment",
    "BoardSequence",
    "Calibration",
    "Choice",
    "HandSettings",
    "InlierMask",
    "Model",
    "Observations",
    "PhotographFit",
    "Split",
    "StripePoints",
    "View",
    "calibrate",
    "calibrate_by_evidence",
    "calibrate_split",
    "refit",
]
