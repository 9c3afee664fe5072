"""The kinds of parts that a rig file may name: a new one stands here, in one line, and in a file of its own."""

from typing import Any, Final, TypeVar

from jaxscan.rig.light import Light
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.linear import Linear
from jaxscan.rig.motion import AxisMotion
from jaxscan.rig.rotary import Rotary

LIGHTS: Final[dict[str, type[Light]]] = {kind.kind: kind for kind in (LightPlane,)}
MOTIONS: Final[dict[str, type[AxisMotion]]] = {kind.kind: kind for kind in (Linear, Rotary)}


_Kind = TypeVar("_Kind", bound=type)


def register_light(kind: _Kind) -> _Kind:
    """Let rig files and calibrations have lights of a kind; as a decorator of its class too."""
    LIGHTS[_of(kind)] = kind
    return kind


def register_motion(kind: _Kind) -> _Kind:
    """Let rig files and calibrations have axes of a kind; as a decorator of its class too."""
    MOTIONS[_of(kind)] = kind
    return kind


def _of(kind: Any) -> str:
    return kind.kind
