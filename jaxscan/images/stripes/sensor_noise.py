"""Read noise, shot noise and speckle of each frame, read off what the fits of its lines leave."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscan.images.stripes.grain import Chance, chance
from jaxscan.images.stripes.likelihood import Fit
from jaxscan.images.stripes.normal_equations import orthogonal
from jaxscan.images.stripes.ranks import median
from jaxscan.images.stripes.windows import Lines, Outline, Pixels, Sensor, Windows

# In how many groups of lines the noise is taken before what is usual of them.
_GROUPS = 8
# A stripe's tails are lower than this part of what is seen of its peak.
_TAIL = 0.1
# Its core is higher.
_CORE = 0.5
# Up to this full width at half height the last five of 25 pixels are free of it: 2.5 px is 2.1 σ less than 8 px away.
_CLEAR_WIDTH_PX = 5.0
# Of a burnt-out stripe it is read where its lines have no more than this share of what they leave in common: drawn ones
# have 0.01 to 0.06, real halos 0.1 to 0.4.
_MOST_COMMON = 0.12
# Of a burnt-out stripe, pixels higher than this part of a full one may be filled by speckle.
_MAY_FILL = 0.55
# Light's own noise is read where at least this part of the lines is not full.
_LEAST_FAIR = 0.5
# Lines beside which there is no texture are asked where they are this part of all.
_LEAST_EVEN = 0.2
# A line whose residual exceeds this multiple of the usual is not a sample of the noise.
_MOST_OF_USUAL = 8.0
_TINY = 1e-12


def sensor_noise(
    found: Fit,
    windows: Windows,
    around: Outline,
    shines: Bool[Array, "frames lines"],
    ground: Float[Array, "frames"],
    sensor: Sensor,
    correlation: Float[Array, "frames distances"] | None,
    roughly: bool,
) -> tuple[Chance, Bool[Array, "frames"]]:
    """Noise and speckle, and in which frames the stripes leave nothing in common.

    Lines without full pixels determine them, where these are no exception: of a burnt-out stripe they are its ends and
    edges, which are no sample of the others. Steep flanks beside a full core show the speckle too, if they are those
    of the model: what lines leave in common, be it a lens's halo or what a camera sharpens, is not of chance, and what
    it leaves beside that would be taken for speckle. Where stripes are so narrow that the ends of the windows are free
    of them, these show the sensor's noise.

    Args:
        found: fits of the frames' stripes.
        windows: what was fitted.
        around: its outline.
        shines: which lines have a stripe.
        ground: σ at the ends of the windows.
        sensor: what is known of it so far.
        correlation: as that of `survey`.
        roughly: whether speckle of single pixels will do, as weights of a next fit.
    """
    clean = shines & ~windows.full.any(1)
    enough = clean.sum(1) >= jnp.maximum(_LEAST_FAIR * shines.sum(1), 1)
    fair = jnp.where(enough[:, None], clean, shines)
    # What the surface's texture leaves is not the sensor's, nor the laser's.
    fair = evenly(windows, fair)
    # Where an edge runs along the stripe, the profile leaves much more than chance does.
    left = (found.weight * found.residual**2).sum(1)
    usual = median(jnp.where(fair, left, jnp.nan))[:, None]
    usable = left < _MOST_OF_USUAL * usual
    peak = around.top - around.floor
    every = jnp.where((shines & usable)[:, None], jnp.sqrt(found.weight), 0.0)
    every = every / jnp.sqrt(jnp.maximum(left, usual))[:, None]
    share = _share_in_common(every * found.residual, every * peak, found.profile.centre)
    apart = sensor.apart & (share < _MOST_COMMON)
    burnt = ~enough[:, None, None]
    read = (fair & usable & (enough | apart)[:, None])[:, None]
    root = jnp.where(read, jnp.sqrt(found.weight), 0.0)
    standard = root * found.residual
    height = jnp.maximum(found.height, 0.0)
    # A full pixel takes its part of what the fit takes, and shows nothing.
    square = jnp.where(windows.full, 0.0, root**2) * (1.0 if windows.gain is None else windows.gain)
    louder = jnp.ones_like(around.top) if windows.own is None else windows.own.louder
    taken = [root * y for y in orthogonal(found.jacobian, found.factor)]
    # Where speckle may fill a pixel, only its lesser values are left to be seen.
    shown = jnp.where(burnt & (height > _MAY_FILL * sensor.span[:, None, None]), 0.0, 1.0)
    if roughly:
        # Of a projection's trace: what a fit takes of independent pixels, all together.
        rest = square - square * sum(y * y for y in taken)
        rest *= shown
        speckle = _quotient(shown * standard**2 - rest * louder * ground[:, None, None] ** 2, rest * height**2)
        zero = jnp.zeros_like(ground)
        return Chance(ground**2, zero, jnp.clip(speckle, 0.0, 1.0), zero, zero), apart
    core, tail = (jnp.where(where, shown, 0.0) for where in (height > _CORE * peak, height < _TAIL * peak))
    clear = median(jnp.where(shines, around.width[:, 0], jnp.nan)) < _CLEAR_WIDTH_PX
    light = chance(
        standard=standard,
        unit=louder * square,
        # Flanks alone do not distinguish photons from speckle.
        photons=jnp.where(burnt, 0.0, square * height),
        light=jnp.sqrt(square) * height,
        regions=(tail, shown - core - tail, core),
        taken=taken,
        read2=ground**2,
        known=clear,
        groups=_GROUPS,
        by_tails=sensor.coded,
        span=sensor.span,
        ln_s=sensor.ln_s,
        correlation=correlation,
    )
    # A profile that is not the model's is off over several pixels, as grains are.
    return light._replace(grain=jnp.where(apart, light.grain, 0.0)), apart


def evenly(windows: Windows, lines: Bool[Array, "frames lines"]) -> Bool[Array, "frames lines"]:
    """Those of some lines beside which there is no texture, where these are enough."""
    if windows.own is None:
        return lines
    even = lines & ~windows.own.textured[:, 0]
    return jnp.where((even.sum(1) >= _LEAST_EVEN * lines.sum(1))[:, None], even, lines)


def _quotient(over: Pixels, under: Pixels) -> Float[Array, "frames"]:
    """The quotient of sums over each frame's lines; a few of these may be far off.

    It is the median over groups of neighbouring lines that show as much: of a stripe that is burnt out but for some
    lines, groups of as many lines would show little.
    """
    over, under = over.sum(1), under.sum(1)
    upto = jnp.cumsum(under, axis=1)
    which = jnp.floor(_GROUPS * (upto - under / 2) / jnp.maximum(upto[:, -1:], _TINY))
    member = (which[..., None] == jnp.arange(_GROUPS)[None, None]).astype(jnp.float32)
    over, under = (jnp.einsum("fl,flg->fg", x, member) for x in (over, under))
    return jnp.nan_to_num(median(jnp.where(under > 0, over / under, jnp.nan)))


def _share_in_common(standard: Pixels, peak: Pixels, centre: Lines) -> Float[Array, "frames"]:
    """Which share of the squares of residuals a frame's lines have in common.

    Speckle differs from line to line. What is the same in all, pixel by pixel from the centre on, is a profile that is
    not the model's.

    Args:
        standard: residuals over their σ; 0 of lines that are not read.
        peak: the height of each line's stripe over the same σ.
        centre: of each line's stripe.
    """
    size = standard.shape[1]
    at = jnp.arange(size)[None, :, None] + jnp.rint(centre).astype(jnp.int32) - size // 2
    inside = (at >= 0) & (at < size)
    z, p = (jnp.where(inside, jnp.take_along_axis(x, jnp.clip(at, 0, size - 1), axis=1), 0.0) for x in (standard, peak))
    common = (p * z).sum(2) ** 2 / jnp.maximum((p * p).sum(2), _TINY)
    share = common.sum(1) / jnp.maximum((z * z).sum((1, 2)), _TINY)
    # Of n lines that have nothing in common, a share of 1 / n.
    by_chance = 1 / jnp.maximum((p.max(1) > 0).sum(1), 2)
    return (share - by_chance) / (1 - by_chance)
