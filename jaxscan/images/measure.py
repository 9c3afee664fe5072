"""Second step of stripe detection: the stripe's centre, height and width in a window about its coarse peak.

The windows stand as (frames, window, lines): reduced over the middle axis they are forty times as fast on a CPU as over
the first. With s the response smoothed by (1 4 6 4 1) / 16, p its peak and b the background, the greater of its two
minima beside the peak, the stripe lies between the places where s crosses (p + b) / 2 first on either side; their
distance is its width, their middle the first estimate of its centre c. Then, twice,

    c ← c + a (Σ w_k k / Σ w_k − c),     w_k = (r_k − b) (1 − ((k − c) / h)²)²  for |k − c| < h

a centre of gravity in a window that is even about the centre, and falls to zero at its ends: whatever it cuts off, it
cuts off evenly, so neither a stripe wider than it nor one that is burnt out flat is pulled to a side. a > 1 makes up
for the window's pull towards the old centre (G. Bernstein and M. Jarvis 2002). On smooth stripes of σ = 1 to 3 px it
errs by 0.003 px without noise.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxscan.images.response import Backgrounds, Images, split

# Rows at each end of the window that tell the noise, and that must be free of the stripe.
_FLANK = 5
# h in half widths, and more, for what the pixels themselves smear.
_WINDOW_IN_HALF_WIDTHS = 2.0
_WINDOW_MARGIN_PX = 1.0
_OVERSTEP = 1.6
_STEPS = 2
# The smoothing's own full width at half height, squared: 8 ln 2 times its variance of 1.
_SMOOTHING_FWHM2 = 5.545
_LEAST_WIDTH_PX = 1.0
_SMOOTHING = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
# Of a normal distribution: σ over its mean absolute deviation.
_DEVIATION_TO_SIGMA = 1.2533
# The frame's noise is a median over its columns; every fourth tells it as well.
_EVERY = 4


class Measured(eqx.Module):
    """What the windows tell of the stripe, for each column.

    Attributes:
        position: the stripe's centre, rows (or columns).
        strength: its smoothed peak above the background, grey levels of the response.
        width: full width at half height, px.
        relief: height of the peak above the lowest point of the window, whatever lies between.
        whole: whether both its flanks are on the image and in the window.
        cramped: whether a wider window would tell more.
    """

    position: Float[Array, "frames lines"]
    strength: Float[Array, "frames lines"]
    width: Float[Array, "frames lines"]
    relief: Float[Array, "frames lines"]
    whole: Bool[Array, "frames lines"]
    cramped: Bool[Array, "frames lines"]


@partial(jax.jit, static_argnames=("color", "columns", "half"))
def gather_windows(
    images: Images,
    background: Backgrounds | None,
    ambient: Int[Array, "frames"],
    frame: Int[Array, "groups lines"],
    line: Int[Array, "groups lines"],
    peak: Int[Array, "groups lines"],
    color: str,
    columns: bool,
    half: int,
) -> tuple[Float[Array, "groups window lines"], Int[Array, "groups lines"]]:
    """The response in a window about each peak, and the window's first row; at the image's edge it is moved inwards.

    Args:
        images: the photographs.
        background: the same with the laser off, one for all or one for each, or None.
        ambient: c of `response`, for each photograph.
        frame: of each window, which photograph; windows come in groups, of a frame or of whatever one likes.
        line: which column (or row).
        peak: about which row (or column).
        color: of the laser, or grey.
        columns: whether windows run down columns or along rows.
        half: half the window's length.
    """
    size = 2 * half + 1
    first = jnp.clip(peak - half, 0, images.shape[1 if columns else 2] - size)
    place = (first, line) if columns else (line, first)
    dimensions = jax.lax.GatherDimensionNumbers(
        offset_dims=(1,) if images.ndim == 3 else (1, 3),
        collapsed_slice_dims=(0, 2) if columns else (0, 1),
        start_index_map=(0, 1, 2),
    )
    slice_sizes = (1, size, 1) if columns else (1, 1, size)

    def take(pixels: UInt[Array, "..."]) -> Array:
        of = jnp.zeros_like(frame) if pixels.shape[0] == 1 else frame
        return jax.lax.gather(
            pixels,
            jnp.stack([of, *place], axis=-1),
            dimensions,
            (*slice_sizes, *pixels.shape[3:]),
            mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS,
        )

    laser, others = split(take(images), None if background is None else take(background), color)
    limit = ambient.astype(others.dtype)[frame][:, None]
    return (laser - jnp.minimum(others, limit)).astype(jnp.float32), first


@jax.jit
def frame_noise(r: Float[Array, "frames window lines"]) -> Float[Array, "frames"]:
    """The noise of each frame's response (σ), from the ends of its windows."""
    flanks = jnp.stack([r[:, :_FLANK, ::_EVERY], r[:, -_FLANK:, ::_EVERY]])
    deviation = jnp.abs(flanks - flanks.mean(-2, keepdims=True)).mean((0, -2))
    return _DEVIATION_TO_SIGMA * jnp.median(deviation, axis=-1)


