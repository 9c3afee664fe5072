"""What a richer lens, or free terms that were held, would change, to first order: from the residuals, without a solve.

At the solution each view's corner errors e, in σ, have the derivatives A by its board's pose and B by the camera's
numbers, terms of the richer lens at zero among them. With the poses projected out, B' = (1 − A A⁺) B and e' likewise,
freeing some columns S of B lowers χ² by gᵀ N⁻¹ g, N = B'_Sᵀ B'_S and g = B'_Sᵀ e', and moves them by −N⁻¹ g: the
Lagrange multiplier test (C. R. Rao 1948). The ladder solves the same question, and judges it on views not seen.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.diagnostics.ladder import f_test
from jaxscan.calibration.result import Calibration
from jaxscan.rig.opencv_lens import LADDER, Rational
from jaxscan.rig.projection import lens_leaves, project_points
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.splined import Splined

# Limits for a clear term: its probability by chance, its shift of the rig in σ, the share of χ² that it explains.
_BY_CHANCE, _MOVES, _EXPLAINS = 1e-4, 2.0, 0.05
# Eigenvalues of the scaled normal equations below this share of the largest.
_ROUNDING = 1e-10
_PINHOLE = ("camera.focal", "camera.principal")
# At zero the denominator's terms of the rational lens do what the numerator's do.
_TRIED = tuple(lens for lens in LADDER if lens != Rational.kind)


@dataclass(frozen=True)
class MissingTerms:
    """The richer lens that is likeliest to be the right one, or the same with its held terms free.

    Attributes:
        lens: its name.
        freed: the terms of the calibration's own lens that were held and are free in it; none in a richer one.
        p: of the F-test: how often noise alone would lower χ² as much.
        gain: the share of χ² of the views' corners that it explains.
        parameter: the focal length or principal point that it moves most, in σ; "" where these are held.
        shift_in_sigma: by how much, in the σ that the views' corners give it.
    """

    lens: str
    freed: tuple[str, ...]
    p: float
    gain: float
    parameter: str
    shift_in_sigma: float

    @property
    def clear(self) -> bool:
        """Whether chance does not explain it, and it moves something or explains much."""
        return self.p <= _BY_CHANCE and (self.shift_in_sigma >= _MOVES or self.gain >= _EXPLAINS)


def missing_terms(calibration: Calibration) -> MissingTerms | None:
    """What the residuals say of richer lenses and of held terms; None where there are none or the camera was held.

    A lens that is none of OpenCV's has no richer one, and of one with a field of shifts the field does what its terms
    would.
    """
    lens_now = calibration.rig.camera.lens.kind
    if lens_now == Splined.kind:
        return None
    leaves_of = partial(lens_leaves, tilted=bool(calibration.rig.camera.tilt))
    own_leaves = leaves_of(lens_now)
    richer = [lens for lens in _TRIED if (leaves_of(lens) & ~own_leaves).any()] if lens_now in LADDER else []
    richer = [lens for lens in richer if leaves_of(lens)[own_leaves].all()]
    names = [name for name in parameter_names(calibration.rig) if name.startswith("camera.")]
    held = np.array([name not in calibration.covariance.names for name in names])
    freed = tuple(name for name, is_held in zip(names, held, strict=True) if is_held and not name.startswith(_PINHOLE))
    if not (richer or freed) or held.all():
        return None
    N, g, chi2, count = _normal_equations(calibration)
    of_lens = np.flatnonzero(own_leaves)
    at = of_lens[~held]
    fall, moved = _freed(N, g, at)
    sigma = np.sqrt(np.diagonal(_inverse(N, at)))
    # They are the first of the camera's numbers; what a coefficient of the lens is depends on the others.
    free = [name for name, is_held in zip(names, held, strict=True) if not is_held and name.startswith(_PINHOLE)]
    # The held ones first: of two that noise does equally never it is the lens that was asked for.
    tried = [(lens_now, freed, of_lens[[name in freed for name in names]])] if freed else []
    tried += [(lens, (), np.flatnonzero(leaves_of(lens) & ~own_leaves)) for lens in richer]
    found = []
    for lens, own, further in tried:
        more = np.concatenate([at, further])
        more_fall, more_moved = _freed(N, g, more)
        shift = np.abs((more_moved[: len(at)] - moved) / sigma)[: len(free)]
        p = f_test(chi2 - fall, chi2 - more_fall, len(further), float(count - len(more)))
        worst = int(np.argmax(shift)) if free else 0
        name, by = (free[worst], float(shift[worst])) if free else ("", 0.0)
        found.append(MissingTerms(lens, own, p, (more_fall - fall) / (chi2 - fall), name, by))
    return min(found, key=lambda each: each.p)


def _freed(
    N: Float[np.ndarray, "leaves leaves"], g: Float[np.ndarray, "leaves"], at: np.ndarray
) -> tuple[float, Float[np.ndarray, "free"]]:
    """The fall of χ² when some columns are freed, and the values that they take."""
    moved = -_inverse(N, at) @ g[at]
    return float(-g[at] @ moved), moved


def _inverse(N: Float[np.ndarray, "leaves leaves"], at: np.ndarray) -> Float[np.ndarray, "free free"]:
    """The inverse of some rows and columns, without rounding errors in directions that corners do not determine."""
    scale = np.sqrt(np.maximum(np.diagonal(N)[at], np.finfo(float).tiny))
    return np.linalg.pinv(N[np.ix_(at, at)] / np.outer(scale, scale), _ROUNDING, hermitian=True) / np.outer(
        scale, scale
    )


def _normal_equations(
    calibration: Calibration,
) -> tuple[Float[np.ndarray, "leaves leaves"], Float[np.ndarray, "leaves"], float, int]:
    """N and g of the richest lens, poses projected out; χ², and how many coordinates are more than the poses take."""
    points, boards = calibration.observations.board.points(), calibration.system.boards
    X = boards.apply(points)
    arms = X - boards.translation[:, None]
    seen = project_points(calibration.rig.camera, X.reshape(-1, 3), richest=True)
    leaves = seen.by_camera.shape[2]
    N, g, chi2, count = np.zeros((leaves, leaves)), np.zeros(leaves), 0.0, 0
    for i, fit in enumerate(calibration.fits):
        kept = fit.corner_kept
        if 2 * kept.sum() <= 6:
            continue
        of = slice(i * len(points), (i + 1) * len(points))
        weight = 1 / fit.corner_sigmas[kept][:, None]
        by_point = seen.by_point[of][kept] * weight[..., None]
        turn = np.stack([np.cross(axis, arms[i][kept]) for axis in np.eye(3)], axis=-1)
        Q = np.linalg.qr(np.concatenate([by_point @ turn, by_point], axis=2).reshape(-1, 6))[0]
        B = (seen.by_camera[of][kept] * weight[..., None]).reshape(-1, leaves)
        e = (fit.corner_errors[kept] * weight).ravel()
        B, e = B - Q @ (Q.T @ B), e - Q @ (Q.T @ e)
        N, g, chi2, count = N + B.T @ B, g + B.T @ e, chi2 + float(e @ e), count + len(e) - 6
    return N, g, chi2, count
