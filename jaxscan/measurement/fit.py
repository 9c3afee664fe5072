"""A shape through points: weighted least squares without outliers.

With distances d(x; p), J = ∂d/∂p, g = ∂d/∂x, and weights W = diag(1 / σᵢ²), σᵢ what an error of one σ of the stripe
does to the distance of point i, the numbers follow a small error δ of the distances by

    δp = G δ,    G = −(Jᵀ W J)⁻¹ Jᵀ W.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from jaxscan.errors import InputError
from jaxscan.files.region import AnyRegion
from jaxscan.measurement.guess import guess
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.shapes import Plane, Shape, Vector, lengths, total
from jaxscan.robust import NORMAL_MAD

# Points further than this number of robust σ from the shape do not belong to it.
LIMIT: Final = 4.0
_ROUNDS, _STEPS, _HALVES = 15, 50, 12
# Steps to where a point's line meets the shape, and how many σ it may come.
_NEWTON, _FAR = 3, 8.0
# Where a line grazes more than this part of the least slope no step is taken along it.
_GRAZES: Final = 0.5
# A step that moves nothing by more than this part of the shape's size is the last.
# Float32 coordinates have no more digits than the second; before the last fit the third will do.
_STILL, _ENOUGH, _ROUGHLY = 1e-13, 1e-6, 1e-4
# The least that a σ across the surface is of that along the ray: where light grazes, other errors count.
_BEST: Final = 0.3
FEWEST: Final = 20
# A line of light with fewer points of a plane does not count.
_FEWEST_OF_A_LINE: Final = 5
# The largest number of rounds that decide which points belong to a shape.
_OF_ROUNDS: Final = 5000
# Of how many points halves are taken, and by how much their squares have to fall for another round.
_OF_HALVES, _LESS = 1000, 0.9
_GROWTHS: Final = 10
# A residual below this part of the size is rounding, of float32 coordinates.
_ROUNDING: Final = 1e-7
_SINGULAR: Final = 1e-12


@dataclass(frozen=True)
class Fit:
    """A fitted shape.

    Attributes:
        shape: the shape.
        used: the numbers of its points.
        left_out: how many points of the region are not of it.
        residuals: signed distances of the points that are used, mm.
        spread: σ of these by the stripe alone, relative to each other, mm.
        beside: what a shape's border may be off by, in these σ: RMS for each point, all with one sign.
        blurred: how likely it is that the scan's photographs were, by what the borders of its shapes show.
    """

    shape: Shape
    used: Int[np.ndarray, "used"]
    left_out: int
    residuals: Float[np.ndarray, "used"]
    spread: Float[np.ndarray, "used"]
    beside: Float[np.ndarray, "used"]
    blurred: float

    @property
    def rms_mm(self) -> float:
        """The root mean square of the residuals, mm."""
        return float(np.sqrt((self.residuals**2).mean()))

    @property
    def form_mm(self) -> float:
        """From the lowest point to the highest, noise and all."""
        return float(np.ptp(self.residuals))


@dataclass(frozen=True)
class Settled:
    """A shape that is nearly fitted, and the points that are of it.

    Attributes:
        shape: by some of its points.
        used: the numbers of its points.
        given: the numbers of the region's points.
        sigma: robust σ of the residuals, in units of `Fit.spread`.
        off: what its border is expected to be off by, in units of `Fit.spread`; the fit takes it off.
        beside: as in `Fit`.
        blurred: as in `Fit`.
    """

    shape: Shape
    used: Int[np.ndarray, "used"]
    given: Int[np.ndarray, "given"]
    sigma: float
    off: Float[np.ndarray, "used"]
    beside: Float[np.ndarray, "used"]
    blurred: float = 0.0


def settle(
    scanned: Scanned,
    kind: str,
    candidates: Int[np.ndarray, "candidates"],
    *,
    grow: bool = False,
    normal: Vector | None = None,
    region: AnyRegion | None = None,
) -> Settled:
    """Find a shape, and which points of a region are of it.

    Args:
        scanned: all points.
        kind: plane, ball, cylinder, cone, circle or line.
        candidates: the numbers of the region's points.
        grow: add the points that are connected with them in the range image.
        normal: of the plane of a circle or a line.
        region: where they lie. Whether a point near its border belongs to it is then asked of its place on the shape,
            which errors do not move; else those that errors have brought in would be kept, and the others not.

    Raises:
        InputError: there are too few points, they determine no such shape, or there is no grid to grow along.
    """
    _enough(len(candidates))
    if grow and (scanned.place is None or scanned.image is None):
        raise InputError("grow = true needs a range image (.npz), whose points have an order: enlarge the region")
    given = candidates
    guessed = guess(kind, scanned.points[given], normal)
    shape, inside, sigma = _by_rounds(scanned, _concentrated(scanned, guessed, given), given)
    flat = kind == "plane" and scanned.image is not None
    if flat and _on_one_line(scanned, given[inside]) and not _on_one_line(scanned, given):
        # Of few frames a half of the points may be one line, and all of it lies in a plane: the sheet of light.
        shape, inside, sigma = _by_rounds(scanned, Plane.through(scanned.points[given]), given)
    if region is not None and scanned.stripe is not None and not grow:
        reach = _FAR * sigma * float(np.median(lengths(scanned.stripe[given])))
        candidates = scanned.within(region.wider(reach))
        off = off_shape(scanned, shape, candidates)
        inside = (np.abs(off.distance) <= LIMIT * sigma * off.spread) & region.holds(off.foot)
    for _ in range(_GROWTHS if grow else 0):
        grown = _grown(scanned, shape, candidates[inside], sigma)
        before = int(inside.sum())
        candidates = np.union1d(candidates, grown)
        shape, inside, sigma = _by_rounds(scanned, shape, candidates)
        # Beyond the region only what is connected counts.
        inside &= np.isin(candidates, grown)
        if abs(int(inside.sum()) - before) <= 1e-3 * before:
            break
    used = candidates[inside]
    _enough(len(used), len(candidates))
    if flat and _on_one_line(scanned, used):
        raise InputError(
            "its points are of one line of light, through which there are many planes, and of other frames fewer than "
            f"{_FEWEST_OF_A_LINE} points each: scan in smaller steps, or enlarge its region"
        )
    return Settled(shape, used, given, sigma, np.zeros(len(used)), np.zeros(len(used)))


def finish(scanned: Scanned, settled: Settled) -> Fit:
    """The least squares of a shape's points, less what its border does to them."""
    shape, used = settled.shape, settled.used
    if len(used) > _OF_ROUNDS:
        # A few are nearly there at once, so that all need a step or two.
        shape = _least_squares(scanned, shape, used[few(len(used), _OF_ROUNDS)])
    shape = _facing(scanned, _least_squares(scanned, shape, used), used)
    off = off_shape(scanned, shape, used)
    if settled.off.any():
        A = shape.jacobian(off.foot) / off.spread[:, None]
        by = np.linalg.lstsq(A.T @ A, A.T @ settled.off, rcond=_SINGULAR)[0]
        shape = shape.moved(by).placed(scanned.points[used])
        off = off_shape(scanned, shape, used)
    left_out = int((~np.isin(settled.given, used)).sum())
    return Fit(shape, used, left_out, off.distance, off.spread, settled.beside, settled.blurred)


