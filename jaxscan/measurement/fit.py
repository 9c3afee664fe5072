"""A shape through points: weighted least squares without outliers, and the covariance of the shape's numbers.

With distances d(x; p), J = ∂d/∂p, g = ∂d/∂x, and weights W = diag(1 / σᵢ²), σᵢ what an error of one σ of the stripe
does to the distance of point i, the numbers follow a small error δ of the distances by

    δp = G δ,    G = −(Jᵀ W J)⁻¹ Jᵀ W.

Every point has noise of its own, δᵢ = σᵢ εᵢ; with the rig's errors δθ all of them move, δ = D δθ, Dᵢ = gᵢ ∂xᵢ/∂θ. So

    cov p = s² τ (Jᵀ W J)⁻¹ + (G D) Σ (G D)ᵀ,

Σ the rig's covariance; the second part does not shrink with the number of points. s² is what the residuals say of the
noise, in units of σ². τ is how many points are worth one: errors of neighbours along a stripe, and of neighbouring
frames, are alike (speckle), so τ = τ_columns τ_frames, each the integrated correlation of the residuals along one axis
of the grid.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from jaxscan.calibration.correlation import integrated_correlation
from jaxscan.errors import InputError
from jaxscan.measurement.guess import guess
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.shapes import Plane, Shape, Vector
from jaxscan.robust import NORMAL_MAD

# Points further than so many robust σ from the shape are not of it.
_LIMIT: Final = 4.0
_ROUNDS, _STEPS = 30, 50
# A step that moves nothing by more than this part of the shape's size is the last.
_STILL: Final = 1e-13
# The least that a σ across the surface is of that along the ray: where light grazes, other errors count.
_BEST: Final = 0.3
FEWEST: Final = 20
# Of how many points the rig's part is taken: it is smooth over the surface.
_OF_RIG: Final = 2000
# How many lines of the grid tell of correlation along them.
_LINES: Final = 64
_GROWTHS: Final = 10
# A residual below this part of the size is rounding, of float32 coordinates.
_ROUNDING: Final = 1e-7
_SINGULAR: Final = 1e-12


@dataclass(frozen=True)
class Fit:
    """A fitted shape, and how well its numbers are known.

    Attributes:
        shape: the shape.
        used: the numbers of its points.
        left_out: how many points of the region are not of it.
        residuals: signed distances of the points that are used, mm.
        spread: σ of these by the stripe alone, relative to each other, mm.
        scale: s, what the residuals are in units of that.
        tau: how many points are worth one.
        own: covariance of the shape's numbers by the points' own noise, mm².
        by_rig: how the numbers move with the rig's leaves; None without a rig.
    """

    shape: Shape
    used: Int[np.ndarray, "used"]
    left_out: int
    residuals: Float[np.ndarray, "used"]
    spread: Float[np.ndarray, "used"]
    scale: float
    tau: float
    own: Float[np.ndarray, "numbers numbers"]
    by_rig: Float[np.ndarray, "numbers leaves"] | None = None

    @property
    def rms_mm(self) -> float:
        """Of the residuals."""
        return float(np.sqrt((self.residuals**2).mean()))

    @property
    def form_mm(self) -> float:
        """From the lowest point to the highest, noise and all."""
        return float(np.ptp(self.residuals))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the scale: independent points beyond the shape's numbers."""
        return max(len(self.used) / self.tau - self.shape.numbers, 1.0)


def fit_shape(
    scanned: Scanned,
    kind: str,
    candidates: Int[np.ndarray, "candidates"],
    *,
    grow: bool = False,
    normal: Vector | None = None,
) -> Fit:
    """Fit a shape to the points of a region.

    Args:
        scanned: all points.
        kind: plane, ball, cylinder, cone, circle or line.
        candidates: the numbers of the region's points.
        grow: go on with what hangs together with them in the range image.
        normal: of the plane of a circle or a line.

    Raises:
        InputError: there are too few points, they determine no such shape, or there is no grid to grow along.
    """
    _enough(len(candidates))
    if grow and (scanned.place is None or scanned.image is None):
        raise InputError("grow = true needs a range image (.npz), whose points have an order: enlarge the region")
    region = candidates
    shape, inside, sigma = _settled(scanned, guess(kind, scanned.points[region], normal), region)
    for _ in range(_GROWTHS if grow else 0):
        grown = _grown(scanned, shape, candidates[inside], sigma)
        before = int(inside.sum())
        candidates = np.union1d(candidates, grown)
        shape, inside, sigma = _settled(scanned, shape, candidates)
        # Beyond the region only what hangs together counts.
        inside &= np.isin(candidates, grown)
        if abs(int(inside.sum()) - before) <= 1e-3 * before:
            break
    used = candidates[inside]
    _enough(len(used), len(candidates))
    shape, spread = _least_squares(scanned, shape, used)
    shape = _facing(scanned, shape, used)
    left_out = int((~np.isin(region, used)).sum())
    return _known(scanned, shape, used, left_out, spread)


def _enough(count: int, of: int | None = None) -> None:
    if count < FEWEST:
        where = "lie in its region" if of is None else f"of {of} in its region lie on it"
        raise InputError(
            f"{count} points {where}, {FEWEST} or more are needed: enlarge the box or ball, or see that it is in the "
            "object frame, in mm (`jaxscan inspect` says how far the points reach)"
        )


