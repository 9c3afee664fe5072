"""Reconstruction: from the photographs of an object to its points."""

from jaxscan.reconstruction.range_image import RangeImage, read_range_image, write_points
from jaxscan.reconstruction.reconstruct import Written, reconstruct, write_stream
from jaxscan.reconstruction.stream import Scanner
from jaxscan.reconstruction.triangulate import Kernel, triangulate

__all__ = [
    "Kernel",
    "RangeImage",
    "Scanner",
    "Written",
    "read_range_image",
    "reconstruct",
    "triangulate",
    "write_points",
    "write_stream",
]
