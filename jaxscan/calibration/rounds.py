"""Solve, judge, solve again: σ from the residuals themselves, and outliers left out in rounds.

The first solve tames large residuals by a robust loss. From then on each round estimates the two σ, leaves out what
lies beyond a fixed number of them, readmits what no longer does, and solves plain least squares on the rest, until
neither the set nor the σ change, or it shows that the data do not determine what is asked. The σ are variance
components: squared residuals over redundancy. Photographs differ in their light, their sharpness and how flat the board
was held, so each has a σ of its own, drawn towards that of all by about a photograph's worth. Where boards may bend by
themselves the σ of their bends comes out of each round too (`bends`). Weights that corners were
given are trusted as far as the residuals confirm them. A stripe point is weighted less than its σ alone says, by the
correlation of errors along the stripe.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import equinox as eqx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.bends import likeliest_bend, reduced
from jaxscan.calibration.block_arrow import Arrow, Jacobian
from jaxscan.calibration.bundle import Factor, Outcome, solve
from jaxscan.calibration.correlation import integrated_correlation
from jaxscan.calibration.lens_field import FieldPrior, likeliest_field, settled_field
from jaxscan.calibration.residuals import Blocks, Errors, Noise
from jaxscan.calibration.uncertainty import UNDETERMINED, Precision, arrow_precision
from jaxscan.precision import as_jax, as_numpy
from jaxscan.rig import System
from jaxscan.rig.board_shape import BENDS, half_diagonal_of
from jaxscan.rig.splined import FIELD_NUMBERS, Splined
from jaxscan.robust import NORMAL_MAD

# Left out beyond this many σ: one good corner in 25 000 (Rayleigh), one good stripe point in 16 000 (normal).
CORNER_LIMIT = 4.5
STRIPE_LIMIT = 4.0
# If the set of outliers still changes by a point or two after this number of solves, nothing else changes.
_MAX_SOLVES = 12
# After this number of solves in a row without a minimum, or with an undetermined direction, more do not help.
_MAX_FUTILE = 2
_SIGMA_SETTLED = 0.01
# A photograph's own σ² is weighted by its redundancy, that of all photographs by this number of residuals: about as
# many as one photograph has, so that only what clearly differs counts clearly less.
_PRIOR_RESIDUALS = 100.0
_SCALES_SETTLED = 0.03
# Which part of a corner's variance may be the same for all.
_COMMON_PARTS = tuple(float(c) for c in np.linspace(0, 1, 21))
# No photograph is exact: a σ below this (pixels) is a computer's, not a camera's.
_SMALLEST_SIGMA = 1e-4


@dataclass(frozen=True)
class Refined:
    """Where the rounds ended.

    Attributes:
        system: the parameters.
        noise: σ in pixels, from the residuals: of a corner, and of a stripe point times √τ; of the bends, mm.
        solved_with: what the last solve divided residuals by; but for a common factor the same, within 1 %.
        stripe_sigma: σ of a stripe point by itself, pixels.
        stripe_correlation: τ, how many neighbouring stripe points are worth one.
        groups: the observations with the masks of those that were kept.
        errors: for each group, corner (blocks, photographs, corners, 2) and stripe (blocks, photographs, stripe) errors
            in pixels, of all candidates, kept or not.
        precision: covariance and leverages there.
        last: residuals and Jacobian there, in units of `noise`; NumPy leaves.
        outcome: the last solve.
        solves: how many solves it took.
        settled: whether σ, weights and outliers had come to rest; otherwise the rounds ended by their number, or
            because more of them would not help.
    """

    system: System
    noise: Noise
    solved_with: Noise
    stripe_sigma: float
    stripe_correlation: float
    groups: tuple[Blocks, ...]
    errors: tuple[Errors, ...]
    precision: Precision
    last: tuple[Arrow, Jacobian]
    outcome: Outcome
    solves: int
    settled: bool


# An error that is no number, or without bound, is left out by its comparison with the limit.
@np.errstate(invalid="ignore", over="ignore")
def refine(
    system: System,
    free: Bool[Array, "shared"],
    candidates: tuple[Blocks, ...],
    noise: Noise,
    factors: tuple[Factor, ...] = (),
    *,
    reject: bool,
    weigh: bool,
    begins: Callable[[int], object] = lambda solve: None,
) -> Refined:
    """Solve with σ from the data, leave outliers out and weigh photographs, as far as either is wanted.

    Args:
        system: where to start.
        free: which shared parameters are refined.
        candidates: all observations that may be used.
        noise: a first guess of the two σ.
        factors: what else is known, whose unknowns stand behind those of the candidates; it is neither judged nor
            weighed.
        reject: whether observations may be left out; otherwise every candidate is used.
        weigh: whether photographs are weighted by their own σ.
        begins: called with the number of each solve, from 1, as it begins.
    """
    # What is reckoned between solves is NumPy's: small arrays of many shapes; JAX would compile for each.
    groups = candidates = as_numpy(candidates)
    solves = futile = 0
    if reject:
        begins(1)
        outcome = solve(system, free, (*groups, *factors), noise.robust(), judged=candidates)
        system, futile = outcome.system, int(outcome.result != optx.RESULTS.successful)
        errors = as_numpy(outcome.errors)
        noise = _median_noise(groups, errors, noise)
        groups = _keep(candidates, errors, noise)
        solves = 1
    two_kinds = any(bool(group.stripe_used.any()) for group in groups)
    while True:
        solves += 1
        begins(solves)
        outcome = solve(system, free, (*groups, *factors), noise, judged=candidates)
        system = outcome.system
        errors = as_numpy(outcome.errors)
        known = arrow_precision(outcome.jacobian)
        believed = _believed(candidates, groups, errors) if weigh else candidates
        single, photographs = _variance_components(believed, groups, errors, known.leverage, noise)
        tau = _stripe_correlation(groups, errors) if two_kinds else 1.0
        settled = single.of(float(single.corner), float(single.stripe) * tau**0.5)
        if noise.bend is not None:
            settled = replace(settled, bend=as_jax(np.asarray(_bend(outcome, candidates, float(noise.bend)))))
        if noise.field is not None:
            settled = replace(settled, field=_field(outcome, system, free, groups, noise, settled))
        kept = _weighted(believed, photographs, single, tau) if weigh else candidates
        if reject:
            kept = _keep(kept, errors, _at_least(single, _median_noise(groups, errors, single)))
        # Only the ratio of the two σ moves the solution; their common scale is in the covariance alone.
        ratio = float(settled.stripe) / float(settled.corner) / (float(noise.stripe) / float(noise.corner))
        calm = _same(groups, kept) and (not two_kinds or abs(ratio - 1) < _SIGMA_SETTLED)
        if noise.bend is not None and settled.bend is not None:
            calm = calm and abs(float(settled.bend) / float(noise.bend) - 1) < _SCALES_SETTLED
        calm = calm and settled_field(noise.field, settled.field, _SCALES_SETTLED)
        open_ended = outcome.result != optx.RESULTS.successful or known.eigenvalues[0] < UNDETERMINED
        futile = futile + 1 if open_ended else 0
        if calm or futile >= _MAX_FUTILE or solves >= _MAX_SOLVES:
            last = _restated(outcome, groups, noise, settled)
            return Refined(
                system=system,
                noise=settled,
                solved_with=noise,
                stripe_sigma=float(single.stripe),
                stripe_correlation=tau,
                groups=as_jax(groups),
                errors=errors,
                precision=arrow_precision(last[1]),
                last=last,
                outcome=outcome,
                solves=solves,
                settled=calm,
            )
        noise, groups = settled, kept


def _restated(outcome: Outcome, groups: tuple[Blocks, ...], old: Noise, new: Noise) -> tuple[Arrow, Jacobian]:
    """Residuals and Jacobian of a solve with other σ than it was solved with."""
    ratios = [float(old.corner) / float(new.corner), float(old.stripe) / float(new.stripe)]
    bends = 0
    if old.bend is not None and new.bend is not None:
        ratios, bends = [*ratios, float(old.bend) / float(new.bend)], BENDS
    scales = [
        np.repeat(ratios, [2 * group.weights[0].size, group.stripe_weights[0].size, bends][: len(ratios)])
        for group in groups
    ]
    scales += [np.ones(1)] * (len(outcome.value.blocks) - len(groups))
    value, blocks = (
        [s[:, *axes] * np.asarray(rows) for s, rows in zip(scales, parts.blocks, strict=True)]
        for parts, axes in ((outcome.value, ()), (outcome.jacobian, (None,)))
    )
    r, J = np.asarray(outcome.value.shared), np.asarray(outcome.jacobian.shared)
    if old.field is not None and new.field is not None:
        # With another prior its residuals are others: what was known is a block without unknowns of its own.
        J = _of_field(outcome.system, new.field, J)
        lens = outcome.system.rig.camera.lens
        assert isinstance(lens, Splined)
        r = np.asarray(new.field.residuals(lens))
        value, blocks, r, J = [*value, r[None]], [*blocks, J[None]], r[:0], J[:0]
    r, value, J, blocks = as_jax((r, tuple(value), J, tuple(blocks)))
    return as_numpy((Arrow(r, value), Jacobian(J, blocks)))


def _of_field(system: System, field: FieldPrior, J: Float[np.ndarray, "rows shared"]) -> np.ndarray:
    """The derivatives of what is known of a lens's field, of those shared numbers that were free."""
    at = [i for i, name in enumerate(system.shared_names()) if name.startswith(FIELD_NUMBERS)]
    found = np.zeros((len(at), J.shape[1]))
    found[:, at] = np.where(np.any(J[:, at] != 0, axis=0), np.asarray(field.root) / float(field.sigma), 0.0)
    return found


