"""Photographs with three channels that show no colour: a monochrome camera's, saved as RGB.

A laser's colour is looked for in the difference of the channels, which is zero in all of them. Noise of a sensor with
colours is another in each channel, so channels that are equal in every pixel are no chance.
"""

from collections.abc import Iterable

import numpy as np

from jaxscan.errors import InputError
from jaxscan.images.decode import Image

# Of every Nth row first: where these differ, the others need not be compared.
_EVERY = 64


def check_colours(photographs: Iterable[Image], color: str, where: object) -> None:
    """Refuse to look for a laser's colour in photographs that all have three equal channels.

    Args:
        photographs: the first ones; those that are black, or have one channel, show nothing of the kind.
        color: that of the laser's settings.
        where: the photographs are, for the error.

    Raises:
        InputError: they have.
    """
    if color == "grey":
        return
    lit = False
    for image in photographs:
        if image.ndim != 3 or not (_alike(image[::_EVERY]) and _alike(image)):
            return
        lit = lit or bool(image.any())
    if lit:
        raise InputError(
            f"{where}: red, green and blue are equal in every pixel, as a monochrome camera's are, and the laser's "
            f'colour is {color}: write color = "grey" under [laser]'
        )


def _alike(image: Image) -> bool:
    return np.array_equal(image[..., 0], image[..., 1]) and np.array_equal(image[..., 0], image[..., 2])
