"""What moves, shines and photographs: the scanner's own hardware, and the scan that they make together.

Drivers of real devices import neither jax nor jaxscan.
"""

from typing import TYPE_CHECKING, Any

from hardware.protocols import CameraDriver, LaserDriver, StageDriver, renamed

if TYPE_CHECKING:
    from hardware.frame import Frame

__all__ = ["CameraDriver", "Frame", "LaserDriver", "StageDriver"]


def __getattr__(name: str) -> Any:
    # A frame holds an array, and `scanner --help` does not wait for NumPy.
    if name != "Frame":
        return renamed(name, __name__)
    from hardware.frame import Frame

    return Frame