def _field(
    outcome: Outcome,
    system: System,
    free: Bool[Array, "shared"],
    groups: tuple[Blocks, ...],
    old: Noise,
    new: Noise,
) -> FieldPrior:
    """What is known of a lens's field, by a solve with other noise."""
    assert old.field is not None
    value, jacobian = _restated(outcome, groups, old, new)
    # Without what was taken to be known of it.
    value, jacobian = (eqx.tree_at(lambda x: x.blocks, each, each.blocks[:-1]) for each in (value, jacobian))
    bend = 0.0 if new.bend is None else float(new.bend)
    found = reduced(value, jacobian, len(groups) if bend else 0, bend)
    return likeliest_field(old.field, system, np.asarray(free), found, bend)


def _bend(outcome: Outcome, candidates: tuple[Blocks, ...], sigma: float) -> float:
    """The σ of the bends by a solve with another, mm."""
    value, jacobian = as_numpy((outcome.value, outcome.jacobian))
    if len(value.shared):
        value = replace(value, blocks=(*value.blocks, value.shared[None]))
        jacobian = replace(jacobian, blocks=(*jacobian.blocks, jacobian.shared[None]))
    half_diagonal = half_diagonal_of(np.asarray(candidates[0].points[0]))
    return likeliest_bend(reduced(value, jacobian, len(candidates), sigma), half_diagonal)


