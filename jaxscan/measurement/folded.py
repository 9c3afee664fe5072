"""Intervals of dimensions that errors cannot make negative: distances of points and axes, angles near 0°.

Such a dimension is the length d = |v| of a vector: from one centre to another, from axis to axis, from one direction to
another. Along v the vector errs by e, and sideways by s, which only ever makes it longer:

    d² = (δ + e)² + |s|²,    δ the true length, e and s of Student's distribution, independent.

Far from 0 this is d = δ + e, and the interval is d ± k σ. Near 0 it is not: of two axes that are one, d is never 0. The
interval has at its ends those δ for which a length of at least, or at most, d is had with 2.5 % (J. Neyman, 1937). It
begins at 0 where even δ = 0 gives such lengths, and its end is never below the length that δ = 0 stays under with 95 %.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, stdtr
from scipy.stats import t as students_t

# Parts of equal probability in which sideways errors are taken by their size, and by their direction where that has
# two.
_SIZES, _DIRECTIONS = 201, 8
# Halvings of an interval in which an end lies: the end is known to a part in 10¹².
_HALVINGS: Final = 40
# A length of 30 σ is far from 0: sideways errors shift the interval by less than a fiftieth of σ.
_CLEAR: Final = 30.0
# The largest δ is looked for up to 50 σ beyond the length.
_FAR: Final = 50.0


def interval_of_length(
    length: float, sigma: float, sideways: Float[np.ndarray, "k k"], freedom: float, confidence: float
) -> tuple[float, float]:
    """The interval that holds the true length.

    Args:
        length: as measured, 0 or more.
        sigma: of the error along the vector, in the unit of the length.
        sideways: covariance of the errors in the directions across it: none, one or two.
        freedom: of Student's distribution; infinite for a normal one.
        confidence: with which it does, such as 0.95.

    Returns:
        From where to where, 0 or more.
    """
    if not sigma > 0:
        return length, length
    across = np.sqrt(np.linalg.eigvalsh(sideways).clip(0.0))
    if length > _CLEAR * float(np.hypot(sigma, np.linalg.norm(across))):
        half = sigma * float(students_t.ppf((1 + confidence) / 2, freedom))
        return length - half, length + half
    s = _sideways(across, freedom)

    def below(limit: float, true: float) -> float:
        """How likely a measured length is no larger than a limit."""
        reach = np.sqrt(np.maximum(limit**2 - s**2, 0.0))
        return float((_cdf((reach - true) / sigma, freedom) - _cdf((-reach - true) / sigma, freedom)).mean())

    tail = (1 - confidence) / 2
    far = length + _FAR * float(np.hypot(sigma, np.linalg.norm(across)))
    low = _end(lambda true: 1 - below(length, true) < tail, 0.0, length)
    high = _end(lambda true: below(length, true) > tail, 0.0, far)
    return low, max(high, _end(lambda limit: below(limit, 0.0) < confidence, 0.0, far))


def _sideways(sigmas: Float[np.ndarray, "k"], freedom: float) -> Float[np.ndarray, "parts"]:
    """How long sideways errors are, in parts of equal probability."""
    p = (np.arange(_SIZES) + 0.5) / _SIZES
    if len(sigmas) == 0:
        return np.zeros(1)
    if len(sigmas) == 1:
        return sigmas[0] * students_t.ppf((1 + p) / 2, freedom)
    # The square of the length of two such numbers is distributed as 2 F(2, ν).
    size = np.sqrt(-2 * np.log1p(-p) if np.isinf(freedom) else freedom * np.expm1(-2 / freedom * np.log1p(-p)))
    turn = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS * np.pi / 2
    return np.outer(size, np.hypot(sigmas[0] * np.cos(turn), sigmas[1] * np.sin(turn))).ravel()


def _cdf(x: Float[np.ndarray, "parts"], freedom: float) -> Float[np.ndarray, "parts"]:
    return ndtr(x) if np.isinf(freedom) else stdtr(freedom, x)


def _end(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Where between two numbers a condition ends to hold; `low` where it does not hold even there."""
    if not holds(low):
        return low
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return (low + high) / 2
