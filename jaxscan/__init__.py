"""jaxscan: a differentiable calibration and reconstruction engine for laser line scanners.

The names below are the public ones; the rest promises nothing. They are imported when they are first asked for, so that
`jaxscan --help` does not wait for JAX.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxscan.calibration import (
        Adjustment,
        BoardSequence,
        Calibration,
        HandSettings,
        InlierMask,
        Model,
        Observations,
        StripePoints,
        View,
        calibrate,
        calibrate_by_evidence,
        calibrate_split,
        refit,
    )
    from jaxscan.calibration.observe import observe
    from jaxscan.errors import InputError, JaxscanError, ObservabilityError, SolveError
    from jaxscan.files.cameras import read_camera, write_camera
    from jaxscan.files.cloud import Cloud, read_ply, write_ply
    from jaxscan.files.part_file import Part, read_part
    from jaxscan.files.rig_file import RigFile, read_rig, write_rig
    from jaxscan.files.scan import Scan, read_scan
    from jaxscan.files.session import Session, read_session
    from jaxscan.geometry import Pose
    from jaxscan.images import Board, BoardView, Stripe, StripeSettings, detect_stripe, find_board
    from jaxscan.measurement.gradient import dimension_gradient, narrowed
    from jaxscan.measurement.measure import Measurement, measure
    from jaxscan.measurement.scanned import scanned_image, scanned_points
    from jaxscan.reconstruction import RangeImage, Scanner, read_range_image, reconstruct, write_points, write_stream
    from jaxscan.reconstruction.next_best_views import next_best_views
    from jaxscan.reconstruction.point_sigma import PointCovariance, point_covariance
    from jaxscan.rig import (
        BowedSheet,
        Camera,
        Chain,
        Covariance,
        Fixed,
        Guide,
        HeadPoses,
        LightPlane,
        Linear,
        ObjectPoses,
        Rig,
        Rotary,
        Screw,
        ScrewOnGuide,
        System,
        positions_of,
    )
    from jaxscan.surface.clean import clean
    from jaxscan.surface.coarse_register import coarse_register
    from jaxscan.surface.floor import find_floor, stands_on
    from jaxscan.surface.merged import merge
    from jaxscan.surface.register import register
    from jaxscan.surface.side import side_of_image
    from jaxscan.view.verdict import Verdict, verdict

_HOME = {
    "Adjustment": "jaxscan.calibration",
    "Calibration": "jaxscan.calibration",
    "HandSettings": "jaxscan.calibration",
    "InlierMask": "jaxscan.calibration",
    "Observations": "jaxscan.calibration",
    "BoardSequence": "jaxscan.calibration",
    "StripePoints": "jaxscan.calibration",
    "View": "jaxscan.calibration",
    "calibrate": "jaxscan.calibration",
    "calibrate_by_evidence": "jaxscan.calibration",
    "calibrate_split": "jaxscan.calibration",
    "Model": "jaxscan.calibration",
    "refit": "jaxscan.calibration",
    "observe": "jaxscan.calibration.observe",
    "InputError": "jaxscan.errors",
    "JaxscanError": "jaxscan.errors",
    "ObservabilityError": "jaxscan.errors",
    "SolveError": "jaxscan.errors",
    "read_camera": "jaxscan.files.cameras",
    "write_camera": "jaxscan.files.cameras",
    "Cloud": "jaxscan.files.cloud",
    "read_ply": "jaxscan.files.cloud",
    "write_ply": "jaxscan.files.cloud",
    "Part": "jaxscan.files.part_file",
    "read_part": "jaxscan.files.part_file",
    "dimension_gradient": "jaxscan.measurement.gradient",
    "narrowed": "jaxscan.measurement.gradient",
    "Measurement": "jaxscan.measurement.measure",
    "measure": "jaxscan.measurement.measure",
    "scanned_image": "jaxscan.measurement.scanned",
    "scanned_points": "jaxscan.measurement.scanned",
    "Covariance": "jaxscan.rig",
    "RigFile": "jaxscan.files.rig_file",
    "read_rig": "jaxscan.files.rig_file",
    "write_rig": "jaxscan.files.rig_file",
    "Scan": "jaxscan.files.scan",
    "read_scan": "jaxscan.files.scan",
    "Session": "jaxscan.files.session",
    "read_session": "jaxscan.files.session",
    "Pose": "jaxscan.geometry",
    "Board": "jaxscan.images",
    "BoardView": "jaxscan.images",
    "Stripe": "jaxscan.images",
    "StripeSettings": "jaxscan.images",
    "detect_stripe": "jaxscan.images",
    "find_board": "jaxscan.images",
    "RangeImage": "jaxscan.reconstruction",
    "Scanner": "jaxscan.reconstruction",
    "read_range_image": "jaxscan.reconstruction",
    "reconstruct": "jaxscan.reconstruction",
    "write_points": "jaxscan.reconstruction",
    "write_stream": "jaxscan.reconstruction",
    "next_best_views": "jaxscan.reconstruction.next_best_views",
    "PointCovariance": "jaxscan.reconstruction.point_sigma",
    "point_covariance": "jaxscan.reconstruction.point_sigma",
    "BowedSheet": "jaxscan.rig",
    "Camera": "jaxscan.rig",
    "LightPlane": "jaxscan.rig",
    "Rig": "jaxscan.rig",
    "Linear": "jaxscan.rig",
    "Rotary": "jaxscan.rig",
    "Chain": "jaxscan.rig",
    "Fixed": "jaxscan.rig",
    "Guide": "jaxscan.rig",
    "HeadPoses": "jaxscan.rig",
    "ObjectPoses": "jaxscan.rig",
    "positions_of": "jaxscan.rig",
    "Screw": "jaxscan.rig",
    "ScrewOnGuide": "jaxscan.rig",
    "System": "jaxscan.rig",
    "clean": "jaxscan.surface.clean",
    "coarse_register": "jaxscan.surface.coarse_register",
    "find_floor": "jaxscan.surface.floor",
    "stands_on": "jaxscan.surface.floor",
    "merge": "jaxscan.surface.merged",
    "register": "jaxscan.surface.register",
    "side_of_image": "jaxscan.surface.side",
    "Verdict": "jaxscan.view.verdict",
    "verdict": "jaxscan.view.verdict",
}

__all__ = [
    "Adjustment",
    "Board",
    "BoardSequence",
    "BoardView",
    "BowedSheet",
    "Calibration",
    "Camera",
    "Chain",
    "Cloud",
    "Covariance",
    "Fixed",
    "Guide",
    "HandSettings",
    "HeadPoses",
    "InlierMask",
    "InputError",
    "JaxscanError",
    "LightPlane",
    "Linear",
    "Measurement",
    "Model",
    "ObjectPoses",
    "ObservabilityError",
    "Observations",
    "Part",
    "PointCovariance",
    "Pose",
    "RangeImage",
    "Rig",
    "RigFile",
    "Rotary",
    "Scan",
    "Scanner",
    "Screw",
    "ScrewOnGuide",
    "Session",
    "SolveError",
    "Stripe",
    "StripePoints",
    "StripeSettings",
    "System",
    "Verdict",
    "View",
    "calibrate",
    "calibrate_by_evidence",
    "calibrate_split",
    "clean",
    "coarse_register",
    "detect_stripe",
    "dimension_gradient",
    "find_board",
    "find_floor",
    "measure",
    "merge",
    "narrowed",
    "next_best_views",
    "observe",
    "point_covariance",
    "positions_of",
    "read_camera",
    "read_part",
    "read_ply",
    "read_range_image",
    "read_rig",
    "read_scan",
    "read_session",
    "reconstruct",
    "refit",
    "register",
    "scanned_image",
    "scanned_points",
    "side_of_image",
    "stands_on",
    "verdict",
    "write_camera",
    "write_ply",
    "write_points",
    "write_rig",
    "write_stream",
]


# Old names, found for one version.
_RENAMED = {"Kept": "InlierMask", "arrange": "coarse_register", "next_photographs": "next_best_views"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        new = _RENAMED[name]
        warnings.warn(
            f"jaxscan.{name} is now jaxscan.{new}; the old name goes with the next version",
            DeprecationWarning,
            stacklevel=2,
        )
        name = new
    if name not in _HOME:
        raise AttributeError(f"module 'jaxscan' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
