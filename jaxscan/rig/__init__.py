"""The rig as one pytree: camera, lights, motion, and the poses that calibration refines with them."""

from jaxscan.rig.board_shape import BoardShape
from jaxscan.rig.bowed_sheet import BowedSheet
from jaxscan.rig.camera import Camera
from jaxscan.rig.covariance import Covariance
from jaxscan.rig.given_poses import CARRIED_BY, HeadPoses, ObjectPoses, given_poses, positions_of
from jaxscan.rig.guide import Guide, Screw, ScrewOnGuide
from jaxscan.rig.kinds import LENSES, LIGHTS, MOTIONS, register_lens, register_light, register_motion
from jaxscan.rig.lens import Lens
from jaxscan.rig.light import Light, MovingLight
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.linear import Linear
from jaxscan.rig.motion import AxisMotion, Chain, Fixed, Motion, Positions, motion_of
from jaxscan.rig.play import played_axes, run_of, runs
from jaxscan.rig.pose_range import PoseRange
from jaxscan.rig.rig import Rig
from jaxscan.rig.rotary import Rotary
from jaxscan.rig.swept_sheet import SweptSheet
from jaxscan.rig.system import System

__all__ = [
    "CARRIED_BY",
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
    "HeadPoses",
    "Lens",
    "Light",
    "LightPlane",
    "Linear",
    "Motion",
    "MovingLight",
    "ObjectPoses",
    "PoseRange",
    "Positions",
    "Rig",
    "Rotary",
    "Screw",
    "ScrewOnGuide",
    "SweptSheet",
    "System",
    "given_poses",
    "motion_of",
    "played_axes",
    "positions_of",
    "register_lens",
    "register_light",
    "register_motion",
    "run_of",
    "runs",
]
