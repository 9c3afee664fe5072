"""What moves, shines and photographs: the scanner's own hardware, and the scan that they make together.

Drivers of real devices import neither jax nor jaxscan.
"""

from hardware.frame import Frame
from hardware.protocols import Camera, Laser, Stage

__all__ = ["Camera", "Frame", "Laser", "Stage"]
