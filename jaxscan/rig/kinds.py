"""The kinds of parts that a rig file may name: a new one stands here, in one line, and in a file of its own."""

from typing import Any, Final, TypeVar

from jaxscan.errors import InputError
from jaxscan.rig.bowed_sheet import BowedSheet
from jaxscan.rig.fisheye import Fisheye
from jaxscan.rig.given_poses import HeadPoses, ObjectPoses
from jaxscan.rig.guide import Guide, Screw, ScrewOnGuide
from jaxscan.rig.lens import Lens
from jaxscan.rig.light import Light
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.linear import Linear
from jaxscan.rig.motion import AxisMotion
from jaxscan.rig.opencv_lens import LADDER
from jaxscan.rig.play import GuideWithPlay, LinearWithPlay, RotaryWithPlay, ScrewOnGuideWithPlay, ScrewWithPlay
from jaxscan.rig.rotary import Rotary
from jaxscan.rig.splined import Splined
from jaxscan.rig.swept_sheet import SweptSheet

LENSES: Final[dict[str, type[Lens]]] = {**LADDER, Fisheye.kind: Fisheye, Splined.kind: Splined}
LIGHTS: Final[dict[str, type[Light]]] = {kind.kind: kind for kind in (LightPlane, BowedSheet, SweptSheet)}
# From the room to the object: lines carry turns.
_LINES: Final = (Linear, Guide, Screw, ScrewOnGuide, LinearWithPlay, GuideWithPlay, ScrewWithPlay, ScrewOnGuideWithPlay)
MOTIONS: Final[dict[str, type[AxisMotion]]] = {
    kind.kind: kind for kind in (*_LINES, Rotary, RotaryWithPlay, HeadPoses, ObjectPoses)
}

# What a rig file has beside a lens's numbers.
_OF_THE_CAMERA: Final = {"image_size", "focal", "principal", "tilt", "lens"}

_Kind = TypeVar("_Kind", bound=type)


def register_lens(kind: _Kind) -> _Kind:
    """Let rig files and calibrations have lenses of a kind; as a decorator of its class too.

    Raises:
        InputError: one of its numbers is called as something of the camera is.
    """
    if taken := sorted(_OF_THE_CAMERA.intersection(kind.numbers)):
        raise InputError(f'the lens "{_of(kind)}" has numbers called {", ".join(taken)}, as the camera: rename them')
    LENSES[_of(kind)] = kind
    return kind


def register_light(kind: _Kind) -> _Kind:
    """Let rig files and calibrations have lights of a kind; as a decorator of its class too."""
    LIGHTS[_of(kind)] = kind
    return kind


def register_motion(kind: _Kind) -> _Kind:
    """Let rig files and calibrations have axes of a kind; as a decorator of its class too."""
    MOTIONS[_of(kind)] = kind
    return kind


def lens_of_kind(name: str) -> type[Any]:
    """The class of a kind of lens, one of `LENSES`; the classes of a protocol are not known at run time.

    Raises:
        InputError: there is no such lens.
    """
    if name not in LENSES:
        raise InputError(f'there is no lens "{name}": use one of {", ".join(LENSES)}')
    return LENSES[name]


def _of(kind: Any) -> str:
    return kind.kind
