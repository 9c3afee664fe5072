"""Does something go on slowly from photograph to photograph: a lens that warms up, a laser that sinks?

Found like the steps of `changes`, from the last step of the solve. Let numbers of the rig move by δ t_i at the i-th
photograph, t from −1 to 1. With N_i and g_i the normal equations and the gradient of each photograph, T the sum of
all N_i, D the derivatives of the unknowns by δ and B = Σ t_i N_i D, the score and the information of δ are

    s = Σ t_i Dᵀ g_i − Bᵀ T⁻¹ Σ g_i        I = Σ t_i² Dᵀ N_i D − Bᵀ T⁻¹ B        δ = −I⁻¹ s        χ² = sᵀ I⁻¹ s

tested against how photographs scatter about the drift. What was found without it stands T⁻¹ B δ from where it would
stand with it, and is as uncertain as δ is; and the rig is at no photograph that of all. So its covariance grows by

    T⁻¹ B (I⁻¹ + δ δᵀ) Bᵀ T⁻¹ + D δ δᵀ Dᵀ / 3
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.diagnostics.changes import Kind, kinds_of_change
from jaxscan.calibration.drifted import Drift
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.rig.light import turned_and_moved

# A drift counts if chance shows it no more often than this, and if it moves the rig by this number of σ.
_BY_CHANCE = 1e-4
_MOVES = 1.0
# Eigenvalues of scaled matrices of what drifts below this are rounding.
_UNSEEN = 1e-7
# The scatter is never taken to be less than this.
_LEAST_SCATTER = 1e-9
_KINDS = ("focus", "image", "light")
# A third of the square of what goes from −1 to 1 evenly.
_MEAN_SQUARE = 1 / 3


def find_drift(
    refined: Refined, calibration: Calibration, each: ByPhotograph
) -> tuple[Drift, Float[np.ndarray, "shared shared"]] | None:
    """The clearest drift, and by how much the covariance of what is shared grows for it; None where there is none.

    Photographs are taken to be in the order of `Observations.in_order`, as much time between any two.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        each: the normal equations of its photographs.
    """
    t = np.linspace(-1.0, 1.0, len(each.views))
    kinds = [kind for kind in kinds_of_change(refined.system, each) if kind.name in _KINDS]
    clear = np.log(_BY_CHANCE) - np.log(max(len(kinds), 1))
    courses = [course for course in (_Course.create(kind, each, t) for kind in kinds) if course.log_p < clear]
    if not courses:
        return None
    best = max(courses, key=lambda course: course.gain)
    parameter, shift = calibration.most_moved(best.moved, np.sqrt(np.diagonal(each.inverse())))
    if shift < _MOVES:
        return None
    by, laser = _size(best, calibration)
    n = len(refined.system.shared_names())
    drift = Drift(best.kind.name, by, laser, float(np.exp(best.log_p)), parameter, shift)
    return drift, best.widens[:n, :n]


@dataclass(frozen=True)
class _Course:
    """A drift of one kind.

    Attributes:
        kind: of what.
        delta: δ.
        gain: by how much χ² falls beyond what as many numbers are worth (G. Schwarz 1978).
        log_p: how often chance would show as much, its logarithm; 0 where too few photographs observe it.
        moved: from the unknowns with it to those without.
        widens: by how much their covariance grows.
    """

    kind: Kind
    delta: Float[np.ndarray, "d"]
    gain: float
    log_p: float
    moved: Float[np.ndarray, "unknowns"]
    widens: Float[np.ndarray, "unknowns unknowns"]

    @staticmethod
    def create(kind: Kind, each: ByPhotograph, t: Float[np.ndarray, "photographs"]) -> "_Course":
        """The drift of parameters that change in proportion to t from photograph to photograph."""
        D, inverse, total = kind.D, each.inverse(), each.g.sum(axis=0) + each.pull_of_others
        tied = each.N @ D
        B = np.einsum("p,pud->ud", t, tied)
        s = t @ each.g @ D - B.T @ inverse @ total
        alone = np.einsum("p,pud,ue->de", t * t, tied, D)
        spread, rank = inverse_where_determined(alone - B.T @ inverse @ B, _UNSEEN, np.diagonal(alone))
        delta = -spread @ s
        moved = inverse @ B @ delta
        # What the drift leaves of each photograph's score.
        left = t[:, None] * (D @ delta) - inverse @ total - moved
        u = (each.g + np.einsum("pij,pj->pi", each.N, left)) @ D
        own, ranks = inverse_where_determined(D.T @ tied, _UNSEEN)
        degrees = int(ranks.sum() - 2 * rank)
        if degrees < 1 or not rank:
            return _Course(kind, delta, -np.inf, 0.0, moved, np.zeros_like(inverse))
        scatter = max(float(np.einsum("pi,pij,pj->", u, own, u)) / degrees, _LEAST_SCATTER)
        chi2 = float(s @ spread @ s)
        log_p = float(stats.f.logsf(chi2 / rank / scatter, rank, degrees))
        off, along = inverse @ B, D @ delta
        unknown = max(scatter, 1.0) * spread + np.outer(delta, delta)
        widens = off @ unknown @ off.T + _MEAN_SQUARE * np.outer(along, along)
        return _Course(kind, delta, chi2 - float(rank) * np.log(len(t)), log_p, moved, widens)


def _size(course: _Course, calibration: Calibration) -> tuple[float, str]:
    """How large it is, as `Drift.by` has it, and the laser's name."""
    kind, delta = course.kind, 2 * course.delta
    if kind.name == "focus":
        return 100 * float(delta[0]), ""
    if kind.name == "image":
        return float(np.linalg.norm(delta)), ""
    light, points = calibration.rig.lights[kind.which], calibration.stripe_points(kind.which)
    return turned_and_moved(light, -delta / 2, delta / 2, *points)[1], light.name
