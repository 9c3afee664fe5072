"""The rig as one pytree: camera, lights, motion, and the poses that calibration refines with them."""

from jaxscan.rig.board_shape import BoardShape
from jaxscan.rig.bowed_sheet import BowedSheet
from jaxscan.rig.camera import Camera
from jaxscan.rig.covariance import Covariance
from jaxscan.rig.guide import Guide, Screw, ScrewOnGuide
from jaxscan.rig.kinds import LENSES, LIGHTS, MOTIONS, register_lens, register_light, register_motion
from jaxscan.rig.lens import Lens
from jaxscan.rig.light import Light
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.linear import Linear
from jaxscan.rig.motion import AxisMotion, Chain, Fixed, Motion, Positions, motion_of
from jaxscan.rig.play import is_run, played_axes, run_of, runs
from jaxscan.rig.rig import Rig
from jaxscan.rig.rotary import Rotary
from jaxscan.rig.system import System

__all__ = [
    "LENSES",
    "LIGHTS",
    "MOTIONS",
    "AxisMotion",
    "BoardShape",
    "BowedSheet",
    "Camera",
    "Chain",
    "Covariance",
    "Fixed",
    "Guide",
    "Lens",
    "Light",
    "LightPlane",
    "Linear",
    "Motion",
    "Positions",
    "Rig",
    "Rotary",
    "Screw",
    "ScrewOnGuide",
    "System",
    "is_run",
    "motion_of",
    "played_axes",
    "register_lens",
    "register_light",
    "register_motion",
    "run_of",
    "runs",
]
