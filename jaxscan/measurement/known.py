"""How well a fit determines the numbers of its shape: by the points' noise, by the rig, and by what neither shows.

Every point has noise of its own, δᵢ = σᵢ εᵢ; with the rig's errors δθ all of them move, δ = D δθ, Dᵢ = gᵢ ∂xᵢ/∂θ. So

    cov p = s² G C Gᵀ + (G D) Σ (G D)ᵀ + G U Uᵀ Gᵀ,    Cᵢⱼ = σᵢ ρᵢⱼ σⱼ,

G as in `fit`, Σ the rig's covariance; the second part does not shrink with the number of points, nor does the third, U
the smooth errors of the detector. s² is what the residuals say of the noise, in units of σ², and ρ how alike errors of
neighbours are, along a stripe and from frame to frame (`alike`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.measurement.alike import Alike
from jaxscan.measurement.fit import Fit, dots, few
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.shapes import Shape, lengths

# Of how many points the rig's part is taken: it is smooth over the surface.
_OF_RIG: Final = 2000
_SINGULAR: Final = 1e-12
# The least part of the noise that is taken to be left in the residuals.
_LEFT: Final = 0.2
# The least part of the residuals' squares that is taken to be noise, whatever the rig may have done to the form.
_NOT_RIG: Final = 0.1
# Errors of a detector that are smooth, px, and over which part of a feature; and by how much an image is blurred.
_SMOOTH_PX, _THIRDS, _BLUR_PX = 0.01, 3, 0.7


@dataclass(frozen=True)
class Known:
    """How well the numbers of a fitted shape are known.

    Attributes:
        scale: s, what the residuals are in units of the points' σ.
        tau: how many points are worth one.
        freedom: of the points' part of the variance, by `Alike.freedom`.
        own: covariance of the shape's numbers by the points' own noise, mm².
        by_rig: how the numbers move with the rig's leaves; None without a rig.
    """

    scale: float
    tau: float
    freedom: float
    own: Float[np.ndarray, "numbers numbers"]
    by_rig: Float[np.ndarray, "numbers leaves"] | None


def known(scanned: Scanned, fit: Fit, alike: Alike, least: float = 0.0) -> Known:
    """How well a fit determines the shape's numbers.

    Args:
        scanned: what it was fitted to.
        fit: the fit.
        alike: how alike neighbours' errors are in the scan.
        least: the least scale, by what other features of the scan say.

    Raises:
        InputError: the points do not determine the shape.
    """
    shape, x = fit.shape, scanned.points[fit.used]
    A = shape.jacobian(x) / fit.spread[:, None]
    values = np.linalg.eigvalsh(A.T @ A)
    if values[0] <= _SINGULAR * values[-1]:
        raise InputError("its points do not determine it: they may lie on a line, or in one place; enlarge the region")
    place = None if scanned.place is None else scanned.place[fit.used]
    tau = alike.tau(scanned.image is None)
    by_rig, of_rig = None, 0.0
    if scanned.by_rig is not None and scanned.covariance is not None:
        some = few(len(x), _OF_RIG)
        moved = moved_by_rig(scanned, shape, fit.used[some])
        by_rig = response(shape, x[some], fit.spread[some]) @ moved
        left_by_rig = (moved + shape.jacobian(x[some]) @ by_rig) / fit.spread[some, None]
        of_rig = len(x) * float(np.einsum("pi,ij,pj->p", left_by_rig, scanned.covariance, left_by_rig).mean())
    share = grazing(scanned, fit)
    # What the fit has taken up is `numbers` of the independent points, which are fewer than there are. What a wrong rig
    # does to the form is in `by_rig`, and does not count as noise once more.
    independent = float((share**2).sum())
    left = max(independent - shape.numbers * tau, _LEFT * independent)
    squares = float(((fit.residuals / fit.spread) ** 2).sum())
    scale = max(float(np.sqrt(max(squares - of_rig, _NOT_RIG * squares) / left)), least)
    follows = np.linalg.solve(A.T @ A, A.T) * share
    own = scale**2 * alike.variance(place, follows, scanned.image is None) + _unseen(scanned, fit, follows)
    return Known(scale, tau, alike.freedom(len(x), shape.numbers, scanned.image is None), own, by_rig)


def _unseen(
    scanned: Scanned, fit: Fit, follows: Float[np.ndarray, "numbers used"]
) -> Float[np.ndarray, "numbers numbers"]:
    """What errors of the detector that are too smooth to be seen in the residuals do to a shape's numbers.

    The stripe's place within a pixel, its brightness along the columns: about `_SMOOTH_PX`, alike over a third of a
    feature. And lens and pixels take the mean over some columns, which moves a point of a round surface to its inside
    by s² κ / 2, κ its curvature: that much is open too.

    Args:
        scanned: what was fitted.
        fit: the fit.
        follows: how the numbers follow an error of one σ of each point.
    """
    if scanned.place is None or scanned.stripe is None or not scanned.stripe_mm:
        return np.zeros((len(follows), len(follows)))
    place = scanned.place[fit.used]
    low, high = place.min(axis=0), place.max(axis=0) + 1
    third = (place - low) * _THIRDS // (high - low)
    sigma_px = float(np.median(lengths(scanned.stripe[fit.used]))) / scanned.stripe_mm
    moved = np.eye(_THIRDS**2)[third @ [_THIRDS, 1]] * (_SMOOTH_PX / sigma_px)
    blunted = (_BLUR_PX * scanned.column_mm) ** 2 / 2 * fit.shape.curvature(scanned.points[fit.used])
    both = follows @ np.concatenate([moved, (blunted / fit.spread)[:, None]], axis=1)
    return both @ both.T


def grazing(scanned: Scanned, fit: Fit) -> Float[np.ndarray, "used"]:
    """What the stripe's errors do to each distance, in units of `spread`: 1 but where the line grazes, less there."""
    if scanned.stripe is None:
        return np.ones(len(fit.used))
    slope = dots(fit.shape.gradient(scanned.points[fit.used]), scanned.stripe[fit.used])
    return np.minimum(np.abs(slope) / fit.spread, 1.0)


def response(
    shape: Shape, x: Float[np.ndarray, "some 3"], spread: Float[np.ndarray, "some"]
) -> Float[np.ndarray, "numbers some"]:
    """G: how a shape's numbers follow the distances of its points."""
    J = shape.jacobian(x)
    weighted = J / spread[:, None] ** 2
    return -np.linalg.solve(J.T @ weighted, weighted.T)


def moved_by_rig(scanned: Scanned, shape: Shape, some: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some leaves"]:
    """D: how the distances of points from a shape follow the rig's leaves."""
    assert scanned.by_rig is not None
    return np.einsum("pi,pil->pl", shape.gradient(scanned.points[some]), scanned.by_rig(some))
