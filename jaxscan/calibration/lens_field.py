"""What is known beforehand of a splined lens's field of shifts, and how that is found from the photographs themselves.

The coefficients c of each component are normal about zero, with a standard deviation σ and correlations that fall with
the distance d on the grid, in cells, as k(d / ℓ) = (1 + √5 d/ℓ + 5/3 (d/ℓ)²) exp(−√5 d/ℓ) (B. Matérn 1960, of order
5/2). So knots that no corner determines follow their neighbours, and go to zero with the full σ far from them. σ and ℓ
are those of the largest restricted likelihood: with the normal equations of [c, residual] from which poses and all
other numbers are eliminated, Q and h, and the precision P / σ² of c, P = L Lᵀ,

    −2 log L = Σ log(1 + σ² λ) − Σ σ² g² / (1 + σ² λ)        L⁻¹ Q L⁻ᵀ = V diag(λ) Vᵀ,  g = Vᵀ L⁻¹ h.

What the other numbers of the camera can do, and what a turn of the camera can, is nothing that the field should: its
share in their fields, over the grid, is held at nearly nothing. So focal lengths and terms are those of the lens
without a field that comes nearest, and the camera's frame is the same. The principal point stays where it stood
without a field: a turn of the camera, which the boards' poses follow, and the field do what it would. Free, it is
tied to them along a valley that is not straight, in which Gauss-Newton's steps come a seventh nearer each.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.bends import Reduced, marginal
from jaxscan.calibration.held import PRINCIPAL_POINT
from jaxscan.calibration.observations import Observations
from jaxscan.errors import InputError
from jaxscan.precision import as_jax
from jaxscan.rig import Camera, System
from jaxscan.rig.opencv_lens import Brown, OpenCVLens
from jaxscan.rig.spline import MORE_THAN_CELLS, basis
from jaxscan.rig.splined import CELLS, FIELD_NUMBERS, KNOTS, Splined, fields_of_numbers, grid_over

# ℓ, in cells of the grid; the first to begin with.
_REACHES: Final = (1.0, 0.5, 0.75, 1.5, 2.0, 3.0)
# σ to begin with, and between which it is sought, pixels.
_FIRST_PX, _LEAST_PX, _MOST_PX = 0.3, 1e-3, 100.0
_STEPS: Final = 61
_NARROWINGS: Final = 4
# Another ℓ is taken where the deviance falls by so much: the numbers should settle.
_BETTER: Final = 0.5
# How much of the field, as a share of σ, may be what the camera's other numbers do.
_SHARED: Final = 0.01
# Number of places along each side of the grid at which this is evaluated.
_PLACES: Final = 41
# Of a correlation matrix's diagonal, so that it can be inverted.
_JITTER: Final = 1e-8


class FieldPrior(eqx.Module):
    """What is known of the coefficients c of the field: normal about zero, of precision rootᵀ root / σ².

    Attributes:
        sigma: σ, normalised coordinates.
        reach: ℓ, cells.
        root: Lᵀ.
    """

    sigma: Float[Array, ""]
    reach: Float[Array, ""]
    root: Float[Array, "knots knots"]

    def residuals(self, lens: Splined) -> Float[Array, "knots"]:
        """Root · c / σ."""
        return self.root @ jnp.stack([*lens.shift_x, *lens.shift_y]) / self.sigma


def base_of(lens: str) -> str:
    """The lens with which a solve begins, for a kind of lens."""
    return Brown.kind if lens == Splined.kind else lens


def with_field(camera: Camera) -> Camera:
    """A camera of OpenCV's terms with a field on top, without shifts yet, over its image; inside `float64`."""
    assert isinstance(camera.lens, OpenCVLens)
    extent = grid_over(camera.image_size, camera.focal, camera.principal, camera.tilt).tolist()
    return replace(camera, lens=Splined.on_top(camera.lens, extent))


def held_beside_field(camera: Camera) -> set[str]:
    """The names of what stays where it is when a lens has a field."""
    return set(PRINCIPAL_POINT) if isinstance(camera.lens, Splined) else set()


def first_field(camera: Camera, free: Collection[str]) -> FieldPrior | None:
    """What is taken to be known to begin with; None for a lens without a field. Inside a `float64` block.

    Args:
        camera: the camera.
        free: the names of its parameters that are refined.
    """
    if not isinstance(camera.lens, Splined):
        return None
    return _prior(camera, free, _FIRST_PX / _focal(camera), _REACHES[0])


def check_enough_for_field(observations: Observations) -> None:
    """Refuse a session with too few corners for the number of terms.

    Raises:
        InputError: there are too few corners.
    """
    views = observations.views
    told = sum(2 * int(view.used().sum()) - 6 for view in views)
    if told < KNOTS:
        raise InputError(
            f'{len(views)} usable views give {max(told, 0)} numbers beyond their boards\' poses; lens = "splined", '
            f"with {2 * KNOTS} shifts, needs {KNOTS} and more: photograph the board in more poses, all over the image, "
            'or ask for lens = "brown"'
        )


