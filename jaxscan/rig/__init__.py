"""The rig as one pytree: camera, light planes, stage, turntable, and the poses that calibration refines with them."""

from jaxscan.rig.camera import LENSES, Camera
from jaxscan.rig.covariance import Covariance
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.rig import Rig
from jaxscan.rig.stage import Stage
from jaxscan.rig.system import BoardWarp, System
from jaxscan.rig.turntable import Turntable

__all__ = ["LENSES", "BoardWarp", "Camera", "Covariance", "LightPlane", "Rig", "Stage", "System", "Turntable"]
