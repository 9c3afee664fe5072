"""Solve, judge, solve again: σ from the residuals themselves, and outliers left out in rounds.

The first solve tames large residuals by a robust loss. From then on each round estimates the two σ, leaves out what
lies beyond a fixed number of them, readmits what no longer does, and solves plain least squares on the rest, until
neither the set nor the σ change. The σ that are reported are variance components: squared residuals over redundancy.
A stripe point is weighted less than its σ alone says, by the correlation of errors along the stripe.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.bundle import Estimate, Outcome, solve
from jaxscan.calibration.correlation import integrated_correlation
from jaxscan.calibration.residuals import Blocks, Noise, block_errors
from jaxscan.calibration.uncertainty import Precision, precision

# Left out beyond this many σ: one good corner in 25 000 (Rayleigh), one good stripe point in 16 000 (normal).
CORNER_LIMIT = 4.5
STRIPE_LIMIT = 4.0
# A set of outliers that still changes by a point or two after so many solves changes nothing else.
_MAX_SOLVES = 12
_SIGMA_SETTLED = 0.01
_NORMAL_MAD = 1.4826
# No photograph is exact: a σ below this (pixels) is a computer's, not a camera's.
_SMALLEST_SIGMA = 1e-4


@dataclass(frozen=True)
class Refined:
    """Where the rounds ended.

    Attributes:
        estimate: the parameters.
        noise: what residuals were divided by, in pixels: the σ of a corner, and that of a stripe point times √τ.
        stripe_sigma: σ of a stripe point by itself, pixels.
        stripe_correlation: τ, how many neighbouring stripe points are worth one.
        groups: the observations with the masks of those that were kept.
        errors: for each group, corner (blocks, corners, 2) and stripe (blocks, stripe) errors in pixels, of all
            candidates, kept or not.
        precision: covariance and leverages at the estimate.
        outcome: the last solve.
        solves: how many solves it took.
    """

    estimate: Estimate
    noise: Noise
    stripe_sigma: float
    stripe_correlation: float
    groups: tuple[Blocks, ...]
    errors: tuple[tuple[Float[Array, "blocks corners 2"], Float[Array, "blocks stripe"]], ...]
    precision: Precision
    outcome: Outcome
    solves: int


def refine(
    estimate: Estimate, free: Bool[Array, "shared"], candidates: tuple[Blocks, ...], noise: Noise, reject: bool
) -> Refined:
    """Solve with σ from the data; with `reject`, leave outliers out.

    Args:
        estimate: where to start.
        free: which shared parameters are refined.
        candidates: all observations that may be used.
        noise: a first guess of the two σ.
        reject: whether observations may be left out; otherwise every candidate is used, by least squares.
    """
    groups = candidates
    solves = 0
    if reject:
        first = Noise(noise.corner, noise.stripe, jnp.ones_like(noise.robustness))
        estimate = solve(estimate, free, groups, first).estimate
        errors = _errors(estimate, candidates)
        noise = _median_noise(groups, errors, noise)
        groups = _keep(candidates, errors, noise)
        solves = 1
    two_kinds = any(bool(group.stripe_used.any()) for group in groups)
    while True:
        solves += 1
        outcome = solve(estimate, free, groups, noise)
        estimate = outcome.estimate
        errors = _errors(estimate, candidates)
        single = _variance_components(groups, errors, precision(estimate, free, groups, noise), noise)
        kept = _keep(candidates, errors, _at_least(single, _median_noise(groups, errors, single))) if reject else groups
        same = all(
            bool((old.corner_used == new.corner_used).all() and (old.stripe_used == new.stripe_used).all())
            for old, new in zip(groups, kept, strict=True)
        )
        tau = _stripe_correlation(groups, errors) if two_kinds else 1.0
        settled = Noise(single.corner, single.stripe * tau**0.5, single.robustness)
        # Only the ratio of the two σ moves the estimate; their common scale is in the covariance alone.
        ratio = float((settled.stripe / settled.corner) / (noise.stripe / noise.corner))
        noise = settled
        if (same and (not two_kinds or abs(ratio - 1) < _SIGMA_SETTLED)) or solves >= _MAX_SOLVES:
            spread = precision(estimate, free, groups, noise)
            return Refined(estimate, noise, float(single.stripe), tau, groups, errors, spread, outcome, solves)
        groups = kept


def _stripe_correlation(groups: tuple[Blocks, ...], errors: tuple) -> float:
    rows = [
        (np.asarray(error), np.asarray(used))
        for group, (_, stripe) in zip(groups, errors, strict=True)
        for error, used in zip(stripe, group.stripe_used, strict=True)
    ]
    return integrated_correlation([error for error, _ in rows], [used for _, used in rows])


@eqx.filter_jit
def _errors(
    estimate: Estimate, groups: tuple[Blocks, ...]
) -> tuple[tuple[Float[Array, "blocks corners 2"], Float[Array, "blocks stripe"]], ...]:
    rig, warp = estimate.shared
    return tuple(
        jax.vmap(lambda pose, block: block_errors(rig, warp, pose, block))(poses, group)
        for poses, group in zip(estimate.poses, groups, strict=True)
    )


def _keep(candidates: tuple[Blocks, ...], errors: tuple, noise: Noise) -> tuple[Blocks, ...]:
    """The candidates within their limits. One whose error is not a number is out."""
    kept = []
    for group, (corner, stripe) in zip(candidates, errors, strict=True):
        distance = jnp.linalg.norm(corner, axis=-1) * group.weights / noise.corner
        corner_used = group.corner_used & (distance <= CORNER_LIMIT)
        stripe_used = group.stripe_used & (jnp.abs(stripe) <= STRIPE_LIMIT * noise.stripe)
        kept.append(eqx.tree_at(lambda g: (g.corner_used, g.stripe_used), group, (corner_used, stripe_used)))
    return tuple(kept)


def _median_noise(groups: tuple[Blocks, ...], errors: tuple, noise: Noise) -> Noise:
    """σ from the median of absolute errors, which half of the observations may spoil without effect."""
    corner = np.concatenate(
        [
            np.asarray((c * g.weights[..., None])[g.corner_used]).ravel()
            for g, (c, _) in zip(groups, errors, strict=True)
        ]
    )
    stripe = np.concatenate([np.asarray(s[g.stripe_used]) for g, (_, s) in zip(groups, errors, strict=True)])

    def sigma(values: np.ndarray, otherwise: Float[Array, ""]) -> Float[Array, ""]:
        if values.size == 0:
            return otherwise
        return jnp.asarray(max(_NORMAL_MAD * float(np.nanmedian(np.abs(values))), _SMALLEST_SIGMA), jnp.float64)

    return Noise(sigma(corner, noise.corner), sigma(stripe, noise.stripe), jnp.zeros_like(noise.robustness))


def _at_least(a: Noise, b: Noise) -> Noise:
    return Noise(jnp.maximum(a.corner, b.corner), jnp.maximum(a.stripe, b.stripe), a.robustness)


def _variance_components(groups: tuple[Blocks, ...], errors: tuple, spread: Precision, noise: Noise) -> Noise:
    """σ² of each kind: sum of squared errors over sum of redundancies."""
    total = {"corner": 0.0, "stripe": 0.0}
    redundancy = {"corner": 0.0, "stripe": 0.0}
    for group, (corner, stripe), leverage in zip(groups, errors, spread.leverage, strict=True):
        n = corner.shape[1]
        for kind, used, square, h in (
            (
                "corner",
                group.corner_used[..., None],
                (corner * group.weights[..., None]) ** 2,
                leverage[:, : 2 * n].reshape(corner.shape),
            ),
            ("stripe", group.stripe_used, stripe**2, leverage[:, 2 * n :]),
        ):
            total[kind] += float(jnp.where(used, square, 0.0).sum())
            redundancy[kind] += float(jnp.where(used, 1 - h, 0.0).sum())

    def sigma(kind: str, otherwise: Float[Array, ""]) -> Float[Array, ""]:
        if redundancy[kind] <= 0:
            return otherwise
        return jnp.asarray(max(np.sqrt(total[kind] / redundancy[kind]), _SMALLEST_SIGMA), jnp.float64)

    return Noise(sigma("corner", noise.corner), sigma("stripe", noise.stripe), jnp.zeros_like(noise.robustness))
