"""Colours as screens and photographs have them (sRGB, IEC 61966-2-1), and as amounts of light, which glTF stores."""

import numpy as np
from jaxtyping import Float, Float32, UInt8

_TOE, _SLOPE, _OFFSET, _POWER = 0.0031308, 12.92, 0.055, 2.4


def light_of(colours: UInt8[np.ndarray, "some rgb"]) -> Float32[np.ndarray, "some rgb"]:
    """Amounts of light, 0 to 1, of colours in sRGB."""
    v = np.arange(256) / 255
    light = np.where(v <= _SLOPE * _TOE, v / _SLOPE, ((v + _OFFSET) / (1 + _OFFSET)) ** _POWER)
    return light.astype(np.float32)[colours]


def srgb_of(light: Float[np.ndarray, "some rgb"]) -> UInt8[np.ndarray, "some rgb"]:
    """Colours in sRGB of amounts of light, 0 to 1."""
    light = np.clip(light, 0.0, 1.0)
    v = np.where(light <= _TOE, _SLOPE * light, (1 + _OFFSET) * light ** (1 / _POWER) - _OFFSET)
    return np.rint(255 * v).astype(np.uint8)
