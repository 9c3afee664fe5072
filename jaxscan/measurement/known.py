"""How well a fit determines the numbers of its shape: by the points' noise, by the rig, and by what neither shows.

Every point has noise of its own, δᵢ = σᵢ εᵢ; with the rig's errors δθ all of them move, δ = D δθ, Dᵢ = gᵢ ∂xᵢ/∂θ. So

    cov p = s² G C Gᵀ + (G D) Σ (G D)ᵀ + G U Uᵀ Gᵀ,    Cᵢⱼ = σᵢ ρᵢⱼ σⱼ,

G as in `fit`, Σ the rig's covariance; the second part does not shrink with the number of points, nor does the third, U
the smooth errors of the detector. s² is what the residuals say of the noise, in units of σ², and ρ how alike errors of
neighbours are, along a stripe and from frame to frame (`alike`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.measurement.alike import Alike
from jaxscan.measurement.evidence import Shown, weights
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
# How large smooth errors of a detector may be, px, over which part of a feature; and by how much a lens blurs an image.
_SMOOTH_PX, _THIRDS, _BLUR_PX = np.array([0.0, 0.00125, 0.0025, 0.005, 0.01]), 3, 0.7
# Of patches, what the shape takes up more than this part of shows nothing.
_TAKEN_UP: Final = 1e-6


@dataclass(frozen=True)
class Known:
    """How well the numbers of a fitted shape are known.

    Attributes:
        scale: s, what the residuals are in units of the points' σ.
        tau: how many points are worth one.
        freedom: of the points' part of the variance, by `Alike.freedom`.
        own: covariance of the shape's numbers by the points' own noise and what the border may be off by, mm².
        smooth: how the numbers move with smooth errors of each patch, mm/px.
        shown: what the residuals show of these; None where that is nothing.
        by_rig: how the numbers move with the rig's leaves; None without a rig.
    """

    scale: float
    tau: float
    freedom: float
    own: Float[np.ndarray, "numbers numbers"]
    smooth: Float[np.ndarray, "numbers patches"]
    shown: Shown | None
    by_rig: Float[np.ndarray, "numbers leaves"] | None


def known(scanned: Scanned, fit: Fit, alike: Alike, least: tuple[float, float] = (0.0, 1.0)) -> Known:
    """How well a fit determines the shape's numbers.

    Args:
        scanned: what it was fitted to.
        fit: the fit.
        alike: how alike neighbours' errors are in the scan.
        least: the least scale, by what other features of the scan say, and its degrees of freedom.

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
    by_rig, of_rig, some, left_by_rig = None, 0.0, few(len(x), _OF_RIG), None
    if scanned.by_rig is not None and scanned.covariance is not None:
        moved = moved_by_rig(scanned, shape, fit.used[some])
        by_rig = response(shape, x[some], fit.spread[some]) @ moved
        left_by_rig = (moved + shape.jacobian(x[some]) @ by_rig) / fit.spread[some, None]
        of_rig = len(x) * float(np.einsum("pi,ij,pj->p", left_by_rig, scanned.covariance, left_by_rig).mean())
    share = grazing(scanned, shape, fit.used, fit.spread)
    follows = np.linalg.solve(A.T @ A, A.T)
    unit = alike.variance(place, follows * share, scanned.image is None)
    # Of the noise's squares Σ share², a fit takes up tr Aᵀ A (G C Gᵀ) / s². What a wrong rig does to the form is in
    # `by_rig`, and does not count as noise once more.
    independent = float((share**2).sum())
    taken_up = float(np.einsum("ij,ji->", A.T @ A, unit))
    left = max(independent - taken_up, _LEFT * independent)
    squares = float(((fit.residuals / fit.spread) ** 2).sum())
    scale = float(np.sqrt(max(squares - of_rig, _NOT_RIG * squares) / left))
    freedom = alike.freedom(left, scanned.image is None)
    if scale < least[0]:
        scale, freedom = least[0], max(freedom, least[1])
    own = scale**2 * unit
    for wide in (follows @ _blurred(scanned, fit), follows @ fit.beside):
        own += np.outer(wide, wide)
    patches = _patches(scanned, fit, share)
    of_patches = patches.sums(A)
    smooth, shown = np.linalg.solve(A.T @ A, of_patches.T), None
    if left_by_rig is not None and scanned.covariance is not None and scanned.image is not None:
        # A patch is wide beside what is alike, so that τ holds.
        whole = np.diag(patches.sums(patches.weight[:, None])[:, 0]) - of_patches @ smooth
        residuals = fit.residuals / fit.spread
        found = patches.sums(residuals[:, None])[:, 0] - smooth.T @ (A.T @ residuals)
        rig = len(x) / len(some) * patches.part(some).sums(left_by_rig)
        shown = _shown(whole, found, scale**2 * tau * whole + rig @ scanned.covariance @ rig.T)
    return Known(scale, tau, freedom, own, smooth, shown, by_rig)


