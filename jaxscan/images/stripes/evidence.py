"""Evidence for an edge of reflectance in a stripe that speckle cannot give: an edge goes on from line to line.

Where an edge runs along a stripe, what the plain profile leaves has a shape, and neighbouring lines have it alike.
Speckle multiplies the light of each pixel by chance: it leaves as much, but in each line another shape. The shape is
measured by h₃ and h₄, the Gauss-Hermite coefficients of third and fourth order (R. van der Marel and M. Franx 1993).
Over a window of n lines, with m the mean of a coefficient, v its variance and ρ_k its correlation at a distance of k
lines,

    t² = n / τ (m₃² / v₃ + m₄² / v₄),    τ = 1 + 2 Σ ρ_k,  k < K

v and ρ are those of chance alone. They are read from the differences of lines that are at most K apart, over which an
edge goes on and beyond which no grain of speckle does: γ_k = ½ ⟨(h_i − h_(i+k))²⟩ = v (1 − ρ_k), and ρ_K = 0.
"""

import numpy as np
from jaxtyping import Bool, Float, Num

from jaxscan.images.stripes.variogram import variogram

# No difference of two fits is as small; its inverse is a number in float32 too.
_TINY = 1e-20
# Half the lengths of the windows: an edge may run along a stripe for long or for a little.
_HALF_WINDOWS = (4, 16)
# K.
_GRAIN = 8
# t² by chance alone: of two squares of normal numbers one in 20 000 is as large.
_LEAST_T2 = 20.0
_FEWEST = 5
# In a few lines v may come out small by chance: it is no less than this part of what most lines of the frame have.
_LEAST_OF_USUAL = 0.5
# Where at least this part of the lines has evidence for an edge, and less than that part of these once what all lines
# have in common is taken out, it is the laser's profile.
_MANY, _REST = 0.1, 0.3
# Where edges run along more than that part of the lines, this part is taken to have hardly one.
_MOST, _LEAST = 0.4, 0.12
# The variance of means of neighbours over that within them (JPEGs: up to 5). Values beyond this multiple of the mean
# are clipped.
_ALIKE, _CLIP = 8.0, 4.0

Lines = Float[np.ndarray, "frames lines"]


def edges_go_on(
    h3: Lines, h4: Lines, seen: Bool[np.ndarray, "frames lines"], asked: Bool[np.ndarray, "frames lines"]
) -> Bool[np.ndarray, "frames lines"]:
    """Which lines lie in a window over which the shape of what is left goes on.

    Args:
        h3: of each line, in parts of the stripe's height.
        h4: likewise.
        seen: which lines have a stripe; the others are not read.
        asked: of which lines it is asked. Frames in which they are few have no edge.
    """
    found = np.zeros_like(seen)
    some = asked.sum(1) >= _FEWEST
    if some.any():
        found[some] = _go_on(h3[some], h4[some], seen[some])
    return found & asked


def edges_and_profiles(
    h3: Lines, h4: Lines, seen: Bool[np.ndarray, "frames lines"], asked: Bool[np.ndarray, "frames lines"]
) -> tuple[Bool[np.ndarray, "frames lines"], Bool[np.ndarray, "frames"]]:
    """Which lines have evidence for an edge, and which frames a stripe that is no bell.

    An edge runs along a stripe now on one side of its middle, now on the other. What is the same all along the stripe
    is the profile of the laser: it is taken out.

    Args:
        h3: as `edges_go_on` has them, all four.
        h4: likewise.
        seen: likewise.
        asked: likewise.
    """
    edges = edges_go_on(h3, h4, seen, asked)
    many = np.flatnonzero(edges.sum(1) > _MANY * seen.sum(1))
    odd = np.zeros(len(edges), bool)
    if len(many):
        own = [h[many] - np.nanmedian(np.where(seen[many], h[many], np.nan), axis=1, keepdims=True) for h in (h3, h4)]
        rest = edges_go_on(own[0], own[1], seen[many], asked[many])
        odd[many] = rest.sum(1) < _REST * edges[many].sum(1)
        edges[many] = np.where(odd[many, None], rest, edges[many])
    return edges, odd


