"""How alike the errors of neighbours are: the correlation ρ(k, l) over lags of k frames and l columns.

Speckle, a detector that smooths, and a surface's own grain are shared by neighbours, so that a thousand points are
worth fewer. ρ is the autocorrelation of what is left of all fits of a scan together, by FFT over the grid of frames and
columns, up to where it is lost in its own noise. The variance of Σ gᵢ εᵢ, g the weights on the grid, is Σ gᵢ ρᵢⱼ gⱼ: by
FFT again. For weights that vary slowly it is τ Σ gᵢ², τ = Σ ρ(k, l) (A. Sokal, 1997).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.fft import next_fast_len

# Autocorrelation is taken of at most the first number of frames and columns of a feature, up to the second number of
# them apart.
_WINDOW: Final = 384
_MOST: Final = 48
# A correlation below the first, or below the second times its own σ, 1 / √n, is lost.
_LOST: Final = 0.03
_NOISE: Final = 2.0
_ROUNDS: Final = 4
# The largest part of the noise that a fit is taken to have taken up.
_MOST_TAKEN: Final = 0.3

Grid = Float[np.ndarray, "frames columns"]
Place = Int[np.ndarray, "points 2"]


@dataclass(frozen=True)
class Alike:
    """The correlation of neighbours' errors.

    Attributes:
        rho: at lags −k … k of frames and −l … l of columns; 1 in the middle.
        doubt: relative variance of `tau`: 2 L / N, of L lags found from N points (M. S. Bartlett, 1950).
    """

    rho: Float[np.ndarray, "lags lags"]
    doubt: float = 0.0

    def along(self, outline: bool) -> Float[np.ndarray, "lags lags"]:
        """The correlation in the grid; or along an outline, by frames or by columns, whichever is more."""
        if not outline:
            return self.rho
        frame, column = (n // 2 for n in self.rho.shape)
        lines = self.rho[frame], self.rho[:, column]
        return max(lines, key=np.sum)[None]

    def tau(self, outline: bool = False) -> float:
        """How many points are worth one, where what is asked of them varies slowly."""
        return max(float(self.along(outline).sum()), 1.0)

    def freedom(self, left: float, outline: bool = False) -> float:
        """Degrees of freedom of a variance that is made of τ and of the mean square of `left` points' errors.

        The mean square of n alike normal errors has the relative variance 2 Σ ρ² / n; a variance with ν degrees has
        2 / ν (F. E. Satterthwaite, 1946).
        """
        return max(2 / (2 * float((self.along(outline) ** 2).sum()) / max(left, 1.0) + self.doubt), 1.0)

    def variance(
        self, place: Place | None, weights: Float[np.ndarray, "sums points"], outline: bool = False
    ) -> Float[np.ndarray, "sums sums"]:
        """The covariance of sums of the points' errors, of σ 1 each; without places the errors are independent."""
        rho = self.along(outline)
        if place is None or rho.size == 1:
            return weights @ weights.T
        shape, (i, j) = _box(place)
        fields = np.zeros((len(weights), *shape))
        fields[:, i, j] = weights
        size = [_fast(n + m) for n, m in zip(shape, rho.shape, strict=True)]
        spread = np.fft.irfft2(np.fft.rfft2(fields, size) * np.fft.rfft2(_wrapped(rho, size), size), size)
        covariance = weights @ spread[:, i, j].T
        # An estimated ρ need not be positive definite: never below a tenth of what independent errors have.
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        least = 0.1 * np.einsum("ki,kl,li->i", vectors, weights @ weights.T, vectors)
        return (vectors * np.maximum(values, least)) @ vectors.T


INDEPENDENT: Final = Alike(np.ones((1, 1)))


def how_alike(errors: Sequence[tuple[Place, Float[np.ndarray, "points"], int]]) -> Alike:
    """From what is left of fits, each on its own piece of the grid, in units of σ, with how many numbers were fitted.

    k numbers fitted to n points take up k τ / n of the variance, and lower the correlation at all lags by as much: that
    is given back, in rounds, for τ follows from it.
    """
    parts = []
    for place, values, numbers in errors:
        near = (np.abs(place - np.median(place, axis=0).astype(int)) < _WINDOW // 2).all(axis=1)
        shape, (i, j) = _box(place[near])
        grid, there = np.zeros(shape), np.zeros(shape)
        # Of one feature as of another, whatever their scales.
        grid[i, j], there[i, j] = values[near] / max(float(np.sqrt((values[near] ** 2).mean())), 1e-300), 1.0
        parts.append((_lags(grid), _lags(there), numbers / len(values)))
    pairs = sum((part[1] for part in parts), np.zeros((2 * _MOST + 1, 2 * _MOST + 1)))
    if not pairs[_MOST, _MOST] > 0:
        return INDEPENDENT
    ends, tau, rho = None, 0.0, pairs
    for _ in range(_ROUNDS):
        taken = [min(tau * share, _MOST_TAKEN) for _, _, share in parts]
        total = sum((t * (1 - up) + up * p for (t, p, _), up in zip(parts, taken, strict=True)), np.zeros_like(pairs))
        rho = np.where(pairs > 0.5, total / np.maximum(pairs, 1.0), 0.0) / (total[_MOST, _MOST] / pairs[_MOST, _MOST])
        # The lags are those of the first round: with what is given back, noise would never be lost.
        ends = ends or (_end(rho[_MOST:, _MOST], pairs[_MOST:, _MOST]), _end(rho[_MOST, _MOST:], pairs[_MOST, _MOST:]))
        rho = rho[_MOST - ends[0] : _MOST + ends[0] + 1, _MOST - ends[1] : _MOST + ends[1] + 1]
        tau = float(rho.sum())
    return Alike(rho, 2 * rho.size / float(pairs[_MOST, _MOST]))


def _end(along: Float[np.ndarray, "lags"], pairs: Float[np.ndarray, "lags"]) -> int:
    """The last lag of an axis before the correlation is lost in its noise."""
    lost = np.flatnonzero(along <= np.maximum(_LOST, _NOISE / np.sqrt(np.maximum(pairs, 1.0))))
    return int(lost[0]) - 1 if len(lost) else _MOST


def _lags(grid: Grid) -> Float[np.ndarray, "lags lags"]:
    """Σ of products at each lag."""
    size = [_fast(max(n + _MOST + 1, 2 * _MOST + 1)) for n in grid.shape]
    sums = np.fft.irfft2(np.abs(np.fft.rfft2(grid, size)) ** 2, size)
    lags = np.arange(-_MOST, _MOST + 1)
    return sums[np.ix_(lags, lags)]


def _fast(n: int) -> int:
    """The next length whose transform is quick."""
    return int(next_fast_len(n, real=True))  # pyright: ignore[reportArgumentType]  # its types are those of another form


def _wrapped(rho: Float[np.ndarray, "lags lags"], size: Sequence[int]) -> Grid:
    """With its middle at the origin of a grid of this size."""
    grid = np.zeros(tuple(size))
    lags = [np.arange(n) - n // 2 for n in rho.shape]
    grid[np.ix_(*lags)] = rho
    return grid


def _box(place: Place) -> tuple[tuple[int, ...], Int[np.ndarray, "2 points"]]:
    """The size of the box around places of the grid, and the places in it."""
    first = place.min(axis=0)
    return tuple((place.max(axis=0) - first + 1).tolist()), (place - first).T