def _same(old: tuple[Blocks, ...], new: tuple[Blocks, ...]) -> bool:
    """Whether the same observations are kept, with weights that have settled."""
    return all(
        bool(
            (a.corner_used == b.corner_used).all()
            and (a.stripe_used == b.stripe_used).all()
            and np.allclose(a.weights, b.weights, rtol=_SCALES_SETTLED)
            and np.allclose(a.stripe_weights, b.stripe_weights, rtol=_SCALES_SETTLED)
        )
        for a, b in zip(old, new, strict=True)
    )


def _stripe_correlation(groups: tuple[Blocks, ...], errors: tuple) -> float:
    rows = [
        (error, used)
        for group, (_, stripe) in zip(groups, errors, strict=True)
        for errors_of, used_of in zip(stripe, group.stripe_used, strict=True)
        for error, used in zip(errors_of, used_of, strict=True)
    ]
    return integrated_correlation([error for error, _ in rows], [used for _, used in rows])


def _keep(candidates: tuple[Blocks, ...], errors: tuple, noise: Noise) -> tuple[Blocks, ...]:
    """The candidates within their limits. One whose error is not a number is out."""
    kept = []
    for group, (corner, stripe) in zip(candidates, errors, strict=True):
        distance = np.linalg.norm(corner, axis=-1) * group.weights / float(noise.corner)
        corner_used = group.corner_used & (distance <= CORNER_LIMIT)
        far = STRIPE_LIMIT * float(noise.stripe)
        stripe_used = group.stripe_used & (np.abs(stripe) * group.stripe_weights <= far)
        kept.append(eqx.tree_at(lambda g: (g.corner_used, g.stripe_used), group, (corner_used, stripe_used)))
    return tuple(kept)


def _median_noise(groups: tuple[Blocks, ...], errors: tuple, noise: Noise) -> Noise:
    """σ from the median of absolute errors, which half of the observations may spoil without effect."""
    corner = np.concatenate(
        [(c * g.weights[..., None])[g.corner_used].ravel() for g, (c, _) in zip(groups, errors, strict=True)]
    )
    stripe = np.concatenate([(s * g.stripe_weights)[g.stripe_used] for g, (_, s) in zip(groups, errors, strict=True)])
    return noise.of(_by_median(corner, noise.corner), _by_median(stripe, noise.stripe))


def _by_median(errors: np.ndarray, otherwise: Float[Array, ""]) -> float:
    if errors.size == 0:
        return float(otherwise)
    return max(NORMAL_MAD * float(np.nanmedian(np.abs(errors))), _SMALLEST_SIGMA)


def _at_least(a: Noise, b: Noise) -> Noise:
    return a.of(max(float(a.corner), float(b.corner)), max(float(a.stripe), float(b.stripe)))


@dataclass(frozen=True)
class _Sums:
    """Sums of squared errors (px²) and of redundancies of one group, photograph by photograph."""

    corner_squares: Float[np.ndarray, "blocks photographs"]
    corner_redundancy: Float[np.ndarray, "blocks photographs"]
    stripe_squares: Float[np.ndarray, "blocks photographs"]
    stripe_redundancy: Float[np.ndarray, "blocks photographs"]


