"""Normal equations of each line by itself, Jᵀ diag(w) J + Λ, and their Cholesky factor L, written out number by number.

As (groups, window, lines) they are far quicker than a batched factorisation, which two threads can hang in
(`jaxscan/elimination.py`).
"""

from collections.abc import Sequence
from typing import Final, TypeVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxscan.images.stripes.grain import dot
from jaxscan.images.stripes.windows import Lines, Pixels

# A named tuple of a number for each line.
Numbers = TypeVar("Numbers", bound=tuple[Array, ...])

_LEAST_PIVOT: Final = 1e-12


def gradient(
    jacobian: Sequence[Pixels], score: Pixels, precision: Sequence[Array], now: Sequence[Array], usual: Sequence[Array]
) -> list[Lines]:
    """Jᵀ g − Λ (θ − θ₀)."""
    return [
        (J * score).sum(1, keepdims=True) - prior * (here - there)
        for J, prior, here, there in zip(jacobian, precision, now, usual, strict=True)
    ]


def factor(jacobian: Sequence[Pixels], weight: Pixels, precision: Sequence[Array]) -> list[list[Lines]]:
    """The Cholesky factor of Jᵀ diag(w) J + Λ."""
    L: list[list[Lines]] = []
    for i, J in enumerate(jacobian):
        row: list[Lines] = []
        for j in range(i):
            rest = (J * jacobian[j] * weight).sum(1, keepdims=True) - dot(row, L[j][:j])
            row.append(rest / L[j][j])
        pivot = (J * J * weight).sum(1, keepdims=True) + precision[i] - dot(row, row)
        L.append([*row, jnp.sqrt(jnp.maximum(pivot, _LEAST_PIVOT))])
    return L


def solve(L: list[list[Lines]], right: list[Lines]) -> list[Lines]:
    """Substitution forwards, then backwards."""
    y: list[Lines] = []
    for i, value in enumerate(right):
        y.append((value - dot(L[i][:i], y)) / L[i][i])
    x: list[Lines] = []
    for i in reversed(range(len(y))):
        x.insert(0, (y[i] - dot([row[i] for row in L[i + 1 :]], x)) / L[i][i])
    return x


def damped_step(
    theta: Numbers,
    jacobian: Sequence[Pixels],
    score: Pixels,
    weight: Pixels,
    precision: Sequence[Array],
    mean: Sequence[Array],
    damping: float,
    longest: Sequence[Array | float],
) -> Numbers:
    """θ after a damped step (D. Marquardt 1963), none of whose parts is longer than this."""
    damped = [
        prior + damping * (J * J * weight).sum(1, keepdims=True) for J, prior in zip(jacobian, precision, strict=True)
    ]
    change = solve(factor(jacobian, weight, damped), gradient(jacobian, score, precision, theta, mean))
    return type(theta)(*(now + jnp.clip(by, -most, most) for now, by, most in zip(theta, change, longest, strict=True)))


def strain(theta: Sequence[Array], precision: Sequence[Array], mean: Sequence[Array]) -> Array:
    """(θ − θ₀)ᵀ Λ (θ − θ₀) of each line."""
    parts = [prior * (now - usual) ** 2 for prior, now, usual in zip(precision, theta, mean, strict=True)]
    return sum(parts, start=jnp.zeros_like(theta[0]))


def least_of(starts: tuple[Numbers, Array]) -> tuple[Numbers, Array]:
    """Of what each start came to, θ and its misfit, those of the least misfit of each line."""
    every, misfits = starts
    best = misfits.argmin(0)[None]
    taken = type(every)(*(jnp.take_along_axis(x, best, axis=0)[0] for x in every))
    return taken, jnp.take_along_axis(misfits, best, axis=0)[0]


def orthogonal(jacobian: Sequence[Pixels], L: list[list[Lines]]) -> list[Pixels]:
    """L⁻¹ J of each pixel: the sum of their squares times w is the leverage, what the fit takes of a pixel's square."""
    y: list[Pixels] = []
    for i, J in enumerate(jacobian):
        y.append((J - dot(L[i][:i], y)) / L[i][i])
    return y
