"""Speckle whose grains are larger than a pixel: what neighbouring pixels have in common is taken off.

Speckle multiplies the light A P of a pixel by 1 + ε. Of pixels j apart in a line, ε has the covariance C² ρ^(j²), with
C the contrast and ρ the correlation of neighbours, a Gaussian law, and the pixels of a line that of

    V = diag(v) + C² diag(A P) (R − I) diag(A P),    R_ij = ρ^((i − j)²),    v = read² + shot · A P + C² (A P)²

V is not factored: ε is taken for the autoregressive sequence of second order that has the same variance and first two
correlations (N. Levinson 1947, J. Durbin 1960),

    ε_k = ρ (1 + ρ²) ε_(k−1) − ρ² ε_(k−2) + η_k,    var η = C² (1 − ρ²) (1 − ρ⁴)

and R. Kalman's filter (1960) makes of a sequence of pixels its innovations over their σ, which are independent and of
unit variance, in one pass along the window.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscan.images.stripes import ranks
from jaxscan.images.stripes.windows import Lines, Pixels

# Number of distances for products of neighbouring pixels, plus one; from this number of pixels on there is no grain.
_LAGS: Final = 3
_DISTANCES: Final = 5
# ρ is one of this number of values, up to this: a grain of 2 px has 0.88.
_MOST, _STEPS, _MOST_SURE = 0.92, 47, 0.9
# To this part of itself noise and profile say what any of these products should be, however many pixels there are.
_MODEL = 0.1
# Of a stripe that is narrower than this standard deviation, ln px, few pixels say how it lies on them.
_LN_RESOLVED: Final = -0.7
# What each further number must explain at the least, in twice the logarithm of the likelihood.
_PRICE: Final = 3.0
# Sensors hold this number of photons and more in a full pixel. Who takes noise for that of fewer, of a third of it, of
# a ninth, pays as for one more number, for two.
_PHOTONS: Final = 1000.0
_FEWER: Final = 3.0
# Every Nth line serves to estimate the expected residuals of the others.
_EXPECTED: Final = 2
# A sum of fewer independent pixels than this shows nothing.
_FEWEST: Final = 1e-3
_TINY: Final = 1e-12

Frames = Float[Array, "frames"]


class _Pixel(NamedTuple):
    """A pixel of each line: what is filtered, its light where it has speckle, its own noise, and 1 where it is used."""

    values: tuple[Lines, ...]
    light: Lines
    own: Lines
    used: Lines


class _State(NamedTuple):
    """What is expected of ε_k and ε_(k−1): for each sequence its means; and of all, their variances and covariance."""

    now: tuple[Lines, ...]
    before: tuple[Lines, ...]
    p: Lines
    q: Lines
    r: Lines


def innovations(
    values: Sequence[Pixels], light: Pixels, own: Pixels, used: Pixels, speckle: Lines, grain: Lines
) -> list[Pixels]:
    """Sequences of pixels as independent numbers of unit variance; 0 where a pixel is not used.

    Args:
        values: the sequences: residuals, derivatives.
        light: A P of each pixel; 0 where it has no speckle of its own.
        own: the rest of its variance.
        used: 1 of those that are read, 0 of the others.
        speckle: C².
        grain: ρ.
    """
    rho2 = grain**2
    a, b, fresh = grain * (1 + rho2), -rho2, speckle * (1 - rho2) * (1 - rho2**2)
    zero = jnp.zeros_like(speckle)
    start = _State((zero,) * len(values), (zero,) * len(values), speckle, speckle * grain, speckle)

    def step(state: _State, pixel: _Pixel) -> tuple[_State, tuple[Lines, ...]]:
        known = pixel.used / (pixel.light**2 * state.p + pixel.own)
        off = [value - pixel.light * now for value, now in zip(pixel.values, state.now, strict=True)]
        gain = pixel.light * known
        now = [mean + state.p * gain * by for mean, by in zip(state.now, off, strict=True)]
        before = [mean + state.q * gain * by for mean, by in zip(state.before, off, strict=True)]
        told = gain * pixel.light
        p, q, r = state.p - state.p**2 * told, state.q - state.p * state.q * told, state.r - state.q**2 * told
        after = _State(
            tuple(a * one + b * other for one, other in zip(now, before, strict=True)),
            tuple(now),
            a * a * p + 2 * a * b * q + b * b * r + fresh,
            a * p + b * q,
            p,
        )
        root = jnp.sqrt(known)
        return after, tuple(root * by for by in off)

    along = jax.tree.map(
        lambda x: jnp.moveaxis(jnp.broadcast_to(x, light.shape), 1, 0)[:, :, None],
        _Pixel(tuple(values), light, own, used),
    )
    _, found = jax.lax.scan(step, start, along)
    return [jnp.moveaxis(x[:, :, 0], 0, 1) for x in found]


class Chance(NamedTuple):
    """How a frame's pixels scatter: variance of the sensor's noise, shot noise, C² of the speckle, ρ.

    Where a camera has smoothed its noise, `even` is 1 if it did so on the stripe too, 0 if not there.
    """

    read2: Frames
    shot: Frames
    speckle: Frames
    grain: Frames
    even: Frames


def chance(
    standard: Pixels,
    unit: Pixels,
    photons: Pixels,
    light: Pixels,
    regions: Sequence[Pixels],
    taken: Sequence[Pixels],
    read2: Frames,
    known: Bool[Array, "frames"],
    groups: int,
    by_tails: Bool[Array, "frames"],
    span: Frames,
    ln_s: Frames,
    correlation: Float[Array, "frames distances"] | None = None,
) -> Chance:
    """Noise and speckle of each frame, from what fits of its stripes leave.

    A fit whose pixels have the weights W takes the projection on its derivatives out of what chance has put in:

        E z zᵀ = (I − Y Yᵀ) W^½ V W^½ (I − Y Yᵀ),    z = W^½ (y − μ),    Y an orthonormal basis of W^½ J

    What it leaves of z² in the stripe's regions, and of the products of pixels that are one and two apart, is linear in
    read², shot noise and C² ρ^(j²). Of these equations the solution is taken in which none is negative and that needs
    least: another number must explain more than chance does (H. Akaike 1974, at 1.5 times his price).

    Args:
        standard: z; 0 of lines and pixels that are not read.
        unit: the variance of W^½ y that read noise of 1 makes, likewise.
        photons: the variance that shot noise of 1 makes, likewise.
        light: W^½ A P, likewise.
        regions: 1 in each of the stripe's regions, 0 elsewhere.
        taken: Y, likewise.
        read2: the variance of the sensor's noise; of frames that do not show it, the most that it can be.
        known: which do.
        groups: into how many groups of lines a frame is divided: of their sums what is usual is taken.
        span: the response of a full pixel.
        ln_s: ln of the stripe's usual standard deviation in px.
        by_tails: in which frames all that is left in the stripe's tails is read noise, if that is more.
        correlation: of all noise of pixels 1, 2, … apart, where a camera has smoothed it; then no grain is looked for.
    """
    lags = range(1, _LAGS)

    def rest(unit: Pixels, taken: Sequence[Pixels]) -> Pixels:
        """Which part of each pixel's chance the fit leaves."""
        return jnp.where(unit > 0, 1.0 - sum(y * y for y in taken), 0.0)

    def numbers(regions: Sequence[Pixels], rest: Pixels) -> Float[Array, "sums frames"]:
        """How many independent pixels each sum has."""
        free = [(at * rest).sum((1, 2)) for at in regions]
        return jnp.maximum(jnp.stack([*free, *[sum(free, jnp.zeros_like(span))] * len(lags)]), _FEWEST)

    read, untaken = (unit > 0).any(1), rest(unit, taken)
    number = numbers(regions, untaken)
    each = [(at * standard**2).sum(1) for at in regions]
    each += [(standard[:, lag:] * standard[:, :-lag]).sum(1) for lag in lags]
    # Lines are divided among groups, in their order: no group is of lines without a stripe. What the sensor's noise
    # makes of each group is replaced by what it makes of all.
    which = jnp.cumsum(read, axis=1) - 1
    which = jnp.where(read, groups * which // jnp.maximum(read.sum(1, keepdims=True), 1), -1)
    member = (which[..., None] == jnp.arange(groups)[None, None]).astype(jnp.float32)
    noise = [(at * untaken * unit).sum(1) * read2[:, None] for at in regions]
    noise = jnp.stack([*noise, *[jnp.zeros_like(noise[0])] * len(lags)])
    excess = jnp.einsum("sfl,flg->sfg", jnp.stack(each) - noise, member)
    seen = ranks.usual(excess * groups / number[:, :, None]) + noise.sum(-1) / number
    # What is expected differs less from line to line than what is seen: some of the lines suffice.
    regions, taken = ([x[..., ::_EXPECTED] for x in each] for each in (regions, taken))
    unit, photons, light = (x[..., ::_EXPECTED] for x in (unit, photons, light))
    expected, projected = numbers(regions, rest(unit, taken)), _projected(regions, taken)

    def left(root: Pixels, apart: int) -> Float[Array, "sums frames"]:
        """What is left of noise whose pixels so far apart are alike: of each line, to the mean."""
        size = root.shape[1] - apart
        covariance = (2 if apart else 1) * root[:, apart:] * root[:, :size]
        return (projected[apart] * covariance[None]).sum((2, 3)) / expected

    roots = jnp.sqrt(unit), jnp.sqrt(photons), light
    by_read, by_photons, *by_distance = (left(root, 0) for root in roots)
    if correlation is None:
        rho = jnp.linspace(0.0, _MOST, _STEPS)
        priced = jnp.where(rho > 0, 1.0, 0.0)
        by_distance += [left(light, apart) for apart in range(1, _DISTANCES)]
        powers = rho[None] ** (jnp.arange(_DISTANCES)[:, None] ** 2)
        by_speckle, by_photons = jnp.einsum("jg,jsf->sgf", powers, jnp.stack(by_distance)), by_photons[:, None]
    else:
        # The stripe's own noise is smoothed like that beside it, or, by a filter that keeps edges, it is not.
        rho, priced = jnp.zeros(2), jnp.arange(2.0)
        white = by_read, by_photons, *by_distance
        by_read, *even = (
            own + sum(correlation[None, :, apart - 1] * left(root, apart) for apart in range(1, _DISTANCES))
            for own, root in zip(white, roots, strict=True)
        )
        by_photons, by_speckle = (jnp.stack(each, axis=1) for each in zip(even, white[1:], strict=True))
    # The tail's many pixels would outvote the core's few, and a read noise a little too large hide the speckle.
    unsure = _MODEL * jnp.maximum(jnp.exp(4 * (_LN_RESOLVED - ln_s)), 1.0)
    free = number / (1 + unsure[None] ** 2 * number)
    equations = seen[:, None], free[:, None], by_read[:, None], by_photons, by_speckle
    read2 = jnp.where(by_tails, jnp.maximum(read2, jnp.nan_to_num(seen[0] / by_read[0])), read2)
    known |= by_tails
    found = _least(*equations, rho, priced, read2, known, span)
    # What goes on as far as the list does is no speckle, but a profile that is not the model's.
    sure = found.grain < _MOST_SURE
    found = found._replace(speckle=jnp.where(sure, found.speckle, 0.0), grain=jnp.where(sure, found.grain, 0.0))
    # More than what is seen beside the stripe no sensor makes.
    return found._replace(read2=jnp.where(known | ~(found.read2 > 0), read2, jnp.minimum(found.read2, read2)))


def _least(
    seen: Array,
    free: Array,
    by_read: Array,
    by_photons: Array,
    by_speckle: Array,
    rho: Float[Array, "grains"],
    priced: Float[Array, "grains"],
    read2: Frames,
    known: Array,
    span: Frames,
) -> Chance:
    """The numbers that explain what is seen with the least need; all as (sums, grains, frames).

    Of n squares of variance v the mean m needs n (m / v − 1 − ln(m / v)); a product of two such numbers, which scatters
    by v², the square of what is left over that, and ln v². The scatter is that of what explains it, not of what is
    seen: five squares that are seven times those of the noise are no chance, though they scatter. The sensor's noise
    that is seen beside the stripe is one more such mean.

    Of the smoothed noise of a camera there are two cases in place of the grains.
    """
    regions = len(seen) - (_LAGS - 1)
    # Neither, photons, speckle, both.
    uses = jnp.asarray([[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]])[:, :, None, None, None]
    seen, free, by_read, by_photons, by_speckle = (x[None] for x in (seen, free, by_read, by_photons, by_speckle))
    read2, known, span = (x[None, None, None] for x in (read2, known, span))
    photons, speckles = uses[0] * by_photons, uses[1] * by_speckle
    # What is seen beside the stripe is known no better than the model is.
    beside, rest = 1 / _MODEL**2, seen - read2 * by_read

    def scatter(v: Array) -> Array:
        """The variance of each sum."""
        own = jnp.maximum(v[:, :regions], _TINY) ** 2
        product = (free[:, :regions] * own).sum(1, keepdims=True) / free[:, :regions].sum(1, keepdims=True)
        return jnp.concatenate([2 * own, *[product] * (_LAGS - 1)], axis=1) / free

    def solved(v: Array) -> tuple[Array, Array, Array]:
        """Read noise, photons and speckle, with the scatter of these variances."""
        weight = 1 / scatter(v)

        def dot(a: Array, b: Array) -> Array:
            return (weight * a * b).sum(1, keepdims=True)

        rr = dot(by_read, by_read) + jnp.where(known, beside / (2 * read2**2), 0.0)
        pr, sr, r = dot(by_read, photons), dot(by_read, speckles), dot(by_read, rest)
        pp = dot(photons, photons) - pr**2 / rr + 1 - uses[0]
        ss = dot(speckles, speckles) - sr**2 / rr + 1 - uses[1]
        ps = dot(photons, speckles) - pr * sr / rr
        p, s = dot(photons, rest) - pr * r / rr, dot(speckles, rest) - sr * r / rr
        determinant = pp * ss - ps**2
        # Where no line shows anything these are not numbers; what a candidate does not use is 0 all the same.
        a = jnp.where(uses[0] > 0, (p * ss - s * ps) / determinant, 0.0)
        b = jnp.where(uses[1] > 0, (s * pp - p * ps) / determinant, 0.0)
        return read2 + (r - a * pr - b * sr) / rr, a, b

    def explained(read: Array, a: Array, b: Array) -> Array:
        """The variance of each pixel of a sum."""
        return jnp.maximum(read, 0.0) * by_read + jnp.maximum(a, 0.0) * photons + jnp.maximum(b, 0.0) * speckles

    # First with the scatter of what is seen, which no pixel that is far off draws.
    seen_by_all = jnp.broadcast_to(seen, jnp.broadcast_shapes(photons.shape, speckles.shape))
    read, a, b = solved(explained(*solved(seen_by_all)))
    v = explained(read, a, b)
    x = jnp.maximum(seen[:, :regions], _TINY) / jnp.maximum(v[:, :regions], _TINY)
    left = scatter(v)[:, regions:]
    need = (free[:, :regions] * (x - 1 - jnp.log(x))).sum(1)
    need += ((seen[:, regions:] - v[:, regions:]) ** 2 / left + jnp.log(left)).sum(1)
    its = read2 / jnp.maximum(read, _TINY)
    need += jnp.where(known, beside * (its - 1 - jnp.log(its)), 0.0)[:, 0]
    read, a, b = (jnp.broadcast_to(each[:, 0], need.shape) for each in (read, a, b))
    by_grain = uses[1, :, 0] if by_photons.shape[2] == 1 else 1.0
    numbers = uses.sum(0)[:, 0] + by_grain * priced[None, :, None]
    numbers += jnp.maximum(jnp.log(jnp.maximum(a * _PHOTONS / span[0], _TINY)) / jnp.log(_FEWER), 0.0)
    possible = (a >= 0) & (b >= 0) & (b <= 1) & jnp.isfinite(need)
    best = jnp.argmin(jnp.where(possible, need + _PRICE * numbers, jnp.inf).reshape(-1, need.shape[-1]), axis=0)[None]
    own, shot, speckle = (jnp.take_along_axis(n.reshape(-1, n.shape[-1]), best, axis=0)[0] for n in (read, a, b))
    at = best[0] % len(rho)
    return Chance(own, shot, speckle, jnp.where(best[0] >= 2 * len(rho), rho[at], 0.0), jnp.where(at == 0, 1.0, 0.0))


def _projected(regions: Sequence[Pixels], taken: Sequence[Pixels]) -> list[Float[Array, "sums frames pixels lines"]]:
    """Diagonals of N = (I − Y Yᵀ) M (I − Y Yᵀ), M what takes one of the sums, zᵀ M z; of pixels 0, 1, … apart.

    Then E zᵀ M z = tr(N C), C = W^½ V W^½. With S = M Y − Y (Yᵀ M Y) / 2,

        N = M − Y Sᵀ − S Yᵀ
    """
    size, lags = taken[0].shape[1], range(1, _LAGS)
    made = [jnp.stack([*(at * y for at in regions), *(_both_ways(y, lag) / 2 for lag in lags)]) for y in taken]
    Y = [y[None] for y in taken]
    shared = [[(one * y).sum(2, keepdims=True) for y in Y] for one in made]
    S = [one - dot(row, Y) / 2 for one, row in zip(made, shared, strict=True)]
    diagonals = []
    for apart in range(_DISTANCES):
        near, far = slice(0, size - apart), slice(apart, size)
        ahead = dot([y[:, :, near] for y in Y], [s[:, :, far] for s in S])
        lost = jnp.asarray(ahead + dot([y[:, :, far] for y in Y], [s[:, :, near] for s in S]))
        of_regions = [at if apart == 0 else jnp.zeros_like(lost[0]) for at in regions]
        of_pairs = [jnp.full_like(lost[0], 0.5 if lag == apart else 0.0) for lag in lags]
        diagonals.append(jnp.stack([*of_regions, *of_pairs]) - lost)
    return diagonals


def dot(one: Sequence[Array], other: Sequence[Array]) -> Array | float:
    """The sum of the products of arrays; 0 of none."""
    return sum(a * b for a, b in zip(one, other, strict=True))


def _both_ways(values: Pixels, apart: int) -> Pixels:
    """The sum of the values so far before and so far after each pixel."""
    padded = jnp.pad(values, [(0, 0), (apart, apart), (0, 0)])
    return padded[:, : -2 * apart] + padded[:, 2 * apart :]
