"""Did something change between two photographs: the focus, the lens in its mount, a sheet of light, a board on an axis?

Told from the last step of the solve, without another one. Let some of the numbers that all photographs share step by δ
behind the k-th photograph. At the solution each photograph i has the gradient g_i and the normal equations N_i, by what
is shared, its own pose eliminated. With D the derivatives of what is shared by δ, B the sum of the N_i behind the step
and T that of all, the score and the information of δ, with all else free, are

    s = Dᵀ (Σ_behind g_i − B T⁻¹ Σ g_i)        I = Dᵀ (B − B T⁻¹ B) D        δ = −I⁻¹ s        χ² = sᵀ I⁻¹ s

(C. R. Rao 1948). What the step leaves of each photograph's score says by how much the σ of the solve, errors that
neighbours share, or boards that are not as they were taken to be, make χ² too large: φ. F = χ² / (d φ) is tested, as
often as steps were tried. What a change explains lowers σ and the correlation along stripes, which weigh both: these
are found again, and then the kind of change is that by which χ² falls most.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from jaxscan.calibration.by_photograph import ByPhotograph, rows_of
from jaxscan.calibration.changed import Change
from jaxscan.calibration.correlation import weights_anew
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.rig.light import turned_and_moved
from jaxscan.rig.system import System

# A change counts if chance shows it no more often than this, and if it moves the rig by this number of σ.
_BY_CHANCE = 1e-4
_MOVES = 1.0
# Of each kind of change these many steps, the best by χ², are held against the scatter of the photographs.
_CLOSER = 5
# Eigenvalues of scaled matrices of what a step changes below this are rounding.
_UNSEEN = 1e-7
# The scatter is never taken to be less than this.
_LEAST_SCATTER = 1e-9
# At least this number of photographs must be on either side.
_FEWEST = 2
# Beside a step of its own there is no other that lowers χ² by this share as much.
_OTHERS = 0.25
# How many times σ and correlation are estimated again.
_TIMES_ANEW = 3
_POSE = 6


def find_change(
    refined: Refined, calibration: Calibration, each: ByPhotograph, paths: Collection[str] = ()
) -> Change | None:
    """The clearest change between two photographs; None where there is none.

    Photographs are taken to be in the order of `Observations.in_order`.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        each: the normal equations of its photographs.
        paths: axes whose path is not what it was taken for: a board on one seems to be pushed, and is not asked for.
    """
    equations, kinds = _Equations.of(each), kinds_of_change(refined.system, each)
    other = [i for i, sequence in enumerate(calibration.observations.sequences) if sequence.axis in paths]
    kinds = [kind for kind in kinds if kind.name != "place" or kind.which not in other]
    best = _clearest(kinds, equations, lambda step: -step.log_p)
    for _ in range(_TIMES_ANEW):
        if best is None:
            return None
        scales = _scales(refined, equations, best)
        equations = _Equations.of(ByPhotograph.create(refined, calibration.observations, scales))
        best = _clearest(kinds, equations, lambda step: step.gain)
    if best is None or not equations.stands_out(best):
        return None
    # From the rig of all to that of the first photographs, and to that of the last ones.
    both = np.abs([best.moved, best.moved + best.kind.D @ best.delta])
    parameter, shift = calibration.most_moved(both.max(axis=0), np.sqrt(np.diagonal(equations.inverse)))
    if shift < _MOVES:
        return None
    by, laser = _size(best, calibration)
    views = equations.each.views
    return Change(best.kind.name, by, views[best.k - 1].name, views[best.k].name, parameter, shift, laser)


@dataclass(frozen=True)
class Kind:
    """What may change.

    Attributes:
        name: as `Change.kind` has it.
        D: derivatives of all unknowns by it.
        seen: the photographs that observe it.
        which: of several.
    """

    name: str
    D: Float[np.ndarray, "unknowns d"]
    seen: Sequence[int]
    which: int = 0

    @property
    def where(self) -> Sequence[int]:
        """Before which photographs: those that observe it, but not two at each end. A single outlier is no change."""
        return self.seen[_FEWEST : len(self.seen) - _FEWEST + 1]


@dataclass(frozen=True)
class _Step:
    """A step δ behind the first k photographs.

    Attributes:
        kind: of what.
        k: how many stand before it.
        delta: δ.
        gain: by how much χ² falls beyond what d numbers more are worth (G. Schwarz 1978).
        log_p: how often chance would show as much, its logarithm.
        moved: by how much all unknowns move for it.
    """

    kind: Kind
    k: int
    delta: Float[np.ndarray, "d"]
    gain: float
    log_p: float
    moved: Float[np.ndarray, "unknowns"]


@dataclass(frozen=True)
class _Equations:
    """Those of each photograph, and their sums in the photographs' order.

    Attributes:
        each: those of each photograph.
        first: Σ N of the first k photographs, for all k from 0.
        pull: Σ g of the same.
        inverse: of the sum of all, T⁻¹.
        total: the gradient of all.
    """

    each: ByPhotograph
    first: Float[np.ndarray, "_ unknowns unknowns"]
    pull: Float[np.ndarray, "_ unknowns"]
    inverse: Float[np.ndarray, "unknowns unknowns"]
    total: Float[np.ndarray, "unknowns"]

    @staticmethod
    def of(each: ByPhotograph) -> "_Equations":
        """The cumulative equations from those of the photographs."""
        first, pull = (np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)]) for x in (each.N, each.g))
        return _Equations(each, first, pull, each.inverse(), pull[-1] + each.pull_of_others)

    def stands_out(self, step: _Step) -> bool:
        """Whether a step is one of its own.

        What goes on from photograph to photograph, as the misfit of a model does when the board comes nearer, is none:
        it must show beside a line and a parabola in their order. And where neighbours err alike, as with a lens that is
        not followed and a board that wanders over the image, beside this step there are others nearly as large.
        """
        kind = step.kind
        t = np.interp(np.arange(len(self.each.views)), kind.seen, np.linspace(-1, 1, len(kind.seen)))
        trend = self.beside(kind.D, np.stack([t, t * t]))
        alone = trend.step(trend.widened(kind), step.k)
        if alone is None or alone.log_p > np.log(_BY_CHANCE) - np.log(len(kind.where)):
            return False
        beside = self.beside(kind.D, np.stack([t, t * t, np.arange(len(t)) >= step.k]))
        others = beside.gains(beside.widened(kind))
        return max(others.values(), default=0.0) < _OTHERS * alone.gain

    def widened(self, kind: Kind) -> Kind:
        """A kind in these unknowns, of which there are more."""
        return replace(kind, D=np.pad(kind.D, ((0, len(self.total) - len(kind.D)), (0, 0))))

    def beside(self, D: Float[np.ndarray, "unknowns d"], courses: Float[np.ndarray, "n photographs"]) -> "_Equations":
        """The same where some numbers may also go along some courses from photograph to photograph."""
        return _Equations.of(self.each.beside(D, courses))

    def gains(self, kind: Kind) -> dict[int, float]:
        """The gain of a step behind the first k photographs, for all k where it can be estimated."""
        s, inverse, d = self._scores(kind, kind.where)
        gains = self._gain(np.einsum("ki,kij,kj->k", s, inverse, s), d)
        return {k: float(gain) for k, gain, told in zip(kind.where, gains, d > 0, strict=True) if told}

    def _gain(self, chi2: Float[np.ndarray, "steps"], d: Int[np.ndarray, "steps"]) -> Float[np.ndarray, "steps"]:
        return chi2 - d * np.log(len(self.each.views))

    def step(self, kind: Kind, k: int) -> _Step | None:
        """One step, held against how photographs scatter about it; None where too few are left."""
        s, inverse, d = self._scores(kind, [k])
        delta = -inverse[0] @ s[0]
        behind = kind.D @ delta
        moved = -self.inverse @ (self.total + (self.first[-1] - self.first[k]) @ behind)
        seen = np.asarray(kind.seen)
        by = moved + np.where(seen[:, None] >= k, behind, 0.0)
        u = (self.each.g[seen] + np.einsum("pij,pj->pi", self.each.N[seen], by)) @ kind.D
        own, ranks = inverse_where_determined(kind.D.T @ self.each.N[seen] @ kind.D, _UNSEEN)
        degrees = int(ranks.sum() - 2 * d[0])
        # Beside a course that goes the same way nothing is left of a step.
        if degrees < 1 or not d[0]:
            return None
        chi2 = np.einsum("ki,kij,kj->k", s, inverse, s)
        scatter = float(np.einsum("pi,pij,pj->", u, own, u)) / degrees
        F = float(chi2[0]) / (d[0] * max(scatter, _LEAST_SCATTER))
        return _Step(kind, k, delta, float(self._gain(chi2, d)[0]), float(stats.f.logsf(F, d[0], degrees)), moved)

    def _scores(
        self, kind: Kind, ks: Sequence[int]
    ) -> tuple[Float[np.ndarray, "steps d"], Float[np.ndarray, "steps d d"], Int[np.ndarray, "steps"]]:
        """The scores of steps behind the first k photographs, inverse information, and how many numbers each has."""
        D, first = kind.D, self.first[ks]
        B = self.first[-1] - first
        s = (self.pull[-1] - self.pull[ks] - B @ (self.inverse @ self.total)) @ D
        known = np.minimum(*(np.diagonal(D.T @ part @ D, axis1=-2, axis2=-1) for part in (B, first)))
        return s, *inverse_where_determined(D.T @ (B - B @ self.inverse @ B) @ D, _UNSEEN, known)


def _clearest(kinds: Sequence[Kind], equations: _Equations, by: Callable[[_Step], float]) -> _Step | None:
    """The first step by some measure, of those that are not by chance."""
    gains = [equations.gains(kind) for kind in kinds]
    least = np.log(_BY_CHANCE) - np.log(max(sum(map(len, gains)), 1))
    steps = [
        equations.step(kind, k)
        for kind, each in zip(kinds, gains, strict=True)
        for k in sorted(each, key=each.__getitem__, reverse=True)[:_CLOSER]
    ]
    return max((step for step in steps if step is not None and step.log_p < least), key=by, default=None)


def _scales(refined: Refined, equations: _Equations, step: _Step) -> Float[np.ndarray, "2"]:
    """How much more corners and stripe points weigh where a step is followed."""
    value, jacobian = refined.last
    n = jacobian.shared.shape[1]
    squares, before = np.zeros(2), np.zeros(2)
    errors, used = [], []
    for i, (group, b, k) in enumerate(equations.each.at):
        J, r = np.asarray(jacobian.blocks[group])[b], np.asarray(value.blocks[group])[b]
        rows, _ = rows_of(refined, group, k, len(J), np.ones(2))
        J, r = J[rows], r[rows]
        unknowns = step.moved + (step.kind.D @ step.delta if i >= step.k else 0.0)
        left = r + J[:, :n] @ unknowns[:n]
        if group:
            left = left + J[:, n:] @ unknowns[equations.each.own[b]]
        else:
            left = left - J[:, n:] @ np.linalg.lstsq(J[:, n:], left)[0]
        corners, mask = 2 * refined.groups[group].corners.shape[2], np.asarray(refined.groups[group].stripe_used)[b, k]
        squares += [(left[:corners] ** 2).sum(), (left[corners : corners + len(mask)] ** 2).sum()]
        before += [(r[:corners] ** 2).sum(), (r[corners : corners + len(mask)] ** 2).sum()]
        errors.append(left[corners : corners + len(mask)])
        used.append(mask)
    return weights_anew(before, squares, refined.stripe_correlation, errors, used)


def kinds_of_change(system: System, each: ByPhotograph) -> list[Kind]:
    """What may change in a system, as far as some photographs observe it.

    Args:
        system: of the last solve.
        each: the normal equations of its photographs.
    """
    names, values = system.shared_names(), np.array(system.values())
    count = each.N.shape[-1]
    views = [i for i, (group, *_) in enumerate(each.at) if group == 0]

    def part(prefix: str) -> Float[np.ndarray, "unknowns d"]:
        return np.eye(count)[:, [i for i, name in enumerate(names) if name.startswith(prefix)]]

    focal = part("camera.focal.")
    together = focal @ (focal[: len(values)].T @ values)[:, None]
    # Only views are used for the camera: a board on an axis may have been pushed, or be bent unlike that in the hand.
    found = [Kind("focus", together, views), Kind("image", part("camera.principal."), views)]
    for i in range(len(system.rig.lights)):
        D = part(f"lights.{i}.")
        found.append(Kind("light", D, [k for k, N in enumerate(each.N) if (D.T @ N @ D).any()], i))
    for b, own in enumerate(each.own):
        along = [i for i, (group, block, _) in enumerate(each.at) if group and block == b]
        found.append(Kind("place", np.eye(count)[:, own[:_POSE]], along, b))
    return [kind for kind in found if kind.where]


def _size(step: _Step, calibration: Calibration) -> tuple[tuple[float, float], str]:
    """How large it is, as `Change.by` has it, and the laser's name."""
    kind, numbers = step.kind, step.delta
    if kind.name == "focus":
        return (float(numbers[0]), 0.0), ""
    if kind.name == "image":
        return (float(numbers[0]), float(numbers[1])), ""
    if kind.name == "light":
        light = calibration.rig.lights[kind.which]
        # From where it was first to where it was last.
        first = kind.D.T @ step.moved
        return turned_and_moved(light, first, first + numbers, *calibration.stripe_points(kind.which)), light.name
    return (float(np.degrees(np.linalg.norm(numbers[:3]))), float(np.linalg.norm(numbers[3:]))), ""