def mostly_torn(
    h3: Lines, h4: Lines, seen: Bool[np.ndarray, "frames lines"]
) -> tuple[Bool[np.ndarray, "frames"], Bool[np.ndarray, "frames lines"]]:
    """In which frames edges run along too large a share of the lines (taken for noise); which lines have hardly one.

    Args:
        h3: as `edges_go_on` has them, all three.
        h4: likewise.
        seen: likewise.
    """
    has_edge, even = np.zeros(len(seen), bool), np.zeros_like(seen)
    some = np.flatnonzero(_alike(h3, seen) | _alike(h4, seen))
    if len(some):
        h3, h4, seen = h3[some], h4[some], seen[some]
        edges, odd = edges_and_profiles(h3, h4, seen, seen)
        has_edge[some] = ~odd & (edges.sum(1) > _MOST * seen.sum(1))
        known = seen & np.isfinite(h3) & np.isfinite(h4)
        n = np.maximum(over(known.astype(np.float64), _HALF_WINDOWS[0]), 1)
        shape = sum((over(np.where(known, h, 0.0).astype(np.float64), _HALF_WINDOWS[0]) / n) ** 2 for h in (h3, h4))
        shape = np.where(known, shape, np.inf)
        last = np.ceil(_LEAST * known.sum(1, keepdims=True)).astype(int)
        even[some] = known & (shape <= np.take_along_axis(np.sort(shape, axis=1), last, axis=1))
    return has_edge, even


def _alike(h: Lines, seen: Bool[np.ndarray, "frames lines"]) -> Bool[np.ndarray, "frames"]:
    """Whether neighbours have more in common than lines that are far apart: told soon, and seldom so without edges."""
    whole = h.shape[1] // _GRAIN * _GRAIN
    known = (seen & np.isfinite(h))[:, :whole]
    h = np.where(known, h[:, :whole], 0.0)
    usual = np.abs(h).sum(1, keepdims=True) / np.maximum(known.sum(1, keepdims=True), 1)
    h = np.clip(h, -_CLIP * usual, _CLIP * usual)
    blocks, n = (x.reshape(len(h), -1, _GRAIN).sum(2) for x in (h, known))
    between, all_ = (blocks**2 / np.maximum(n, 1)).sum(1), (h * h).sum(1)
    freedom = (n > 0).sum(1)
    return between * np.maximum(known.sum(1) - freedom, 1) > _ALIKE * freedom * np.maximum(all_ - between, 0.0)


def _go_on(h3: Lines, h4: Lines, seen: Bool[np.ndarray, "frames lines"]) -> Bool[np.ndarray, "frames lines"]:
    t2 = [np.zeros(seen.shape) for _ in _HALF_WINDOWS]
    for h in (h3, h4):
        known = seen & np.isfinite(h)
        h = np.where(known, h, 0.0).astype(np.float64)
        tau, usual = _chance(h, known)
        squares, pairs = _differences(h, known, _GRAIN)
        for total, half in zip(t2, _HALF_WINDOWS, strict=True):
            n = over(known.astype(np.float64), half)
            mean = over(h, half) / np.maximum(n, 1)
            variance = over(squares, half) / np.maximum(over(pairs, half), 1)
            variance = np.maximum(variance, _LEAST_OF_USUAL * usual)
            total += np.where((n >= _FEWEST) & (variance > 0), n / tau * mean**2 / np.maximum(variance, 1e-30), 0.0)
    found = [
        over((each > _LEAST_T2).astype(np.float64), half) > 0 for each, half in zip(t2, _HALF_WINDOWS, strict=True)
    ]
    return seen & np.any(found, axis=0)


def _differences(h: Lines, known: Bool[np.ndarray, "frames lines"], k: int) -> tuple[Lines, Lines]:
    """½ (h_i − h_(i+k))² in the middle between the two, 0 where one is not known; and 1 where both are."""
    both = (known[:, k:] & known[:, :-k]).astype(np.float64)
    squares = 0.5 * both * (h[:, k:] - h[:, :-k]) ** 2
    pad = (0, 0), (k // 2, k - k // 2)
    return np.pad(squares, pad), np.pad(both, pad)


def _chance(
    h: Lines, known: Bool[np.ndarray, "frames lines"]
) -> tuple[Float[np.ndarray, "frames 1"], Float[np.ndarray, "frames 1"]]:
    """τ and v of each frame, by medians, which the ends of edges do not move."""
    each = [variogram(h, known, k) for k in range(1, _GRAIN + 1)]
    *nearer, last = np.nan_to_num(each)[:, :, None]
    tau = 1 + 2 * sum(np.clip(1 - one / np.maximum(last, _TINY), 0.0, 1.0) for one in nearer)
    return np.asarray(tau), last


def over(
    values: Num[np.ndarray, "frames lines"] | Bool[np.ndarray, "frames lines"], half: int
) -> Num[np.ndarray, "frames lines"]:
    """The sum over each line and `half` lines on either side."""
    sums = np.cumsum(np.pad(values, ((0, 0), (half + 1, half))), axis=1)
    return sums[:, 2 * half + 1 :] - sums[:, : -2 * half - 1]
