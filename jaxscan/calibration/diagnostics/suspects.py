"""Photographs that do not belong: of another camera, of another board, mirrored.

A photograph is suspected when much of it was rejected or its corners fit much worse than those of the others. Then the
rig is held, its board is placed again by its own corners, and the same is done with the photograph mirrored left to
right, top to bottom, and turned by half: what fits then says what happened to it.
"""

from dataclasses import dataclass, replace
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import solve
from jaxscan.calibration.diagnostics.resolve import problem
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.observations import View
from jaxscan.calibration.result import Calibration, PhotographFit
from jaxscan.images import Board
from jaxscan.precision import float64

# A photograph is suspected when this share of its corners or of its stripe was rejected …
REJECTED = 0.3
# … or when the median error of its corners is this multiple of that of all photographs. The median, because a stripe
# that crosses a corner moves that corner far off, and this says nothing against the photograph.
# In photographs whose corners are known to a few thousandths of a pixel, less than this is no fault of one.
_WORSE, LEAST_PX = 2.0, 0.03
# Corners fit if no more than this share was rejected. Where they do, at most this share of the stripe lies on something
# else.
_FEW, _HALF = 0.1, 0.5
# An explanation counts when it reduces corner and stripe errors to this multiple of the usual, and by half at least.
_FITS = 3.0
_FALL = 0.5

_CHANGES: Final = {
    "mirrored left to right": (True, False),
    "mirrored top to bottom": (False, True),
    "turned by half": (True, True),
}


@dataclass(frozen=True)
class Suspect:
    """A photograph that does not fit the others.

    Attributes:
        name: of the photograph.
        staged: whether the board was on the stage.
        corners_rejected: share of its corners.
        stripe_rejected: share of its stripe points; None without any.
        corner_median_px: median distance of its corners; where it is explained, with the board of a view placed by them
            alone.
        usual_corner_median_px: the median of that over all photographs.
        stripe_median_px: median absolute error of its stripe then; None without any.
        explanation: what was done to it, where that makes it fit; else None.
    """

    name: str
    staged: bool
    corners_rejected: float
    stripe_rejected: float | None
    corner_median_px: float
    usual_corner_median_px: float
    stripe_median_px: float | None
    explanation: str | None

    @property
    def stripe_alone(self) -> bool:
        """Whether a part of its stripe is all that does not fit: it lies on something else than the board."""
        return self._corners_fit and REJECTED < (self.stripe_rejected or 0.0) <= _HALF

    @property
    def another_stripe(self) -> bool:
        """Whether its corners fit, and its stripe is another one's: most of it lies elsewhere."""
        return self._corners_fit and (self.stripe_rejected or 0.0) > _HALF

    @property
    def _corners_fit(self) -> bool:
        off = _off(self.corner_median_px, self.usual_corner_median_px) or self.corners_rejected > _FEW
        return not off and self.explanation is None


def suspects(calibration: Calibration, explain: bool = True) -> tuple[Suspect, ...]:
    """The photographs that do not fit the others, those rejected most first.

    Args:
        calibration: what `calibrate` returned.
        explain: whether each is placed again, mirrored and turned, which takes some solves.
    """
    fits = [(fit, i, False) for i, fit in enumerate(calibration.fits)]
    fits += [(fit, i, True) for i, fit in enumerate(calibration.moved_fits)]
    usual = float(np.nanmedian([_median(fit.corner_errors) for fit, _, _ in fits]))
    found = []
    for fit, i, staged in fits:
        corners, stripe = _rejected(fit)
        if max(corners, stripe or 0.0) > REJECTED or _off(_median(fit.corner_errors), usual):
            corner, median, explanation = _median(fit.corner_errors), None, None
            if explain and not staged:
                corner, median, explanation = _explain(calibration, i, usual)
            found.append(Suspect(fit.name, staged, corners, stripe, corner, usual, median, explanation))
    return tuple(sorted(found, key=lambda s: -(s.corners_rejected + (s.stripe_rejected or 0.0))))


def _off(median_px: float, usual_px: float) -> bool:
    return median_px > max(_WORSE * usual_px, LEAST_PX)


