"""Detection's two steps and nothing else: how fast a detector of this formulation can be here.

The coarse peaks are the library's own. The second step gathers a few rows about each and takes the zero crossing of a
smoothed derivative, with one response for all photographs: no σ, noise, colours or width, and no telling whether there
is a stripe at all. What the library's detectors take longer, they take for these.
"""

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt

from jaxscan.images.stripes.coarse import choose_peaks, coarse_peaks
from jaxscan.images.stripes.surroundings import ambient_levels
from jaxscan.images.stripes.windows import first_pixel, gather_pixels

# Half the filter, half the rows in which its zero is looked for; the Gaussian's σ.
_REACH, _SOUGHT, _SIGMA = 5, 4, 1.5
_HALF: Final = _REACH + _SOUGHT


def bare_stripe(frames: UInt[np.ndarray, "frames rows columns 3"]) -> Float[np.ndarray, "frames columns"]:
    """The row of a red stripe in each column."""
    images = jax.device_put(frames)
    length, columns = frames.shape[1:3]
    peaks = coarse_peaks(images, None, ambient_levels(frames, None, "red"), "red", columns=True)
    peak, _ = choose_peaks(peaks, length, columns=True)
    of, line = (np.ascontiguousarray(x, np.int32) for x in np.indices((len(frames), columns)))
    pixels = gather_pixels(images, of, line, peak, columns=True, half=_HALF)
    return np.asarray(_zero(pixels, first_pixel(images, peak, columns=True, half=_HALF)))


@jax.jit
def _zero(
    pixels: UInt[Array, "frames window columns 3"], first: Int[Array, "frames columns"]
) -> Float[Array, "frames columns"]:
    """Where the smoothed derivative falls through zero most steeply."""
    red, *others = (pixels[..., i].astype(jnp.int16) for i in range(3))
    r = (2 * red - others[0] - others[1]).astype(jnp.float32)
    tap = np.arange(-_REACH, _REACH + 1)
    sought = 2 * _SOUGHT + 1
    d = jnp.zeros((), jnp.float32)
    for i, weight in enumerate(tap * np.exp(-0.5 * (tap / _SIGMA) ** 2)):
        d = d + np.float32(weight) * r[:, i : i + sought]
    before, after = d[:, :-1], d[:, 1:]
    fall = jnp.where((before > 0) & (after <= 0), before - after, 0.0)
    steepest = (fall > 0) & (fall == fall.max(1, keepdims=True))
    k = jnp.arange(sought - 1, dtype=jnp.float32)[None, :, None]
    place = jnp.where(steepest, k + before / jnp.where(steepest, fall, 1.0), 0.0).max(1)
    return first.astype(jnp.float32) + _REACH + place