@jax.jit
def measure(r: Float[Array, "frames window lines"], first: Int[Array, "frames lines"]) -> Measured:
    """The stripe in each window of the response `r`, whose first row (or column) is `first`."""
    size = r.shape[1]
    k = jnp.arange(size, dtype=jnp.float32)[None, :, None]
    padded = jnp.pad(r, [(0, 0), (2, 2), (0, 0)], mode="edge")
    s = jnp.zeros_like(r)
    for i, weight in enumerate(_SMOOTHING):
        s += weight * padded[:, i : i + size]

    def least(values: Float[Array, "..."], where: Bool[Array, "..."]) -> Float[Array, "frames 1 lines"]:
        return jnp.where(where, values, jnp.inf).min(1, keepdims=True)

    top = s.max(1, keepdims=True)
    at = least(k, s == top)
    left, right = least(s, k < at), least(s, k > at)
    # At the image's edge there may be no pixel beyond the peak: then one side alone tells.
    floor = jnp.where(jnp.isfinite(left) & jnp.isfinite(right), jnp.maximum(left, right), jnp.minimum(left, right))
    half_height = (top + floor) / 2
    below = s < half_height
    start = -least(-k, below & (k < at))
    end = least(k, below & (k > at))
    # The crossings lie between the last pixel below and the first above.
    share = (s[:, 1:] - half_height) / jnp.where(s[:, 1:] == s[:, :-1], 1.0, s[:, 1:] - s[:, :-1])
    rise = start + 1 - jnp.where(k[:, :-1] == start, share, 0.0).sum(1, keepdims=True)
    fall = end - jnp.where(k[:, :-1] == end - 1, share, 0.0).sum(1, keepdims=True)
    whole = (start >= 0) & (end < size)
    middle = jnp.where(whole, (rise + fall) / 2, at)
    width = jnp.sqrt(jnp.maximum(jnp.where(whole, fall - rise, 0.0) ** 2 - _SMOOTHING_FWHM2, _LEAST_WIDTH_PX**2))
    centre = _centre_of_gravity(r - floor, k, middle, width)
    whole = whole & (centre > start) & (centre < end)
    return Measured(
        position=first.astype(jnp.float32) + centre[:, 0],
        strength=(top - floor)[:, 0],
        width=width[:, 0],
        relief=(top - s.min(1, keepdims=True))[:, 0],
        whole=whole[:, 0],
        cramped=((start < _FLANK) | (end >= size - _FLANK))[:, 0],
    )


def _centre_of_gravity(
    height: Float[Array, "frames window lines"],
    k: Float[Array, "1 window 1"],
    centre: Float[Array, "frames 1 lines"],
    width: Float[Array, "frames 1 lines"],
) -> Float[Array, "frames 1 lines"]:
    reach = _WINDOW_IN_HALF_WIDTHS * width / 2 + _WINDOW_MARGIN_PX
    for _ in range(_STEPS):
        # At the image's edge the window shrinks, and stays even.
        h = jnp.minimum(reach, jnp.minimum(centre, height.shape[1] - 1 - centre) + 1)
        offset = k - centre
        weight = jnp.maximum(1 - (offset / jnp.maximum(h, 1.0)) ** 2, 0.0) ** 2 * height
        total = weight.sum(1, keepdims=True)
        moment = (weight * offset).sum(1, keepdims=True)
        centre += _OVERSTEP * moment / jnp.where(total > 0, total, jnp.inf)
    return centre