def mirror(view: View, board: Board, image_size: tuple[int, int], u: bool, v: bool) -> View:
    """The view as it would be with the photograph mirrored along u, v or both."""
    last = np.asarray(image_size, float) - 1

    def moved(pixels: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
        return np.where([u, v], last - pixels, pixels)

    columns, rows = board.counts
    corners = moved(view.corners)
    if u != v:
        # The order of the corners turns from x to y clockwise on any photograph; mirrored, it has to be read backwards.
        corners = corners.reshape(rows, columns, 2)[::-1].reshape(-1, 2)
    weights = view.weights
    if weights is not None and u != v:
        weights = weights.reshape(rows, columns)[::-1].ravel()
    stripes = tuple(replace(stripe, pixels=moved(stripe.pixels)) for stripe in view.stripes)
    return replace(view, corners=corners, weights=weights, stripes=stripes)


def _rejected(fit: PhotographFit) -> tuple[float, float | None]:
    seen = np.isfinite(fit.corner_errors).all(axis=1)
    corners = 1 - fit.corner_kept.sum() / max(seen.sum(), 1)
    return float(corners), float(1 - fit.stripe_kept.mean()) if fit.stripe_kept.size else None


def _median(errors: Float[np.ndarray, "corners 2"]) -> float:
    distance = np.linalg.norm(errors, axis=1)
    return float(np.nanmedian(distance)) if np.isfinite(distance).any() else np.nan


def _explain(calibration: Calibration, index: int, usual: float) -> tuple[float, float | None, str | None]:
    """Median errors of the corners and of the stripe as it is, and the change that makes it fit."""
    view = calibration.observations.views[index]
    size, board = calibration.observations.image_size, calibration.observations.board
    corner, stripe = _placed(calibration, index, view)
    usual_stripe = calibration.stripe_sigma_px or 0.0
    best, explanation = _misfit(corner, stripe, usual, usual_stripe), None
    for words, (u, v) in _CHANGES.items():
        changed = _placed(calibration, index, mirror(view, board, size, u, v))
        misfit = _misfit(*changed, usual, usual_stripe)
        if misfit < _FITS and misfit < _FALL * best:
            best, explanation = misfit, words
    return corner, stripe, explanation


def _misfit(corner: float, stripe: float | None, usual: float, usual_stripe: float) -> float:
    """The worse of the two against what is usual."""
    if not np.isfinite(corner):
        return np.inf
    return max(corner / usual, stripe / usual_stripe if stripe is not None and usual_stripe else 0.0)


def _placed(calibration: Calibration, index: int, view: View) -> tuple[float, float | None]:
    """The board of one view placed by its corners alone with the rig held: median errors of these, and of the stripe.

    The view takes its place among the others, which are masked, so that nothing compiles again.
    """
    observations = calibration.observations
    views = [*observations.views]
    views[index] = view
    with float64():
        system, groups = problem(calibration)
        group = view_blocks(replace(observations, views=tuple(views)))
        only = (jnp.arange(len(group.points)) == index)[:, None, None]
        corners = replace(group, corner_used=group.corner_used & only, stripe_used=jnp.zeros_like(group.stripe_used))
        others = tuple(
            replace(g, corner_used=jnp.zeros_like(g.corner_used), stripe_used=jnp.zeros_like(g.stripe_used))
            for g in groups[1:]
        )
        first = first_poses(system.rig.camera, corners)
        first = jnp.concatenate([first, jnp.zeros_like(system.poses[0][:, 6:])], axis=1)
        start = replace(system, poses=(first, *system.poses[1:]))
        # Robust, so that a few wild corners do not place the board.
        noise = calibration.adjustment.noise.of(calibration.corner_sigma_px, 1.0, robustness=1.0)
        free = jnp.zeros_like(jnp.asarray(calibration.adjustment.free))
        seen = replace(group, stripe_used=group.stripe_used & only)
        placed = solve(start, free, (corners, *others), noise, judged=(seen, *others))
        corner, stripe = (np.asarray(e[index, 0]) for e in placed.errors[0])
    used = np.asarray(corners.corner_used[index, 0])
    on_stripe = np.abs(stripe[np.asarray(seen.stripe_used[index, 0])])
    return _median(corner[used]), float(np.nanmedian(on_stripe)) if on_stripe.size else None