def with_smooth_errors(shapes: Mapping[str, Known]) -> dict[str, Known]:
    """With smooth errors of the detector in `own`: as large as all shapes of a scan show them."""
    likely = weights([each.shown for each in shapes.values() if each.shown is not None], _SMOOTH_PX)
    square = float(likely @ _SMOOTH_PX**2)
    return {name: replace(each, own=each.own + square * each.smooth @ each.smooth.T) for name, each in shapes.items()}


def _shown(
    whole: Float[np.ndarray, "patches patches"],
    found: Float[np.ndarray, "patches"],
    noise: Float[np.ndarray, "patches patches"],
) -> Shown | None:
    """What is shown of an error of each patch, in directions that the shape does not take up; None where none is left.

    Args:
        whole: Pᵀ M P, P what an error of one pixel of each patch does to the distances, in units of σ.
        found: Pᵀ M r, r what is left of these.
        noise: the covariance of `found` by all else.
    """
    values, vectors = np.linalg.eigh(whole)
    free = values > _TAKEN_UP * max(values[-1], 1e-300)
    if not free.any():
        return None
    to = vectors[:, free] / values[free]
    return Shown(to.T @ found, to.T @ noise @ to)


@dataclass(frozen=True)
class _Patches:
    """Patches of a feature's points.

    Attributes:
        which: the patch of each.
        weight: what an error of the stripe of one pixel does to each distance, in units of σ.
    """

    which: Int[np.ndarray, "used"]
    weight: Float[np.ndarray, "used"]

    def sums(self, values: Float[np.ndarray, "used sums"]) -> Float[np.ndarray, "patches sums"]:
        """Weighted sums over each patch."""
        return np.stack([np.bincount(self.which, self.weight * each, _THIRDS**2) for each in values.T], axis=1)

    def part(self, some: Int[np.ndarray, "some"]) -> "_Patches":
        """The patches of some of the points."""
        return _Patches(self.which[some], self.weight[some])


def _patches(scanned: Scanned, fit: Fit, share: Float[np.ndarray, "used"]) -> _Patches:
    """The patches over each of which a detector errs alike.

    It errs smoothly by the stripe's place within a pixel, and by its brightness along the columns: alike over about a
    third of a feature along both axes of the grid.
    """
    if scanned.place is None or scanned.stripe is None or not scanned.stripe_mm:
        return _Patches(np.zeros(len(fit.used), int), np.zeros(len(fit.used)))
    place = scanned.place[fit.used]
    low, high = place.min(axis=0), place.max(axis=0) + 1
    third = (place - low) * _THIRDS // (high - low)
    sigma_px = float(np.median(lengths(scanned.stripe[fit.used]))) / scanned.stripe_mm
    return _Patches(third @ [_THIRDS, 1], share / sigma_px)


def _blurred(scanned: Scanned, fit: Fit) -> Float[np.ndarray, "used"]:
    """What the blur of photographs does to distances, in units of σ, RMS by how likely it is.

    Lens and pixels take the mean over some columns, which moves a point of a round surface to its inside by s² κ / 2,
    κ its curvature, s the blur.
    """
    curvature = fit.shape.curvature(scanned.points[fit.used])
    return np.sqrt(fit.blurred) * (_BLUR_PX * scanned.column_mm) ** 2 / 2 * curvature / fit.spread


def grazing(
    scanned: Scanned, shape: Shape, used: Int[np.ndarray, "used"], spread: Float[np.ndarray, "used"]
) -> Float[np.ndarray, "used"]:
    """What the stripe's errors do to each distance, in units of `spread`: 1 but where the line grazes, less there."""
    if scanned.stripe is None:
        return np.ones(len(used))
    slope = dots(shape.gradient(scanned.points[used]), scanned.stripe[used])
    return np.minimum(np.abs(slope) / spread, 1.0)


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