def likeliest_field(
    prior: FieldPrior, system: System, free: Bool[np.ndarray, "shared"], groups: list[Reduced], bend: float
) -> FieldPrior:
    """The likeliest prior by a solve with another.

    Args:
        prior: with which it was solved.
        system: where it ended.
        free: what was refined.
        groups: its normal equations, poses eliminated, without the prior's part.
        bend: σ of the bends of boards, mm.
    """
    names = np.array(system.shared_names())
    is_knot = np.array([name.startswith(FIELD_NUMBERS) for name in names])
    total = marginal(groups, bend)
    diagonal = np.diagonal(total)[:-1]
    k, others = np.flatnonzero(is_knot & free), np.flatnonzero(~is_knot & free & (diagonal > 0))
    if len(k) < is_knot.sum():
        # With some of them held there is too little of the field left to estimate its statistics.
        return prior
    c = np.asarray(system.values())[k]
    Q, h = _without_others(total, k, others, c)
    camera, at = system.rig.camera, set(names[free])
    best: tuple[float, float, float] | None = None
    now = float(prior.reach)
    for reach in sorted(_REACHES, key=lambda reach: reach != now):
        root = _root(camera, at, reach)
        inner = np.linalg.solve(root.T, Q)
        size, V = np.linalg.eigh(np.linalg.solve(root.T, inner.T))
        g = V.T @ np.linalg.solve(root.T, h)
        deviance, sigma = _least(np.maximum(size, 0.0), g, _focal(camera))
        # As many numbers whatever the reach: the determinant of the root is in that of the eigenvalues.
        if best is None or deviance < best[0] - _BETTER:
            best = deviance, sigma, reach
    assert best is not None
    return _prior(camera, at, best[1], best[2])


def settled_field(old: FieldPrior | None, new: FieldPrior | None, within: float) -> bool:
    """Whether the prior has come to rest."""
    if old is None or new is None:
        return True
    return float(old.reach) == float(new.reach) and abs(float(new.sigma) / float(old.sigma) - 1) < within


def _without_others(
    total: Float[np.ndarray, "columns columns"], k: np.ndarray, others: np.ndarray, c: Float[np.ndarray, "knots"]
) -> tuple[Float[np.ndarray, "knots knots"], Float[np.ndarray, "knots"]]:
    """Q and h of a field of zero."""
    scale = 1 / np.sqrt(np.diagonal(total)[others])
    inner = scale[:, None] * total[np.ix_(others, others)] * scale
    right = np.concatenate([total[np.ix_(others, k)], total[others, -1:]], axis=1)
    taken = right.T @ (scale[:, None] * np.linalg.lstsq(inner, scale[:, None] * right, rcond=1e-13)[0])
    Q = total[np.ix_(k, k)] - taken[:-1, :-1]
    return Q, total[k, -1] - taken[:-1, -1] - Q @ c


def _least(size: Float[np.ndarray, "knots"], g: Float[np.ndarray, "knots"], focal: float) -> tuple[float, float]:
    """The least deviance over σ, and that σ."""

    def deviance(log: float) -> float:
        v = np.exp(2 * log)
        return float((np.log1p(v * size) - v * g**2 / (1 + v * size)).sum())

    tried, best = np.linspace(np.log(_LEAST_PX / focal), np.log(_MOST_PX / focal), _STEPS), 0
    for _ in range(_NARROWINGS):
        best = int(np.argmin([deviance(float(each)) for each in tried]))
        around = tried[max(best - 1, 0)], tried[best], tried[min(best + 1, len(tried) - 1)]
        tried, best = np.concatenate([np.linspace(*around[:2], 5), np.linspace(*around[1:], 5)[1:]]), 4
    return deviance(float(tried[best])), float(np.exp(tried[best]))


def _focal(camera: Camera) -> float:
    return float(np.sqrt(float(camera.focal[0]) * float(camera.focal[1])))


def _prior(camera: Camera, free: Collection[str], sigma: float, reach: float) -> FieldPrior:
    numbers = (np.asarray(sigma), np.asarray(reach), _root(camera, free, reach))
    return FieldPrior(*as_jax(tuple(number.astype(np.float64) for number in numbers)))


def _root(camera: Camera, free: Collection[str], reach: float) -> Float[np.ndarray, "knots knots"]:
    """Lᵀ of an ℓ."""
    along, across = (np.arange(cells + MORE_THAN_CELLS, dtype=float) for cells in CELLS)
    at = np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)
    d = np.sqrt(5) / reach * np.linalg.norm(at[:, None] - at, axis=2)
    correlations = (1 + d + d**2 / 3) * np.exp(-d)
    own = np.linalg.inv(correlations + _JITTER * np.eye(KNOTS))
    none = np.zeros((KNOTS, KNOTS))
    shared = _shared(camera, free) / _SHARED
    return np.linalg.cholesky(np.block([[own, none], [none, own]]) + shared.T @ shared).T


def _shared(camera: Camera, free: Collection[str]) -> Float[np.ndarray, "fields knots"]:
    """What of the field's RMS over its grid each of the other numbers' fields can do, made orthogonal."""
    assert isinstance(camera.lens, Splined)
    extent = np.array([float(leaf) for leaf in camera.lens.extent])
    x, y = (each.ravel() for each in np.meshgrid(*(np.linspace(extent[i], extent[i + 2], _PLACES) for i in (0, 1))))
    fields = fields_of_numbers(x, y)
    turns = [(x * y, 1 + y * y), (1 + x * x, x * y), (-y, x)]
    columns = [field for name, field in fields.items() if name in free] + turns
    B = np.stack([np.concatenate(field) for field in columns], axis=1)
    U, size, _ = np.linalg.svd(B / np.linalg.norm(B, axis=0), full_matrices=False)
    U = U[:, size > 1e-9 * size[0]]
    weights = basis(extent, CELLS, np.stack([x, y], axis=1))
    half = len(x)
    return np.concatenate([U[:half].T @ weights, U[half:].T @ weights], axis=1) / np.sqrt(half)