def _variance_components(
    candidates: tuple[Blocks, ...],
    groups: tuple[Blocks, ...],
    errors: tuple,
    leverage: tuple[Float[np.ndarray, "_ _"], ...],
    noise: Noise,
) -> tuple[Noise, tuple[_Sums, ...]]:
    """σ of each kind over all photographs, and what each photograph contributed to it."""
    sums = []
    # The residuals of factors have the σ that they are given.
    for candidate, group, (corner, stripe), h in zip(candidates, groups, errors, leverage, strict=False):
        n = corner[0].size
        used, striped = group.corner_used[..., None], group.stripe_used
        sums.append(
            _Sums(
                (np.where(used, corner * candidate.weights[..., None], 0.0) ** 2).sum((2, 3)),
                np.where(used, 1 - h[:, :n].reshape(corner.shape), 0.0).sum((2, 3)),
                (np.where(striped, stripe, 0.0) ** 2).sum(2),
                np.where(striped, 1 - h[:, n : n + stripe[0].size].reshape(stripe.shape), 0.0).sum(2),
            )
        )
    corner_sums = [
        sum(float(x.sum()) for x in xs)
        for xs in zip(*((s.corner_squares, s.corner_redundancy) for s in sums), strict=True)
    ]
    stripe_sums = [
        sum(float(x.sum()) for x in xs)
        for xs in zip(*((s.stripe_squares, s.stripe_redundancy) for s in sums), strict=True)
    ]
    overall = noise.of(
        _by_redundancy(corner_sums[0], corner_sums[1], noise.corner),
        _by_redundancy(stripe_sums[0], stripe_sums[1], noise.stripe),
    )
    return overall, tuple(sums)


def _by_redundancy(squares: float, redundancy: float, otherwise: Float[Array, ""]) -> float:
    if redundancy <= 0:
        return float(otherwise)
    return max(float(np.sqrt(squares / redundancy)), _SMALLEST_SIGMA)


def _believed(candidates: tuple[Blocks, ...], groups: tuple[Blocks, ...], errors: tuple) -> tuple[Blocks, ...]:
    """The candidates with the corners' weights w drawn towards equal ones: 1 / w'² = c + (1 − c) / w².

    The image does not show all of a corner's σ: a board that bends and a lens that is not the model's move all
    corners alike. c is that part of the variance; its value is the most likely one for normal errors with a common
    scale.
    """
    given = np.concatenate([all_.weights[kept.corner_used] for all_, kept in zip(candidates, groups, strict=True)])
    squares = np.concatenate(
        [(error**2).sum(-1)[group.corner_used] for group, (error, _) in zip(groups, errors, strict=True)]
    )
    unlikeliness = partial(_unlikeliness, squares=squares, given=given)
    common = min(_COMMON_PARTS, key=unlikeliness)
    drawn = []
    for group in candidates:
        weights = np.asarray(group.weights)
        seen = weights > 0
        w = np.where(seen, (common + (1 - common) / np.where(seen, weights, 1.0) ** 2) ** -0.5, 0.0)
        drawn.append(eqx.tree_at(lambda g: g.weights, group, w))
    return tuple(drawn)


def _unlikeliness(common: float, squares: Float[np.ndarray, "corners"], given: Float[np.ndarray, "corners"]) -> float:
    """−2 log L for each corner, up to a constant, of squared errors whose variance is c + (1 − c) / w² on a scale."""
    variances = common + (1 - common) / given**2
    return float(np.log((squares / variances).mean()) + np.log(variances).mean())


def _weighted(
    candidates: tuple[Blocks, ...], sums: tuple[_Sums, ...], overall: Noise, tau: float
) -> tuple[Blocks, ...]:
    """The candidates with weights by the σ of their photograph, relative to that of all."""
    weighted = []
    for group, own in zip(candidates, sums, strict=True):
        corner = _relative_sigma(own.corner_squares, own.corner_redundancy, float(overall.corner), _PRIOR_RESIDUALS)
        # τ correlated points carry as much information on a stripe's σ as one independent point.
        stripe = _relative_sigma(
            own.stripe_squares, own.stripe_redundancy, float(overall.stripe), tau * _PRIOR_RESIDUALS
        )
        weighted.append(
            eqx.tree_at(
                lambda g: (g.weights, g.stripe_weights),
                group,
                (
                    group.weights / corner[..., None],
                    group.stripe_weights / stripe[..., None],
                ),
            )
        )
    return tuple(weighted)


def _relative_sigma(squares: np.ndarray, redundancy: np.ndarray, overall: float, prior: float) -> np.ndarray:
    return np.sqrt((squares / overall**2 + prior) / (redundancy + prior))
