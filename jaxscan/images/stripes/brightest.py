"""In which colour a stripe is brightest: what was said of the laser may be wrong, and a JPEG shows a little of any."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, UInt

from jaxscan.images.exposures import full_number
from jaxscan.images.stripe_settings import CHANNELS, StripeSettings

# How far beside a stripe its surroundings are looked at, px.
_BESIDE_PX: Final = 10
# Another colour must rise by this multiple of the rise of the laser's own colour, which is taken as at least this part
# of a full pixel.
_TIMES, _LEAST_RISE = 2.0, 0.04
_LEAST_POINTS = 20


def brighter_color(
    image: UInt[np.ndarray, "rows columns *rgb"], pixels: Float[np.ndarray, "points 2"], settings: StripeSettings
) -> str | None:
    """The colour in which a stripe rises far more above what is beside it than in the laser's; None if there is none.

    Args:
        image: the photograph.
        pixels: (u, v) of the stripe's points; NaN for one that is missing.
        settings: what was said of the laser.
    """
    if settings.color == "grey" or image.ndim == 2:
        return None
    own = CHANNELS[settings.color][0]
    u, v = np.rint(pixels[np.isfinite(pixels).all(axis=1)]).astype(int).T
    rows, columns = image.shape[:2]
    across = (0, _BESIDE_PX) if settings.columns else (_BESIDE_PX, 0)
    full = full_number(int(image.max()), image.dtype)
    there = image[v, u].astype(np.float64)
    beside = [
        image[np.clip(v + way * across[1], 0, rows - 1), np.clip(u + way * across[0], 0, columns - 1)]
        for way in (-1, 1)
    ]
    # How far a full pixel rises is not known.
    known = there[:, own] < full
    if known.sum() < _LEAST_POINTS:
        return None
    rise = np.median((there - np.mean(beside, axis=0))[known], axis=0)
    brightest = max(CHANNELS, key=lambda color: rise[CHANNELS[color][0]])
    far = rise.max() > _TIMES * max(rise[own], _LEAST_RISE * full)
    return brightest if far else None


def miscoloured(found: Sequence[str | None], settings: StripeSettings) -> str | None:
    """What is said of a stripe that is brightest in another colour in more than half of the photographs."""
    brighter = next((color for color in CHANNELS if 2 * found.count(color) > len(found)), None)
    if brighter is None:
        return None
    return (
        f"is brightest in {brighter} in most photographs, but is searched in {settings.color}: "
        f'set color = "{brighter}" under [laser]'
    )
