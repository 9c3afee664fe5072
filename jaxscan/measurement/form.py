"""Form: how far a surface is from its shape, patch by patch, and what of that errors alone would show.

The lowest and the highest of n points are noise, and lie the further apart the more points there are. So points are
first averaged in patches: mⱼ = fⱼ + eⱼ, f the surface's own deviation and e what is left of all errors. The deviation
is F = max m − min m. Errors change it by no more than their own range, |F − (max f − min f)| ≤ max e − min e, and this
range has a known distribution: the noise of patch j has the variance s² τ σⱼ² / nⱼ, and the rig's part that the fit
has not taken up is (1 − J G) D δθ (`fit`), averaged likewise. So F ± R₉₅, with R₉₅ the 95th percentile of the range of
errors, holds the surface's deviation with at least 95 %. Waves that are shorter than a patch are not seen.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.measurement.fit import Fit, few
from jaxscan.measurement.known import Known, moved_by_rig
from jaxscan.measurement.scanned import Scanned

_ACROSS, _PATCHES = 3, 6
_ALONG: Final = 16
_FEWEST: Final = 10
# Points of a patch, at least; and patches of them of a surface, and of a line. Four of a dome are all alike.
_LEAST_IN_PATCH: Final = 5
LEAST_OF_SURFACE, _LEAST_OF_LINE = 6, 3
_DRAWINGS: Final = 4000
_OF_RIG: Final = 2000
_SEED: Final = 2003
CONFIDENCE: Final = 0.95

Patches = Int[np.ndarray, "points"]


@dataclass(frozen=True)
class Form:
    """A form deviation.

    Attributes:
        value: mm.
        uncertainty: half of the interval that holds the surface's own with at least 95 %, mm; None where the points'
            errors are not known.
        patches: of how many means.
    """

    value: float
    uncertainty: float | None
    patches: int


def form_of(scanned: Scanned, fit: Fit, found: Known) -> Form:
    """How far the surface is from a shape that was fitted to it."""
    along = scanned.place is not None and scanned.image is None
    patch = patches(scanned.points[fit.used], along)
    left = None
    if found.by_rig is not None:
        some = few(len(fit.used), _OF_RIG)
        x = scanned.points[fit.used[some]]
        left = some, moved_by_rig(scanned, fit.shape, fit.used[some]) + fit.shape.jacobian(x) @ found.by_rig
    noise = found.scale * np.sqrt(found.tau) * fit.spread
    least = _LEAST_OF_LINE if along else LEAST_OF_SURFACE
    return deviation(scanned, fit.residuals, patch, noise, left, np.ptp, least)


def deviation(
    scanned: Scanned,
    off: Float[np.ndarray, "points"],
    patch: Patches,
    noise: Float[np.ndarray, "points"],
    by_rig: tuple[Int[np.ndarray, "some"], Float[np.ndarray, "some leaves"]] | None,
    size: Callable[..., Float[np.ndarray, "*drawings"]],
    least: int,
) -> Form:
    """The deviation of means over patches.

    Args:
        scanned: whose points they are.
        off: of each point, mm.
        patch: in which it lies, −1 for none.
        noise: σ of each, such that those of a patch may be taken for independent, mm.
        by_rig: some of the points, and how what is off of them follows the rig's leaves.
        size: what of the means is the deviation, over the last axis.
        least: how many patches there must be.

    Raises:
        InputError: too few patches have enough points.
    """
    count = np.bincount(patch[patch >= 0])
    full = np.flatnonzero(count >= _LEAST_IN_PATCH)
    if len(full) < least:
        raise InputError(
            f"its {len(off)} points are too few for a form: {len(full)} of its patches have {_LEAST_IN_PATCH} points, "
            f"and {least} are needed: enlarge the region, or scan in smaller steps"
        )
    means = np.bincount(patch[patch >= 0], off[patch >= 0])[full] / count[full]
    value = float(size(means, axis=-1))
    if by_rig is None or scanned.covariance is None:
        return Form(value, None, len(full))
    sigma = np.sqrt(np.bincount(patch[patch >= 0], noise[patch >= 0] ** 2)[full]) / count[full]
    random = np.random.default_rng(_SEED)
    errors = sigma * random.normal(size=(_DRAWINGS, len(full)))
    some, D = by_rig
    mean = np.stack([D[patch[some] == k].mean(axis=0) if (patch[some] == k).any() else D[0] * 0 for k in full])
    values, vectors = np.linalg.eigh(scaled(scanned.covariance)[0])
    root = scaled(scanned.covariance)[1][:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    errors += random.normal(size=(_DRAWINGS, len(root))) @ (mean @ root).T
    return Form(value, float(np.quantile(size(errors, axis=-1), CONFIDENCE)), len(full))


def scaled(
    covariance: Float[np.ndarray, "leaves leaves"],
) -> tuple[Float[np.ndarray, "leaves leaves"], Float[np.ndarray, "leaves"]]:
    """The correlations of a covariance and the σ: a rig's numbers are of very different sizes."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    apart = np.where(sigma > 0, sigma, 1.0)
    return covariance / apart[:, None] / apart, sigma


def patches(x: Float[np.ndarray, "points 3"], along: bool) -> Patches:
    """Pieces of a surface of about equal size: squares across its two longest extents; pieces of a line, in order."""
    if along:
        return (np.arange(len(x)) * int(np.clip(len(x) // _FEWEST, _LEAST_OF_LINE, _ALONG))) // len(x)
    middle = x - x.mean(axis=0)
    flat = middle @ np.linalg.eigh(middle.T @ middle)[1][:, :0:-1]
    low, extent = flat.min(axis=0), np.ptp(flat, axis=0)
    across = np.sqrt(np.clip(len(x) / (2 * _FEWEST), _ACROSS**2, _PATCHES**2))
    counts = np.clip(np.round(across * np.sqrt(extent / extent[::-1])), 2, _PATCHES**2 / 2).astype(int)
    cell = np.minimum(((flat - low) / extent * counts).astype(int), counts - 1)
    return cell[:, 0] * counts[1] + cell[:, 1]
