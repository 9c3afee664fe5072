"""JPEG as webcams and phones write it: brightness for each pixel, colour for each 2 × 2 of them (4:2:0)."""

from pathlib import Path

import numpy as np
import simplejpeg
from jaxtyping import UInt8

from jaxscan.atomic import replacing
from jaxscan.errors import InputError


def write_jpeg(path: Path, image: UInt8[np.ndarray, "rows columns 3"], quality: int) -> None:
    """Write an RGB image; whole or not at all.

    Args:
        path: where to.
        image: eight bits a channel.
        quality: 1 to 100.

    Raises:
        InputError: the quality is out of its range, or the place cannot be written.
    """
    check_quality(quality)
    data = simplejpeg.encode_jpeg(np.ascontiguousarray(image), quality, "RGB", "420")
    with replacing(path) as file:
        file.write(data)


def check_quality(quality: int, called: str = "quality") -> None:
    """Refuse what is no quality of a JPEG.

    Args:
        quality: 1 to 100.
        called: how the error names it.

    Raises:
        InputError: it is out of its range.
    """
    if not 1 <= quality <= 100:
        raise InputError(f"{called} {quality}: a JPEG has a quality of 1 to 100; cameras take 75 to 95")