def _settled(
    scanned: Scanned, shape: Shape, candidates: Int[np.ndarray, "candidates"]
) -> tuple[Shape, np.ndarray, float]:
    """Rounds of least squares without outliers: the shape, who is of it, and σ in units of the points' own."""
    x = scanned.points[candidates]
    inside = np.ones(len(x), bool)
    sigma = 0.0
    for _ in range(_ROUNDS):
        spread = _spread(scanned, shape, candidates)
        off = np.abs(shape.distances(x)) / spread
        sigma = max(NORMAL_MAD * float(np.median(off[inside])), _ROUNDING * shape.size / float(np.median(spread)))
        now = off <= _LIMIT * sigma
        if now.sum() < FEWEST:
            break
        shape = _least_squares(scanned, shape, candidates[now])[0]
        if (now == inside).all():
            break
        inside = now
    return shape, inside, sigma


def _grown(scanned: Scanned, shape: Shape, seeds: Int[np.ndarray, "seeds"], sigma: float) -> Int[np.ndarray, "grown"]:
    """The points near the shape that hang together with some, over the grid."""
    assert scanned.place is not None
    assert scanned.image is not None
    every = np.arange(len(scanned.points))
    near = np.abs(shape.distances(scanned.points)) <= _LIMIT * sigma * _spread(scanned, shape, every)
    mask = np.zeros(scanned.image.valid.shape, bool)
    frames, columns = scanned.place.T
    mask[frames[near], columns[near]] = True
    label = np.zeros(mask.shape, np.int32)
    ndimage.label(mask, np.ones((3, 3)), output=label)
    of_seeds = np.unique(label[frames[seeds], columns[seeds]])
    return every[near & np.isin(label[frames, columns], of_seeds[of_seeds > 0])]


def _spread(scanned: Scanned, shape: Shape, some: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some"]:
    """σ of the distances by the stripe alone, mm; 1 for all where nothing is known of it."""
    if scanned.stripe is None or scanned.sigma is None:
        return np.ones(len(some))
    across = np.abs((shape.gradient(scanned.points[some]) * scanned.stripe[some]).sum(axis=1))
    return np.maximum(across, _BEST * scanned.sigma[some])


def _least_squares(
    scanned: Scanned, shape: Shape, used: Int[np.ndarray, "used"]
) -> tuple[Shape, Float[np.ndarray, "used"]]:
    """Gauss's steps to the least weighted sum of squares, the weights those where it stands at first; and these σ."""
    x = scanned.points[used]
    shape = shape.placed(x)
    spread = _spread(scanned, shape, used)
    least, weight = np.inf, 1 / spread[:, None]
    for _ in range(_STEPS):
        A, b = shape.jacobian(x) * weight, shape.distances(x) * weight[:, 0]
        step = -np.linalg.lstsq(A.T @ A, A.T @ b, rcond=_SINGULAR)[0]
        taken, after = _shortened(shape, x, step, weight[:, 0], float(b @ b))
        if taken is None:
            break
        shape = taken
        if np.abs(step).max() <= _STILL * shape.size or not after < least:
            break
        least = after
    return shape.placed(x), spread


def _shortened(
    shape: Shape, x: np.ndarray, step: np.ndarray, weight: np.ndarray, before: float
) -> tuple[Shape | None, float]:
    """The shape after the step, or a half or a quarter of it …, whichever does not make the sum of squares larger."""
    for _ in range(12):
        moved = shape.moved(step)
        after = float(((moved.distances(x) * weight) ** 2).sum())
        if after <= before * (1 + 1e-12):
            return moved, after
        step = step / 2
    return None, before


def _facing(scanned: Scanned, shape: Shape, used: Int[np.ndarray, "used"]) -> Shape:
    """A plane's normal towards the camera, or the origin where no camera is known."""
    if not isinstance(shape, Plane):
        return shape
    camera = np.zeros(3) if scanned.camera is None else scanned.camera[used].mean(axis=0)
    return replace(shape, axis=-shape.axis) if shape.axis @ (camera - shape.point) < 0 else shape


def _known(
    scanned: Scanned, shape: Shape, used: Int[np.ndarray, "used"], left_out: int, spread: Float[np.ndarray, "used"]
) -> Fit:
    """With the covariance of its numbers."""
    x = scanned.points[used]
    residuals = shape.distances(x)
    A = shape.jacobian(x) / spread[:, None]
    scale = float(np.sqrt(((residuals / spread) ** 2).sum() / max(len(x) - shape.numbers, 1)))
    place = None if scanned.place is None else scanned.place[used]
    tau = 1.0 if place is None else correlation(place, residuals / spread)
    normal = A.T @ A
    if np.linalg.eigvalsh(normal)[0] <= _SINGULAR * np.trace(normal):
        raise InputError("its points do not determine it: they may lie on a line, or in one place; enlarge the region")
    own = scale**2 * tau * np.linalg.inv(normal)
    by_rig = None
    if scanned.by_rig is not None:
        some = few(len(x), _OF_RIG)
        by_rig = response(shape, x[some], spread[some]) @ moved_by_rig(scanned, shape, used[some])
    return Fit(shape, used, left_out, residuals, spread, scale, tau, own, by_rig)


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


def few(count: int, most: int) -> Int[np.ndarray, "some"]:
    """Evenly chosen numbers below a count, at most so many."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(int)


def correlation(place: Int[np.ndarray, "points 2"], errors: Float[np.ndarray, "points"]) -> float:
    """τ of errors on a grid: the product of those along its two axes."""
    first = place.min(axis=0)
    shape = tuple(place.max(axis=0) - first + 1)
    grid, there = np.zeros(shape), np.zeros(shape, bool)
    i, j = (place - first).T
    grid[i, j], there[i, j] = errors, True
    tau = 1.0
    for values, mask in ((grid, there), (grid.T, there.T)):
        # The fullest lines, of those that hold more than a point or two.
        full = np.argsort(-mask.sum(axis=1), kind="stable")[:_LINES]
        full = full[mask[full].sum(axis=1) > 2]
        if len(full):
            tau *= integrated_correlation(list(values[full]), list(mask[full]))
    return tau
