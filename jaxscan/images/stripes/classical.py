"""Detectors in closed form: the thresholded mean, centre of gravity, peaks of three, zero crossing and ridge.

Each takes windows of the response r, the stripe's outline in them (smoothed response s, background b, peak) and the
sensor's noise v, and returns the centre c, counted from the window's first pixel, and its σ to first order:
σ² = Σ (∂c / ∂r_k)² v_k.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxscan.images.stripes.windows import Lines, Outline, Pixels, Sensor, Windows, places

# The scripts of 2003 took what reached 200 of the 510 levels of (R − G) + (R − B).
_THRESHOLD = 200 / 510
# The centre of gravity's window, in half widths, and more, for what the pixels themselves smear.
_WINDOW_IN_HALF_WIDTHS, _WINDOW_MARGIN_PX = 2.0, 1.0
_OVERSTEP, _STEPS = 1.6, 2
# (1 4 6 4 1) / 16 and then (−1 0 1): the root of the sum of its squares.
_DIFFERENCE_NORM = float(np.linalg.norm(np.convolve([1, 4, 6, 4, 1], [1, 0, -1]) / 16))
# The smoothed derivative: that of a Gaussian of this σ, px, cut off where it is 2 % of its greatest.
_FIR_SIGMA, _FIR_REACH = 1.5, 5
# C. Steger's bound: a ridge has one maximum where the smoothing's σ is at least the half width over √3.
_STEGER = 3**-0.5


class Estimate(NamedTuple):
    """A detector's answer, for each line.

    Attributes:
        centre: counted from the window's first pixel.
        sigma: its predicted standard deviation, px.
        width: full width at half height, px.
        found: whether there is one.
    """

    centre: Lines
    sigma: Lines
    width: Lines
    found: Bool[Array, "groups 1 lines"]


def threshold(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """The mean of the rows whose response reaches a threshold, rounded to a whole row: the method of 2003.

    No noise is needed for it to be wrong: a mean of whole rows is even or half, and is rounded; σ² = 1/24 + 1/12, for
    either end of the rows lies anywhere within a pixel.
    """
    r = windows.response
    above = r >= _THRESHOLD * sensor.span
    count = above.sum(1, keepdims=True)
    centre = jnp.rint(jnp.where(above, places(r.shape[1]), 0.0).sum(1, keepdims=True) / jnp.maximum(count, 1))
    return Estimate(centre, jnp.full_like(centre, (1 / 24 + 1 / 12) ** 0.5), outline.width, count > 0)


def gravity(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """A centre of gravity in a window that is even about the centre, and falls to zero at its ends.

    With w_k = (1 − ((k − c) / h)²)² for |k − c| < h, twice

        c ← c + a (Σ w_k (r_k − b) k / Σ w_k (r_k − b) − c)

    Whatever the window cuts off, it cuts off evenly, so neither a stripe wider than it nor one that is burnt out flat
    is pulled to a side. a > 1 makes up for the window's pull towards the old centre (G. Bernstein and M. Jarvis 2002).
    """
    height = windows.response - outline.floor
    k = places(height.shape[1])
    centre = outline.middle
    reach = _WINDOW_IN_HALF_WIDTHS * outline.width / 2 + _WINDOW_MARGIN_PX

    def window(centre: Lines) -> tuple[Pixels, Pixels]:
        # At the image's edge the window shrinks, and stays even.
        h = jnp.minimum(reach, jnp.minimum(centre, height.shape[1] - 1 - centre) + 1)
        offset = k - centre
        return offset, jnp.maximum(1 - (offset / jnp.maximum(h, 1.0)) ** 2, 0.0)

    for _ in range(_STEPS):
        offset, root = window(centre)
        weight = root**2 * height
        total = weight.sum(1, keepdims=True)
        centre += _OVERSTEP * (weight * offset).sum(1, keepdims=True) / jnp.where(total > 0, total, jnp.inf)
    # Where it stands still, Σ w (r − b) (k − c) = 0, and its derivative by c is −Σ (r − b) √w (5 √w − 4).
    offset, root = window(centre)
    slope = (height * root * (5 * root - 4)).sum(1, keepdims=True)
    variance = ((root**2 * offset) ** 2 * _variance(windows, outline, sensor)).sum(1, keepdims=True)
    return Estimate(centre, jnp.sqrt(variance) / jnp.maximum(slope, 1e-6), outline.width, slope > 0)


def _variance(windows: Windows, outline: Outline, sensor: Sensor) -> Pixels:
    """Variance of each pixel; 0 for a full one."""
    return jnp.where(windows.full, 0.0, windows.variance(windows.response - outline.floor, sensor))


def parabola(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """The peak of the parabola through the greatest of s and its two neighbours."""
    return _peak_of_three(windows, outline, sensor, logarithm=False)


def gaussian(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """The peak of the Gaussian through the greatest of s − b and its two neighbours."""
    return _peak_of_three(windows, outline, sensor, logarithm=True)


def _peak_of_three(windows: Windows, outline: Outline, sensor: Sensor, logarithm: bool) -> Estimate:
    s = outline.smooth - outline.floor
    k = places(s.shape[1])
    at = jnp.clip(outline.at, 1, s.shape[1] - 2)
    before, peak, after = ((jnp.where(k == at + i, s, 0.0)).sum(1, keepdims=True) for i in (-1, 0, 1))
    v = jnp.where(k == at, windows.variance(s, sensor), 0.0).sum(1, keepdims=True)
    if logarithm:
        least = jnp.maximum(1e-3 * peak, 1e-6)
        before, peak, after = (jnp.maximum(x, least) for x in (before, peak, after))
        v = v / peak**2
        before, peak, after = jnp.log(before), jnp.log(peak), jnp.log(after)
    curvature = 2 * peak - before - after
    found = curvature > 0
    curvature = jnp.where(found, curvature, 1.0)
    centre = at + jnp.clip((after - before) / (2 * curvature), -0.5, 0.5)
    return Estimate(centre, _DIFFERENCE_NORM * jnp.sqrt(v) / (2 * curvature), outline.width, found)


def derivative(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """The zero crossing of the smoothed derivative: r filtered by that of a Gaussian, interpolated between pixels."""
    tap = np.arange(-_FIR_REACH, _FIR_REACH + 1)
    taps = tap * np.exp(-0.5 * (tap / _FIR_SIGMA) ** 2)
    r, size = windows.response, windows.response.shape[1]
    padded = jnp.pad(r, [(0, 0), (_FIR_REACH, _FIR_REACH), (0, 0)], mode="edge")
    d = jnp.zeros_like(r)
    for i, weight in enumerate(taps.astype(np.float32)):
        if weight:
            d += weight * padded[:, i : i + size]
    k = places(size)[:, :-1]
    falls = (d[:, :-1] > 0) & (d[:, 1:] <= 0)
    # Of several crossings, that nearest the middle of the outline.
    away = jnp.where(falls, jnp.abs(k + 0.5 - outline.middle), jnp.inf)
    here = falls & (away == away.min(1, keepdims=True))
    slope = jnp.where(here, d[:, :-1] - d[:, 1:], 0.0).max(1, keepdims=True)
    found = slope > 0
    safe = jnp.where(found, slope, 1.0)
    centre = jnp.where(here, k + d[:, :-1] / safe, 0.0).max(1, keepdims=True)
    offset = places(size) - centre
    gain = offset * jnp.exp(-0.5 * (offset / _FIR_SIGMA) ** 2)
    variance = (gain**2 * _variance(windows, outline, sensor)).sum(1, keepdims=True)
    return Estimate(centre, jnp.sqrt(variance) / safe, outline.width, found)


def ridge(windows: Windows, outline: Outline, sensor: Sensor) -> Estimate:
    """C. Steger's line detector (1998), in the profile of one line.

    r is smoothed by a Gaussian of σ no less than the stripe's half width over √3, so that a bar has one maximum; there
    c ← c − r′ / r″, twice. His detector looks along the normal of the line in the image; here each column stands for
    itself, so that a step in depth is not smoothed over.
    """
    r = windows.response
    scale = jnp.maximum(_STEGER * outline.width / 2, 1.0)
    centre = outline.middle
    for _ in range(_STEPS):
        first, second, _ = _derivatives(r, centre, scale)
        centre -= jnp.clip(first / jnp.where(second < 0, second, -jnp.inf), -1.0, 1.0)
    _, second, gain = _derivatives(r, centre, scale)
    variance = (gain**2 * _variance(windows, outline, sensor)).sum(1, keepdims=True)
    found = second < 0
    return Estimate(centre, jnp.sqrt(variance) / jnp.where(found, -second, 1.0), outline.width, found)


def _derivatives(r: Pixels, centre: Lines, scale: Lines) -> tuple[Lines, Lines, Pixels]:
    """The smoothed response's first and second derivative at a place, but for a common factor; the first one's FIR."""
    x = (places(r.shape[1]) - centre) / scale
    gauss = jnp.exp(-0.5 * x * x)
    gain = x * gauss
    flat = r - r.min(1, keepdims=True)
    second = ((x * x - 1) * gauss * flat).sum(1, keepdims=True) / scale
    return (gain * flat).sum(1, keepdims=True), second, gain
