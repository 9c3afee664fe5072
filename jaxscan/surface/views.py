"""What a range image looks like: a number for each frame and column, NaN where there is no point."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.reconstruction import RangeImage
from jaxscan.surface.floor import Floor
from jaxscan.surface.links import Links, links
from jaxscan.surface.normals import normals

# Toward the light of the shaded view: from the left, from the back, and from the camera.
_LIGHT: Final = np.array([-0.5, -0.5, -0.707])
_AMBIENT: Final = 0.15


def depth(image: RangeImage) -> Float[np.ndarray, "frames columns"]:
    """How far each point was in front of the camera when it was seen, mm."""
    return image.seen()[..., 2].astype(np.float32)


def height(image: RangeImage, floor: Floor) -> Float[np.ndarray, "frames columns"]:
    """How far each point is above the floor, mm."""
    return np.where(image.valid, floor.height(image.points), np.nan)


def shaded(image: RangeImage, linked: Links | None = None) -> Float[np.ndarray, "frames columns"]:
    """The brightness of each point under a lamp over the camera's shoulder, from 0 to 1 (Lambert)."""
    n = normals(image, linked or links(image))
    light = np.clip(n @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    return np.where(image.valid, _AMBIENT + (1 - _AMBIENT) * light, np.nan)


def sigma(image: RangeImage) -> Float[np.ndarray, "frames columns"]:
    """The standard deviation of each point along its ray, mm."""
    return np.where(image.valid, image.sigma, np.nan)


def strength(image: RangeImage) -> Float[np.ndarray, "frames columns"]:
    """The strength of the stripe, grey levels."""
    return np.where(image.valid, image.strength, np.nan)
