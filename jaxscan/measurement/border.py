"""The border of shapes: how far lens and pixels put it off, as a scan shows, and how much of it is left out.

Lens and pixels mix what neighbouring columns see. On a surface that goes on this cancels; beside its edge, or where it
turns out of sight, the stripe is seen off by s² (v′ (ln I)′ + v″ / 2), v its row and I its brightness along the
columns: 0.05 to 0.15 px in the last column of a ball, outwards, and as much inwards where a cone stands on a plate. Of
a shape k let it be aₖ times a profile b over the last columns, aₖ ~ N(0, A²) with one A for the scan. With r the
residuals of a fit, in units of σ, and M = 1 − A (Aᵀ A)⁻¹ Aᵀ what a fit leaves of anything, each shape says

    âₖ = bᵀ M r / bᵀ M b,    of the variance sₖ² = bᵀ M C M b / (bᵀ M b)²,

whatever its own numbers are, and all of them together how likely each A is (`evidence`). A scan that was not blurred,
or whose noise hides it, keeps its border, in which the most is to be known of a round shape; one that was blurred loses
as many columns as the mean square of its numbers' errors asks for. Of the rest aₖ b is taken off, as far as it is
known, and the intervals hold its mean square.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from jaxscan.measurement.alike import Alike, how_alike
from jaxscan.measurement.evidence import Shown, weights
from jaxscan.measurement.fit import FEWEST, LIMIT, Settled, few, off_shape
from jaxscan.measurement.known import grazing
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.shapes import lengths, total

# The errors of the last columns, as parts of the last one's, and the least part of a shape's points that is left.
_PROFILE, _INNER = (1.0, 0.35, 0.2, 0.1), 0.5
# What A may be, px, and how much likelier 0 is beforehand than that it is one of the others.
_SIZES_PX, _SHARP = np.array([0.0, 0.0125, 0.025, 0.05, 0.1]), 49.0
# Of how many points the rig's part is taken.
_OF_RIG: Final = 500
# Where the shape itself takes up more than this of an error of the border, nothing is shown.
_TAKEN_UP: Final = 1e-6


@dataclass(frozen=True)
class _Edged:
    """A shape's points, and which of them are near its border.

    Attributes:
        settled: the shape.
        deep: how many columns each is from the end along the stripe, up to those of a border; 0 in the last.
        A: derivatives of its distances by its numbers, in units of σ.
        N: Aᵀ A.
        left: what is left of the distances, in units of σ.
        spread: this σ, mm.
        profile: what an error of one pixel in the last column does to each distance, in units of σ.
    """

    settled: Settled
    deep: Int[np.ndarray, "used"]
    A: Float[np.ndarray, "used numbers"]
    N: Float[np.ndarray, "numbers numbers"]
    left: Float[np.ndarray, "used"]
    spread: Float[np.ndarray, "used"]
    profile: Float[np.ndarray, "used"]


def without_borders(scanned: Scanned, shapes: Mapping[str, Settled]) -> dict[str, Settled]:
    """Shapes without the points of their borders that harm more than they say.

    Args:
        scanned: a range image with the rig's errors; of anything else nothing is left out.
        shapes: of one scan, by name.
    """
    if not shapes or scanned.place is None or scanned.image is None or not scanned.stripe_mm:
        return dict(shapes)
    border = int(np.ceil(len(_PROFILE) / scanned.pitch_px))
    edged = {name: _edged(scanned, settled, border) for name, settled in shapes.items()}
    # Of the others, for the border's errors are alike too.
    alike = how_alike(
        [
            (scanned.place[each.settled.used[inner]], each.left[inner], each.A.shape[1])
            for each in edged.values()
            if (inner := each.deep == border).sum() >= FEWEST
        ]
    )
    shown = _shown(scanned, list(edged.values()), alike)
    off, squares, blurred = expected(shown)
    return {
        name: replace(_best(each, border, alike.tau(), mean, float(np.sqrt(square))), blurred=blurred)
        for (name, each), mean, square in zip(edged.items(), off, squares, strict=True)
    }


def expected(
    shown: Sequence[Shown | None],
) -> tuple[Float[np.ndarray, "shapes"], Float[np.ndarray, "shapes"], float]:
    """E aₖ, px, and E aₖ², px², of the border's error of each shape, and how likely it is that A is not 0.

    Args:
        shown: âₖ and sₖ²; None where a shape shows nothing.
    """
    likely = weights([each for each in shown if each is not None], _SIZES_PX, _SHARP)
    squares = _SIZES_PX**2
    off, of_squares = np.zeros(len(shown)), np.full(len(shown), likely @ squares)
    for k, each in enumerate(shown):
        if each is not None:
            found, noise = float(each.found[0]), float(each.noise[0, 0])
            kept = squares / (squares + noise)
            off[k], of_squares[k] = likely @ kept * found, likely @ ((kept * found) ** 2 + kept * noise)
    return off, of_squares, float(1 - likely[0])


def _edged(scanned: Scanned, settled: Settled, border: int) -> _Edged:
    assert scanned.place is not None
    assert scanned.stripe is not None
    shape, used = settled.shape, settled.used
    place = scanned.place[used]
    aside = np.array([0, border])
    low, high = place.min(axis=0) - aside, place.max(axis=0) + aside + 1
    near = np.flatnonzero(((scanned.place >= low) & (scanned.place < high)).all(axis=1))
    grid = np.zeros(high - low, bool)
    at, own = tuple((scanned.place[near] - low).T), tuple((place - low).T)
    grid[own] = True
    # A region's border is none of the shape.
    asked = (ndimage.binary_dilation(grid, np.ones((1, 2 * border + 1))) & ~grid)[at]
    if asked.any():
        off = off_shape(scanned, shape, near[asked], nearest=True)
        grid[tuple(axis[asked] for axis in at)] = np.abs(off.distance) <= LIMIT * settled.sigma * off.spread
    deep = np.zeros(len(used), int)
    for columns in range(1, border + 1):
        deep += np.asarray(ndimage.binary_erosion(grid, np.ones((1, 2 * columns + 1))), bool)[own]
    off = off_shape(scanned, shape, used, nearest=True)
    sigma_px = float(np.median(lengths(scanned.stripe[used]))) / scanned.stripe_mm
    profile = np.array([*_PROFILE, 0.0])[np.minimum(deep * int(scanned.pitch_px), len(_PROFILE))] / sigma_px
    profile *= grazing(scanned, shape, used, off.spread)
    A = shape.jacobian(off.foot) / off.spread[:, None]
    return _Edged(settled, deep, A, A.T @ A, off.distance / off.spread, off.spread, profile)


def _shown(scanned: Scanned, edged: Sequence[_Edged], alike: Alike) -> list[Shown | None]:
    """â and s² of each; None where nothing is shown."""
    assert scanned.place is not None
    some = [few(len(each.left), _OF_RIG) for each in edged]
    by_rig = scanned.by_rig
    # All at once, for a call costs more than its points.
    moved = (
        None
        if by_rig is None
        else by_rig(np.concatenate([e.settled.used[s] for e, s in zip(edged, some, strict=True)]))
    )
    shown: list[Shown | None] = []
    for k, each in enumerate(edged):
        settled, b, A = each.settled, each.profile, each.A
        left = b - A @ (np.linalg.pinv(each.N) @ (A.T @ b))
        by = total(left, b)
        if by <= _TAKEN_UP * total(b, b):
            shown.append(None)
            continue
        noise = settled.sigma**2 * float(alike.variance(scanned.place[settled.used], left[None])[0, 0])
        if moved is not None and scanned.covariance is not None:
            # What a wrong rig does to the form is no border.
            own = moved[sum(map(len, some[:k])) :][: len(some[k])]
            gradient = settled.shape.gradient(scanned.points[settled.used[some[k]]])
            weight = len(left) / len(some[k]) * left[some[k]] / each.spread[some[k]]
            follows = np.einsum("p,pi,pil->l", weight, gradient, own)
            noise += float(follows @ scanned.covariance @ follows)
        shown.append(Shown(np.array([total(left, each.left) / by]), np.array([[noise / by**2]])))
    return shown


def _best(edged: _Edged, border: int, tau: float, off: float, size: float) -> Settled:
    """As much of the border left out as makes tr C₀⁻¹ (C + c cᵀ) least.

    C is what the points that are left make of the noise, c what the border's errors would do to the numbers, C₀ that of
    all points.
    """
    settled, deep, A = edged.settled, edged.deep, edged.A
    beside, whole, least, best = size * edged.profile, edged.N, np.inf, settled
    for columns in range(border + 1):
        inner = deep >= columns
        if inner.sum() < max(_INNER * len(deep), FEWEST):
            break
        C = np.linalg.pinv(A[inner].T @ A[inner] if columns else whole)
        c = C @ (A[inner].T @ beside[inner])
        expected = float(np.trace(whole @ C)) * settled.sigma**2 * tau + float(c @ whole @ c)
        if expected < least:
            least = expected
            best = replace(settled, used=settled.used[inner], off=off * edged.profile[inner], beside=beside[inner])
    return best
