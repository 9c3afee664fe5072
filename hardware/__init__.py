"""What moves, shines and photographs: the scanner's own hardware, and the scan that they make together.

Drivers of real devices import neither jax nor jaxscan.
"""

from typing import TYPE_CHECKING, Any

from hardware.protocols import Camera, Laser, Stage

if TYPE_CHECKING:
    from hardware.frame import Frame

__all__ = ["Camera", "Frame", "Laser", "Stage"]


def __getattr__(name: str) -> Any:
    # A frame holds an array, and `scanner --help` does not wait for NumPy.
    if name != "Frame":
        raise AttributeError(f"module 'hardware' has no attribute '{name}'")
    from hardware.frame import Frame

    return Frame
