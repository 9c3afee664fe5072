"""Colours as the Point Cloud Library and ROS have them: the bytes 0, red, green, blue of a number called a float32."""

import numpy as np
from jaxtyping import Float32, Shaped, UInt8


def packed(colours: UInt8[np.ndarray, "points 3"]) -> Float32[np.ndarray, "points"]:
    """One number for each point; as a number it means nothing."""
    red, green, blue = colours.astype("<u4").T
    return (red << 16 | green << 8 | blue).view("<f4")


def unpacked(rgb: Shaped[np.ndarray, "points"]) -> UInt8[np.ndarray, "points 3"]:
    """Red, green and blue of numbers of four bytes, whatever these are called."""
    bits = np.ascontiguousarray(rgb).view("<u4")
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=-1).astype(np.uint8)
