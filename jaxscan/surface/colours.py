"""Colours of points by what is known of them."""

import numpy as np
from jaxtyping import Float, UInt8

# Equal steps of lightness (van der Walt and Smith's viridis).
_RAMP = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))


def diverging(values: Float[np.ndarray, "points"], limit: float) -> UInt8[np.ndarray, "points 3"]:
    """Blue for −limit and below, white for 0, red for limit and above, grey where there is no number."""
    part = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)[:, None]
    white, red, blue = (np.array(colour, float) for colour in ((245, 245, 245), (190, 20, 40), (40, 70, 200)))
    colours = white + np.where(part > 0, part * (red - white), -part * (blue - white))
    return np.where(np.isfinite(values)[:, None], np.round(colours), 128).astype(np.uint8)


def sequential(parts: Float[np.ndarray, "points"]) -> UInt8[np.ndarray, "points 3"]:
    """From dark violet for 0 and below over green to yellow for 1 and above, ever brighter; grey without a number."""
    place = np.linspace(0.0, 1.0, len(_RAMP))
    known = np.clip(np.nan_to_num(parts), 0.0, 1.0)
    colours = np.stack([np.interp(known, place, channel) for channel in np.array(_RAMP).T], axis=1)
    return np.where(np.isfinite(parts)[:, None], np.round(colours), 128).astype(np.uint8)
