"""Colours of points by what is known of them."""

import numpy as np
from jaxtyping import Float, UInt8


def diverging(values: Float[np.ndarray, "points"], limit: float) -> UInt8[np.ndarray, "points 3"]:
    """Blue for −limit and below, white for 0, red for limit and above, grey where there is no number."""
    part = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)[:, None]
    white, red, blue = (np.array(colour, float) for colour in ((245, 245, 245), (190, 20, 40), (40, 70, 200)))
    colours = white + np.where(part > 0, part * (red - white), -part * (blue - white))
    return np.where(np.isfinite(values)[:, None], np.round(colours), 128).astype(np.uint8)
