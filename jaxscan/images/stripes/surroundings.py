"""What a photograph shows beside the stripe: its levels without the laser, and how much of it is full."""

from typing import Any, Final, cast

import numpy as np
from jax import Array
from jaxtyping import Float32, Int, UInt

from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.images.stripes.response import numbers

# Quantile of the frame's M + N, below the part that a burnt-out stripe may take; computed from about this number of
# pixels.
_AMBIENT_QUANTILE: Final = 0.97
_SOME_PIXELS: Final = 1200


def ambient_levels(
    frames: np.ndarray | Array, dark: np.ndarray | Array | None, color: str
) -> Int[np.ndarray, "frames"]:
    """The level of the other two channels without laser, in each frame."""
    if color == "grey":
        return np.zeros(len(frames), np.int32)
    _, first, second = CHANNELS[color]

    def others_of(images: np.ndarray | Array) -> Int[np.ndarray, "frames rows columns"]:
        some = sample(images).astype(np.int32)
        return some[..., first] + some[..., second]

    others = others_of(frames) if dark is None else others_of(frames) - others_of(dark)
    flat = np.reshape(others, (len(frames), -1))
    rank = int(_AMBIENT_QUANTILE * (flat.shape[1] - 1))
    return np.partition(flat, rank, axis=1)[:, rank].astype(np.int32)


def sample(images: np.ndarray | Array) -> UInt[np.ndarray, "frames rows columns *rgb"]:
    """Some pixels of each image; of images on a device no more is fetched than that."""
    every = max(1, int((images.shape[1] * images.shape[2] / _SOME_PIXELS) ** 0.5))
    return np.asarray(images[:, ::every, ::every])


def surroundings(
    some: UInt[np.ndarray, "frames rows columns *rgb"], full: Int[np.ndarray, "frames"], color: str
) -> tuple[Float32[np.ndarray, "frames"], Float32[np.ndarray, "frames rows columns"]]:
    """The share of full pixels, and the level without the laser."""
    laser = np.asarray(numbers(cast(Any, some), color))
    share = (laser >= full[:, None, None]).mean(axis=(1, 2), dtype=np.float32)
    grey = np.float32(np.iinfo(some.dtype).max / 255)
    if color == "grey":
        return share, laser / grey
    _, first, second = CHANNELS[color]
    return share, (some[..., first].astype(np.float32) + some[..., second]) / (2 * grey)