def _enough(count: int, of: int | None = None) -> None:
    if count < FEWEST:
        where = "lie in its region" if of is None else f"of {of} in its region lie on it"
        raise InputError(
            f"{count} points {where}, {FEWEST} or more are needed: enlarge the region, or see that it is in the "
            "object frame, in mm (`jaxscan inspect` says how far the points reach)"
        )


def _on_one_line(scanned: Scanned, some: Int[np.ndarray, "some"]) -> bool:
    """Whether some points are of one frame of a range image, but for a few."""
    assert scanned.place is not None
    return bool((np.bincount(scanned.place[some, 0]) >= _FEWEST_OF_A_LINE).sum() < 2)


def _concentrated(scanned: Scanned, shape: Shape, candidates: Int[np.ndarray, "candidates"]) -> Shape:
    """The least trimmed squares near a guess: each time through the half of the points that is nearest to it.

    (P. J. Rousseeuw and K. Van Driessen, "Computing LTS regression for large data sets", 2006.) A guess that is off by
    several σ would have a limit so wide that what stands beside the shape is taken in, and holds it there.
    """
    some = candidates[few(len(candidates), _OF_HALVES)]
    half = max(len(some) // 2, min(FEWEST, len(some)))
    least = np.inf
    for _ in range(_ROUNDS):
        off = off_shape(scanned, shape, some, nearest=True)
        squares = (off.distance / off.spread) ** 2
        nearest = np.argpartition(squares, half - 1)[:half]
        now = float(squares[nearest].sum())
        if not now < _LESS * least:
            break
        least = now
        shape = _least_squares(scanned, shape, some[nearest], nearest=True)
    return shape


def _by_rounds(
    scanned: Scanned, shape: Shape, candidates: Int[np.ndarray, "candidates"]
) -> tuple[Shape, np.ndarray, float]:
    """Rounds of least squares without outliers: the shape, who is of it, and σ in units of the points' own."""
    some = candidates[few(len(candidates), _OF_ROUNDS)]
    inside = np.ones(len(some), bool)
    sigma = 0.0
    for _ in range(_ROUNDS):
        found = off_shape(scanned, shape, some, nearest=True)
        off = np.abs(found.distance) / found.spread
        least = _ROUNDING * shape.size / float(np.median(found.spread))
        sigma = max(NORMAL_MAD * float(np.median(off[inside])), least)
        now = off <= LIMIT * sigma
        if now.sum() < FEWEST:
            break
        shape = _least_squares(scanned, shape, some[now], nearest=True)
        if (now == inside).all():
            break
        inside = now
    of_all = off_shape(scanned, shape, candidates, nearest=True)
    return shape, np.abs(of_all.distance) <= LIMIT * sigma * of_all.spread, sigma


def _grown(scanned: Scanned, shape: Shape, seeds: Int[np.ndarray, "seeds"], sigma: float) -> Int[np.ndarray, "grown"]:
    """The points near the shape that are connected with some, over the grid."""
    assert scanned.place is not None
    assert scanned.image is not None
    every = np.arange(len(scanned.points))
    off = off_shape(scanned, shape, every, nearest=True)
    near = np.abs(off.distance) <= LIMIT * sigma * off.spread
    mask = np.zeros(scanned.image.valid.shape, bool)
    frames, columns = scanned.place.T
    mask[frames[near], columns[near]] = True
    label = np.zeros(mask.shape, np.int32)
    ndimage.label(mask, np.ones((3, 3)), output=label)
    of_seeds = np.unique(label[frames[seeds], columns[seeds]])
    return every[near & np.isin(label[frames, columns], of_seeds[of_seeds > 0])]


@dataclass(frozen=True)
class Off:
    """How far points are off a shape.

    Attributes:
        foot: where on the shape each belongs.
        distance: along the gradient there, mm.
        spread: σ of this by the stripe alone, relative to each other, mm.
    """

    foot: Float[np.ndarray, "points 3"]
    distance: Float[np.ndarray, "points"]
    spread: Float[np.ndarray, "points"]


def off_shape(
    scanned: Scanned, shape: Shape, some: Int[np.ndarray, "some"], nearest: bool = False, since: Off | None = None
) -> Off:
    """How far some points are off a shape; `nearest` for what is nearly so, and sooner; `since` is that of one near it.

    An error of the stripe moves a point along a line that is known. So it belongs to where this line meets the shape,
    and is off by how far it has come: on a ball the distance to the nearest point would be more for errors outwards
    than for those inwards, by σ² / R, and the weights would follow the errors. Where the line grazes it is the nearest.
    """
    x = scanned.points[some]
    if scanned.stripe is None or scanned.sigma is None:
        return Off(x, shape.distances(x), np.ones(len(x)))
    stripe, least = scanned.stripe[some], _BEST * scanned.sigma[some]
    distance, normal = shape.at(x)
    if nearest:
        return Off(x, distance, np.maximum(np.abs(dots(normal, stripe)), least))
    t = np.zeros(len(x)) if since is None else dots(x - since.foot, stripe) / dots(stripe, stripe)
    for _ in range(_NEWTON if since is None else 1):
        off, normal = shape.at(x - t[:, None] * stripe)
        slope = dots(normal, stripe)
        t = np.clip(t + off / np.where(np.abs(slope) > _GRAZES * least, slope, np.inf), -_FAR, _FAR)
    foot = x - t[:, None] * stripe
    off, normal = shape.at(foot)
    slope = dots(normal, stripe)
    # Asked of the foot alone, which the point's own error has not moved. What is left of Newton's steps is added.
    along = (np.abs(slope) > least) & (np.abs(t) < _FAR)
    foot = np.where(along[:, None], foot, x)
    return Off(foot, np.where(along, t * slope + off, distance), np.maximum(np.abs(slope), least))


def dots(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Scalar products, row by row."""
    return np.einsum("pi,pi->p", a, b)


def _least_squares(scanned: Scanned, shape: Shape, used: Int[np.ndarray, "used"], nearest: bool = False) -> Shape:
    """Gauss's steps to the least sum of squares of distances in units of their σ.

    Where a point's line meets the shape that is how many σ of the stripe it has come, Σ t², and the derivative of t by
    the numbers is that of the distance over g · e. With the σ held at first instead, shapes turn so that the distances
    are short: a plane by about σ² / size² (the attenuation of total least squares).
    """
    still = _STILL if scanned.stripe is None else _ROUGHLY if nearest else _ENOUGH
    shape = shape.placed(scanned.points[used])
    off = off_shape(scanned, shape, used, nearest)
    least = np.inf
    for _ in range(_STEPS):
        A, b = shape.jacobian(off.foot) / off.spread[:, None], off.distance / off.spread
        step = -np.linalg.lstsq(A.T @ A, A.T @ b, rcond=_SINGULAR)[0]
        before = total(b, b)
        for _ in range(_HALVES):
            moved = shape.moved(step)
            tried = off_shape(scanned, moved, used, nearest, off)
            after = float(((tried.distance / tried.spread) ** 2).sum())
            if after <= before * (1 + 1e-12):
                break
            step = step / 2
        else:
            break
        shape, off = moved, tried
        if np.abs(step).max() <= still * shape.size or not after < least:
            break
        least = after
    return shape.placed(scanned.points[used])


def _facing(scanned: Scanned, shape: Shape, used: Int[np.ndarray, "used"]) -> Shape:
    """A plane's normal towards the camera, or out of a mesh; towards the origin where neither is known."""
    if not isinstance(shape, Plane):
        return shape
    if scanned.camera is None and scanned.mesh is not None:
        outside = np.asarray(scanned.mesh.vertex_normals)[used].sum(axis=0)
    else:
        outside = (0.0 if scanned.camera is None else scanned.camera[used].mean(axis=0)) - shape.point
    return replace(shape, axis=-shape.axis) if shape.axis @ outside < 0 else shape


def few(count: int, most: int) -> Int[np.ndarray, "some"]:
    """Evenly chosen numbers below a count, at most `most`."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(int)
