"""Did something change between two photographs: the focus, the lens in its mount, a sheet of light, a board on an axis?

Told from the last step of the solve, without another one. Let some of the numbers that all photographs share step by δ
behind the k-th photograph. At the solution each photograph i has the gradient g_i and the normal equations N_i, by what
is shared, its own pose eliminated. With D the derivatives of what is shared by δ, B the sum of the N_i behind the step
and T that of all, the score and the information of δ, with all else free, are

    s = Dᵀ (Σ_behind g_i − B T⁻¹ Σ g_i)        I = Dᵀ (B − B T⁻¹ B) D        δ = −I⁻¹ s        χ² = sᵀ I⁻¹ s

(C. R. Rao 1948). What the step leaves of each photograph's score says by how much the σ of the solve, errors that
neighbours share, or boards that are not as they were taken to be, make χ² too large: φ. F = χ² / (d φ) is tested, as
often as steps were tried. What a change explains lowers σ and the correlation along stripes, which weigh both: these
are found anew, and then the kind of change is that by which χ² falls most.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from jaxscan.calibration.bends import without_poses
from jaxscan.calibration.changed import Change
from jaxscan.calibration.correlation import integrated_correlation
from jaxscan.calibration.observations import View
from jaxscan.calibration.result import Calibration, photographs_in_blocks
from jaxscan.calibration.rounds import Refined
from jaxscan.rig.light import turned_and_moved
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.system import System

# So seldom would chance alone show a change; and by so many of its σ must it move something of the rig.
_BY_CHANCE = 1e-4
_MOVES = 1.0
# Of each kind of change these many steps, the best by χ², are held against the scatter of the photographs.
_CLOSER = 5
# Eigenvalues of scaled matrices below these are rounding: of the sum of all photographs, and of what a step changes.
_ROUNDING = 1e-11
_UNSEEN = 1e-7
# The scatter is never taken to be less than this.
_LEAST_SCATTER = 1e-9
# So many photographs must stand on either side.
_FEWEST = 2
# Beside a step of its own there is no other that lowers χ² by this share as much.
_OTHERS = 0.25
# σ and correlation are found anew so many times.
_TIMES_ANEW = 3
_POSE = 6


def find_change(refined: Refined, calibration: Calibration) -> Change | None:
    """The clearest change between two photographs; None where there is none.

    Photographs are taken to be in the order of `Observations.in_order`.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
    """
    equations = _Equations.create(refined, calibration, np.ones(2))
    best = _clearest(refined.system, equations, lambda step: -step.log_p)
    for _ in range(_TIMES_ANEW):
        if best is None:
            return None
        equations = _Equations.create(refined, calibration, _scales(refined, equations, best))
        best = _clearest(refined.system, equations, lambda step: step.gain)
    if best is None or not equations.stands_out(best):
        return None
    names = parameter_names(refined.system.rig)
    sigma = np.sqrt(np.diagonal(equations.inverse))[: len(names)]
    # From the rig of all to that of the first photographs, and to that of the last ones.
    both = best.moved, best.moved + best.kind.D @ best.delta
    shift = np.max([np.abs(moved[: len(names)]) for moved in both], axis=0) / np.where(sigma > 0, sigma, np.inf)
    shift = np.where([name in calibration.covariance.names for name in names], shift, 0.0)
    worst = int(np.argmax(shift))
    if shift[worst] < _MOVES:
        return None
    by, laser = _size(best, calibration)
    views = equations.views
    return Change(
        best.kind.name, by, views[best.k - 1].name, views[best.k].name, names[worst], float(shift[worst]), laser
    )


@dataclass(frozen=True)
class _Kind:
    """What may change.

    Attributes:
        name: as `Change.kind` has it.
        D: derivatives of all unknowns by it.
        seen: the photographs that tell of it.
        which: of several.
    """

    name: str
    D: Float[np.ndarray, "unknowns d"]
    seen: Sequence[int]
    which: int = 0

    @property
    def where(self) -> Sequence[int]:
        """Before which photographs: those that tell of it, but for two at each end. One that is odd is no change."""
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

    kind: _Kind
    k: int
    delta: Float[np.ndarray, "d"]
    gain: float
    log_p: float
    moved: Float[np.ndarray, "unknowns"]


@dataclass(frozen=True)
class _Equations:
    """Normal equations of each photograph, by what is shared and by what each sequence has of its own.

    Attributes:
        views: the photographs, in their order.
        at: of each the group, the block and the place in it.
        N: the normal equations of each.
        g: its gradient.
        first: Σ N of the first k photographs, for all k from 0.
        pull: Σ g of the same.
        T: that of all, and of other factors.
        inverse: T⁻¹.
        total: Σ g of all.
        own: where what each sequence has of its own stands among the unknowns.
    """

    views: tuple[View, ...]
    at: tuple[tuple[int, int, int], ...]
    N: Float[np.ndarray, "photographs unknowns unknowns"]
    g: Float[np.ndarray, "photographs unknowns"]
    first: Float[np.ndarray, "_ unknowns unknowns"]
    pull: Float[np.ndarray, "_ unknowns"]
    T: Float[np.ndarray, "unknowns unknowns"]
    inverse: Float[np.ndarray, "unknowns unknowns"]
    total: Float[np.ndarray, "unknowns"]
    own: tuple[range, ...]

    @staticmethod
    def create(refined: Refined, calibration: Calibration, scales: Float[np.ndarray, "2"]) -> "_Equations":
        """From residuals and Jacobian of the last solve, those of corners and stripes so many times as large."""
        value, jacobian = refined.last
        n, observations = jacobian.shared.shape[1], calibration.observations
        blocks = [(np.asarray(J), np.asarray(r)) for J, r in zip(jacobian.blocks, value.blocks, strict=True)]
        each = blocks[1][0].shape[-1] - n if observations.sequences else 0
        own = tuple(range(n + each * b, n + each * (b + 1)) for b in range(len(observations.sequences)))
        photographs = list(photographs_in_blocks(observations))
        order = [photographs[i] for i in observations.in_order()]
        count = n + each * len(own)
        N, g = np.zeros((len(order), count, count)), np.zeros((len(order), count))
        for i, (_, group, b, k) in enumerate(order):
            rows, weight = _rows(refined, group, k, blocks[group][0].shape[1], scales)
            J, r = weight[:, None] * blocks[group][0][b, rows], weight * blocks[group][1][b, rows]
            at = [*range(n), *(own[b] if group else ())]
            shared = np.concatenate([J if group else J[:, :n], r[:, None]], axis=1)
            Q = without_poses(J[None, :, J.shape[1] if group else n :], shared[None])[0]
            N[i][np.ix_(at, at)], g[i, at] = Q[:-1, :-1], Q[:-1, -1]
        T, total = np.zeros((count, count)), np.zeros(count)
        for J, r in blocks[len(refined.groups) :]:
            Q = without_poses(J[..., n:], np.concatenate([J[..., :n], r[..., None]], axis=-1)).sum(axis=0)
            T[:n, :n] += Q[:-1, :-1]
            total[:n] += Q[:-1, -1]
        views, places = tuple(view for view, *_ in order), tuple((group, b, k) for _, group, b, k in order)
        return _Equations.of(views, places, N, g, T, total, own)

    @staticmethod
    def of(
        views: tuple[View, ...],
        at: tuple[tuple[int, int, int], ...],
        N: Float[np.ndarray, "photographs unknowns unknowns"],
        g: Float[np.ndarray, "photographs unknowns"],
        others: Float[np.ndarray, "unknowns unknowns"],
        pull_of_others: Float[np.ndarray, "unknowns"],
        own: tuple[range, ...],
    ) -> "_Equations":
        """From those of photographs, and of what else is known."""
        first, pull = (np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)]) for x in (N, g))
        T = N.sum(axis=0) + others
        return _Equations(
            views, at, N, g, first, pull, T, _inverse(T, _ROUNDING)[0], g.sum(axis=0) + pull_of_others, own
        )

    def stands_out(self, step: _Step) -> bool:
        """Whether a step is one of its own.

        What goes on from photograph to photograph, as the misfit of a model does when the board comes nearer, is none:
        it must show beside a line and a parabola in their order. And where neighbours err alike, as with a lens that is
        not followed and a board that wanders over the image, beside this step there are others nearly as large.
        """
        kind = step.kind
        t = np.interp(np.arange(len(self.views)), kind.seen, np.linspace(-1, 1, len(kind.seen)))
        trend = self.beside(kind.D, np.stack([t, t * t]))
        alone = trend.step(trend.widened(kind), step.k)
        if alone is None or alone.log_p > np.log(_BY_CHANCE) - np.log(len(kind.where)):
            return False
        beside = self.beside(kind.D, np.stack([t, t * t, np.arange(len(t)) >= step.k]))
        others = beside.gains(beside.widened(kind))
        return max(others.values(), default=0.0) < _OTHERS * alone.gain

    def widened(self, kind: _Kind) -> _Kind:
        """A kind in these unknowns, of which there are more."""
        return replace(kind, D=np.pad(kind.D, ((0, len(self.total) - len(kind.D)), (0, 0))))

    def beside(self, D: Float[np.ndarray, "unknowns d"], courses: Float[np.ndarray, "n photographs"]) -> "_Equations":
        """The same where some numbers may also go along some courses from photograph to photograph."""
        n, d = D.shape
        more = d * len(courses)
        E = np.broadcast_to(np.eye(n, n + more), (len(self.views), n, n + more)).copy()
        for i, course in enumerate(courses):
            E[:, :, n + i * d : n + (i + 1) * d] = D * course[:, None, None]
        N, g = E.mT @ self.N @ E, (E.mT @ self.g[..., None])[..., 0]
        rest = self.T - self.N.sum(axis=0), self.total - self.g.sum(axis=0)
        return _Equations.of(
            self.views, self.at, N, g, np.pad(rest[0], (0, more)), np.pad(rest[1], (0, more)), self.own
        )

    def gains(self, kind: _Kind) -> dict[int, float]:
        """The gain of a step behind the first k photographs, for all k where there is anything to tell."""
        s, inverse, d = self._scores(kind, kind.where)
        gains = self._gain(np.einsum("ki,kij,kj->k", s, inverse, s), d)
        return {k: float(gain) for k, gain, told in zip(kind.where, gains, d > 0, strict=True) if told}

    def _gain(self, chi2: Float[np.ndarray, "steps"], d: Int[np.ndarray, "steps"]) -> Float[np.ndarray, "steps"]:
        return chi2 - d * np.log(len(self.views))

    def step(self, kind: _Kind, k: int) -> _Step | None:
        """One step, held against how photographs scatter about it; None where too few are left to tell."""
        s, inverse, d = self._scores(kind, [k])
        delta = -inverse[0] @ s[0]
        behind = kind.D @ delta
        moved = -self.inverse @ (self.total + (self.first[-1] - self.first[k]) @ behind)
        seen = np.asarray(kind.seen)
        by = moved + np.where(seen[:, None] >= k, behind, 0.0)
        u = (self.g[seen] + np.einsum("pij,pj->pi", self.N[seen], by)) @ kind.D
        own, ranks = _inverse(kind.D.T @ self.N[seen] @ kind.D, _UNSEEN)
        degrees = int(ranks.sum() - 2 * d[0])
        if degrees < 1:
            return None
        chi2 = np.einsum("ki,kij,kj->k", s, inverse, s)
        scatter = float(np.einsum("pi,pij,pj->", u, own, u)) / degrees
        F = float(chi2[0]) / (d[0] * max(scatter, _LEAST_SCATTER))
        return _Step(kind, k, delta, float(self._gain(chi2, d)[0]), float(stats.f.logsf(F, d[0], degrees)), moved)

    def _scores(
        self, kind: _Kind, ks: Sequence[int]
    ) -> tuple[Float[np.ndarray, "steps d"], Float[np.ndarray, "steps d d"], Int[np.ndarray, "steps"]]:
        """The scores of steps behind the first k photographs, inverse information, and how many numbers each has."""
        D, first = kind.D, self.first[ks]
        B = self.first[-1] - first
        s = (self.pull[-1] - self.pull[ks] - B @ (self.inverse @ self.total)) @ D
        known = np.minimum(*(np.diagonal(D.T @ part @ D, axis1=-2, axis2=-1) for part in (B, first)))
        return s, *_inverse(D.T @ (B - B @ self.inverse @ B) @ D, _UNSEEN, known)


def _clearest(system: System, equations: _Equations, by: Callable[[_Step], float]) -> _Step | None:
    """Of the steps that are none of chance, the first by some measure."""
    kinds = _kinds(system, equations)
    gains = [equations.gains(kind) for kind in kinds]
    least = np.log(_BY_CHANCE) - np.log(max(sum(map(len, gains)), 1))
    steps = [
        equations.step(kind, k)
        for kind, each in zip(kinds, gains, strict=True)
        for k in sorted(each, key=each.__getitem__, reverse=True)[:_CLOSER]
    ]
    return max((step for step in steps if step is not None and step.log_p < least), key=by, default=None)


def _scales(refined: Refined, equations: _Equations, step: _Step) -> Float[np.ndarray, "2"]:
    """By how much corners and stripe points weigh more where a step is followed."""
    value, jacobian = refined.last
    n = jacobian.shared.shape[1]
    squares, before = np.zeros(2), np.zeros(2)
    errors, used = [], []
    for i, (group, b, k) in enumerate(equations.at):
        J, r = np.asarray(jacobian.blocks[group])[b], np.asarray(value.blocks[group])[b]
        rows, _ = _rows(refined, group, k, len(J), np.ones(2))
        J, r = J[rows], r[rows]
        unknowns = step.moved + (step.kind.D @ step.delta if i >= step.k else 0.0)
        left = r + J[:, :n] @ unknowns[:n]
        if group:
            left = left + J[:, n:] @ unknowns[equations.own[b]]
        else:
            left = left - J[:, n:] @ np.linalg.lstsq(J[:, n:], left)[0]
        corners, mask = 2 * refined.groups[group].corners.shape[2], np.asarray(refined.groups[group].stripe_used)[b, k]
        squares += [(left[:corners] ** 2).sum(), (left[corners : corners + len(mask)] ** 2).sum()]
        before += [(r[:corners] ** 2).sum(), (r[corners : corners + len(mask)] ** 2).sum()]
        errors.append(left[corners : corners + len(mask)])
        used.append(mask)
    scales = np.sqrt(before / np.where(squares > 0, squares, 1.0))
    if before[1] > 0:
        scales[1] *= np.sqrt((refined.stripe_correlation or 1.0) / integrated_correlation(errors, used))
    return np.where(scales > 0, scales, 1.0)


def _rows(
    refined: Refined, group: int, k: int, count: int, scales: Float[np.ndarray, "2"]
) -> tuple[list[int], Float[np.ndarray, "rows"]]:
    """Of a block's residuals, those of its k-th photograph, and their scales.

    What is known of its bends goes with the first.
    """
    blocks = refined.groups[group]
    photographs, corners = blocks.corners.shape[1], 2 * blocks.corners.shape[2]
    stripe, begin = blocks.stripe_used.shape[2], photographs * corners
    rest = range(begin + photographs * stripe, count) if k == 0 else ()
    rows = [*range(k * corners, (k + 1) * corners), *range(begin + k * stripe, begin + (k + 1) * stripe), *rest]
    return rows, np.repeat([*scales, 1.0], [corners, stripe, len(rest)])


def _kinds(system: System, equations: _Equations) -> list[_Kind]:
    names, values = system.shared_names(), np.array(system.values())
    count = len(equations.total)
    views = [i for i, (group, *_) in enumerate(equations.at) if group == 0]

    def part(prefix: str) -> Float[np.ndarray, "unknowns d"]:
        return np.eye(count)[:, [i for i, name in enumerate(names) if name.startswith(prefix)]]

    focal = part("camera.focal.")
    together = focal @ (focal[: len(values)].T @ values)[:, None]
    # Of the camera views tell: along an axis a board may have been pushed, or be bent otherwise than that in the hand.
    found = [_Kind("focus", together, views), _Kind("image", part("camera.principal."), views)]
    for i in range(len(system.rig.lights)):
        D = part(f"lights.{i}.")
        found.append(_Kind("light", D, [k for k, N in enumerate(equations.N) if (D.T @ N @ D).any()], i))
    for b, own in enumerate(equations.own):
        along = [i for i, (group, block, _) in enumerate(equations.at) if group and block == b]
        found.append(_Kind("place", np.eye(count)[:, own[:_POSE]], along, b))
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
        X = calibration.stripe_points(kind.which)
        return turned_and_moved(light, first, first + numbers, X), light.name
    return (float(np.degrees(np.linalg.norm(numbers[:3]))), float(np.linalg.norm(numbers[3:]))), ""


def _inverse(
    M: Float[np.ndarray, "*each n n"], least: float, scale: Float[np.ndarray, "*each n"] | None = None
) -> tuple[Float[np.ndarray, "*each n n"], Int[np.ndarray, "*each"]]:
    """The inverse in the directions that there are, and how many.

    Args:
        M: symmetric, not negative.
        least: the least eigenvalue, with the diagonal scaled to 1.
        scale: in place of the diagonal.
    """
    diagonal = np.diagonal(M, axis1=-2, axis2=-1) if scale is None else scale
    e = np.sqrt(np.where(diagonal > 0, 1 / np.where(diagonal > 0, diagonal, 1.0), 0.0))
    size, V = np.linalg.eigh(M * e[..., None, :] * e[..., None])
    there = size > least
    V = e[..., None] * V * np.where(there, 1 / np.sqrt(np.where(there, size, 1.0)), 0.0)[..., None, :]
    return V @ V.mT, np.asarray(there.sum(axis=-1))
