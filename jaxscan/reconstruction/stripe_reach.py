"""How far from the middle of the stripe a scan's photographs still have its light."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.images.decode import Image, read_image
from jaxscan.images.sampled import levels_at

# Photographs that are looked at.
_PHOTOGRAPHS: Final = 12
# The greatest distance from the stripe that is looked at, and the distance from there to where the light is compared,
# px; in photographs of more columns than these both are larger by as much.
GREATEST_PX: Final = 40
_FURTHER_PX: Final = 4
_COLUMNS: Final = 640
# The stripe's light is gone where it falls, from there to that distance further, by no more than these grey levels, or
# this part of the light.
_GONE_LEVELS: Final = 0.75
_GONE_PART: Final = 0.02
# What is taken beyond, px: noise hides the last of it.
_MARGIN_PX: Final = 1
# Lines with a stripe that there must be.
_FEWEST: Final = 100


def stripe_reach(photographs: Sequence[Path], position: Float[np.ndarray, "frames lines"], *, columns: bool) -> float:
    """The distance from the stripe beyond which its light falls no further.

    At each distance both sides of the stripe are compared with both sides a little further out, so that a scene that
    becomes brighter from one side to the other cancels. The median over the lines of several photographs counts.

    Args:
        photographs: of a scan's steps, with the stripe.
        position: of the stripe in each, the row of each column, or the column of each row; NaN for none.
        columns: whether it has a row for each column.

    Returns:
        The distance, px. The greatest that is looked at, 40 px in photographs of up to 640 columns, where the light
        falls all the way, and where there are too few lines to say.

    Raises:
        InputError: a photograph cannot be read.
    """
    chosen = np.unique(np.linspace(0, len(position) - 1, _PHOTOGRAPHS).astype(int))
    pictures = [read_image(photographs[i]) for i in chosen]
    scale = max(1.0, pictures[0].shape[1] / _COLUMNS)
    apart = scale * np.arange(GREATEST_PX + _FURTHER_PX + 1)
    light = np.concatenate(
        [_beside(picture, position[i], apart, columns=columns) for picture, i in zip(pictures, chosen, strict=True)],
        axis=1,
    )
    if light.shape[1] < _FEWEST:
        return scale * GREATEST_PX
    falls = np.median(light[:-_FURTHER_PX] - light[_FURTHER_PX:], axis=1)
    gone = falls <= np.maximum(_GONE_LEVELS, _GONE_PART * np.median(light[_FURTHER_PX:], axis=1))
    last = int(np.flatnonzero(~gone.all(axis=1)).max(initial=-1))
    return scale * min(last + 1 + _MARGIN_PX, GREATEST_PX)


def _beside(
    photograph: Image, position: Float[np.ndarray, "lines"], apart: Float[np.ndarray, "distances"], *, columns: bool
) -> Float[np.ndarray, "distances some 3"]:
    """The mean of both sides of the stripe at each distance from it, grey levels, where both are in the photograph."""
    end = photograph.shape[0 if columns else 1] - 1
    with np.errstate(invalid="ignore"):
        line = np.flatnonzero((position >= apart[-1]) & (position <= end - apart[-1]))
    across = position[line].astype(np.float64)
    sides = []
    for at in (across - apart[:, None], across + apart[:, None]):
        along = np.broadcast_to(line.astype(np.float64), at.shape)
        pixels = np.stack([along, at] if columns else [at, along], axis=-1)
        sides.append(levels_at(photograph, pixels.reshape(-1, 2)).reshape(*at.shape, 3))
    return (sides[0] + sides[1]) / 2
