"""What is printed under the stripe, as the light around it shows: by how much it may pull the stripe's centre.

Where the surface's reflectance R changes across a stripe, its bright side pulls. A sheet of light whose cross-section
is the Gaussian g of standard deviation s₀ is moved by

    ∫ (v − c) g R / ∫ g R ≈ s₀² d ln R / dv

A stripe narrower than a pixel or two is so blurred that its shape does not show the edge (`fit_reflectance_edge`
measures wider ones). But the light of the room shows R in the same photograph, in the channels that are not the
laser's; and a photograph with the laser off shows it in the laser's own channel. With the stripe's standard deviation
s as it is seen, lens and pixel included, in place of s₀, the sum over the pixels gives the most that the centre can
have been moved. No photograph shows how much of s is the sheet's own. So any part of the displacement d, from 0 to 1,
is taken as possible: its mean square, d² / 3, is added to σ².
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt

from jaxscan.images.stripe_settings import StripeSettings
from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.response import Backgrounds, Images, channels, noise_gain
from jaxscan.images.stripes.windows import Pixels, Places, Sensor, first_pixel, gather_pixels, places
from jaxscan.kept_programs import compiled

# Lines of each frame that show whether anything is printed; where it counts in this part of them, all are looked at.
_LINES, _MANY = 64, 0.02
# Rows at each end of the window that lie beside the stripe.
_BESIDE = 3
# A displacement is significant above this multiple of its noise, and is applied from this part of σ on.
_SEEN, _COUNTS = 3.0, 0.5
_PIXEL_VARIANCE = 1 / 12
_TINY = 1e-6

Lines = Float[np.ndarray, "frames lines"]
Groups = Callable[..., Any]


def widened_by_print(
    sigma: Lines,
    position: Lines,
    width: Lines,
    asked: Bool[np.ndarray, "frames lines"],
    images: Images,
    background: Backgrounds | None,
    sensor: Sensor,
    correlation: Float[np.ndarray, "most distances"],
    settings: StripeSettings,
    half: int,
    groups: Groups,
) -> Lines:
    """σ with what an edge of reflectance under the stripe may have moved its centre by.

    Args:
        sigma: of each line's centre, px; NaN where there is none.
        position: the centre.
        width: of the stripe, full at half height, px.
        asked: which lines may be moved: an edge that is in the profile they were measured with has moved none.
        images: the photographs.
        background: the same with the laser off, one for all or one for each, or None.
        sensor: the noise.
        correlation: of each frame's noise of pixels 1, 2, … apart; 0 where it is white.
        settings: the laser's colour, and which way lines run.
        half: half the length of the windows that are looked at.
        groups: gives indices of lines in groups of few sizes, and how many of each group count.
    """
    if background is None and settings.color == "grey":
        return sigma
    asked = asked & np.isfinite(sigma) & np.isfinite(position) & np.isfinite(width)
    # What sums over several pixels make of smoothed noise is larger by so much.
    larger = jnp.asarray(np.sqrt(np.maximum(1 + 2 * correlation.sum(axis=1), 1)), jnp.float32)
    source = images if background is None else background

    def look(which: Bool[np.ndarray, "frames lines"]) -> tuple[np.ndarray, ...]:
        at = np.nonzero(which)
        found = [np.zeros(0, np.float32)]
        for group, count in groups(*at):
            centre, broad = (x[tuple(group)] for x in (position, width))
            peak = np.rint(centre).astype(np.int32)
            pixels = gather_pixels(source, *group, peak, settings.columns, half)
            centre = centre - first_pixel(images, peak, settings.columns, half)
            shown = _displaced(pixels, sensor, larger, group[0], centre, broad, settings.color, background is not None)
            found.append(np.ravel(np.asarray(shown))[:count])
        moved = np.concatenate(found)
        return (*at, np.where(np.abs(moved) > _COUNTS * sigma[at], moved, 0.0))

    frame, _, moved = look(_some(asked))
    count = np.bincount(frame, minlength=len(asked))
    printed = np.bincount(frame, moved != 0, minlength=len(asked)) > _MANY * np.maximum(count, 1)
    if not printed.any():
        return sigma
    *at, moved = look(asked & printed[:, None])
    sigma = sigma.copy()
    sigma[tuple(at)] = np.hypot(sigma[tuple(at)], np.float32(1 / np.sqrt(3)) * moved)
    return sigma


def _some(asked: Bool[np.ndarray, "frames lines"]) -> Bool[np.ndarray, "frames lines"]:
    """A few lines of each frame, evenly spread."""
    rank = np.cumsum(asked, axis=1)
    every = np.maximum(rank[:, -1:] // _LINES, 1)
    return asked & (rank % every == 0)


@compiled(static_argnames=("color", "is_dark"))
def _displaced(
    pixels: UInt[Array, "groups window lines *rgb"],
    sensor: Sensor,
    larger: Float[Array, "frames"],
    frame: Places,
    centre: Float[Array, "groups lines"],
    width: Float[Array, "groups lines"],
    color: str,
    is_dark: bool,
) -> Float[Array, "groups lines"]:
    """The most that the reflectance beside and under each stripe may have moved it, px; 0 where noise may be all.

    Args:
        pixels: in a window about each stripe; with the laser off, if that `is_dark`.
        sensor: the noise.
        larger: by how much that of sums is larger in each frame.
        frame: of each window.
        centre: of the stripe, px from the window's first pixel.
        width: of the stripe.
        color: of the laser.
        is_dark: whether the laser is off.
    """
    levels = [level.astype(jnp.float32) for level in channels(pixels, None, color)]
    here = sensor.of(frame)
    noise = here.read * larger[frame][:, None] / noise_gain(here.weights, color)
    s2 = (width[:, None] / FWHM) ** 2 + _PIXEL_VARIANCE
    z = places(pixels.shape[1]) - centre[:, None]
    g = jnp.exp(-0.5 * z * z / s2)
    if is_dark:
        light = levels[0]
    else:
        light, noise = levels[1] + levels[2], noise * jnp.sqrt(2.0)
        # What the other channels have of the laser is in the middle of the stripe, and is no print.
        rise, leak = (x - _beside(x) for x in (levels[0], light))
        share = (g * leak).sum(1, keepdims=True) / jnp.maximum((g * rise).sum(1, keepdims=True), _TINY)
        light = light - jnp.maximum(share, 0.0) * jnp.maximum(rise, 0.0)
    light = jnp.maximum(light, 0.0)
    total = jnp.maximum((g * light).sum(1), _TINY)
    z = z - (g * z).sum(1, keepdims=True) / g.sum(1, keepdims=True)
    moved = (g * z * light).sum(1) / total
    by_chance = noise[:, 0] * jnp.sqrt((g * g * z * z).sum(1)) / total
    longest = jnp.sqrt(s2[:, 0])
    return jnp.where(jnp.abs(moved) > _SEEN * by_chance, jnp.clip(moved, -longest, longest), 0.0)


def _beside(x: Pixels) -> Pixels:
    """The mean of a window's two ends."""
    return (x[:, :_BESIDE] + x[:, -_BESIDE:]).mean(1, keepdims=True) / 2
