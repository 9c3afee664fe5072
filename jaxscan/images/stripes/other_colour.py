"""The colour under which a stripe is found, where none is under the colour that was given."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from jaxscan.images.decode import Image
from jaxscan.images.stripe_settings import CHANNELS, StripeSettings
from jaxscan.images.stripes.detect import detect_stripe

# A stripe has more points than this, in most of the photographs.
_LEAST_POINTS: Final = 20
_COLOURS: Final[tuple[Literal["red", "green", "blue"], ...]] = ("red", "green", "blue")


def colour_that_shows(photographs: Iterable[Image], settings: StripeSettings) -> str | None:
    """The colour of laser under which most photographs have a stripe; None if there is none but the one that was set.

    Args:
        photographs: in which none was found by these settings, or hardly any; a few are enough.
        settings: what was said of the laser.
    """
    coloured = [image for image in photographs if image.ndim == 3]
    if not coloured or settings.color not in CHANNELS:
        return None
    found = {}
    for colour in (colour for colour in _COLOURS if colour != settings.color):
        points = [
            int(np.isfinite(detect_stripe(image, replace(settings, color=colour)).position).sum()) for image in coloured
        ]
        found[colour] = sum(points) if sum(n > _LEAST_POINTS for n in points) * 2 > len(points) else 0
    best = max(found, key=lambda colour: found[colour])
    return best if found[best] else None
