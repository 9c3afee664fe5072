"""Speckle: the grain that laser light has in the pixels of a photograph.

A pixel that sums many independent grains has a gamma distribution of mean 1; its standard deviation is the contrast C,
its shape 1 / C² the number of grains (J. W. Goodman, *Speckle Phenomena in Optics*, 2007, section 4.6). A Gaussian
field of unit variance is taken to these gamma variables through its quantiles. With the quantiles' series in Hermite
polynomials, T(g) = Σ aₙ Heₙ(g), the correlation ρ of the field becomes Σ n! aₙ² ρⁿ / Σ n! aₙ²: the field's length is
chosen such that the speckle has the length that is asked for.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy.polynomial import hermite_e
from scipy.fft import irfft2, rfft2
from scipy.special import factorial, gammainccinv, gammaincinv, ndtr

# The table of quantiles ends at this number of standard deviations of the field, with this number of entries for each.
_REACH, _ENTRIES = 6, 1000
_TERMS, _NODES = 12, 80


def speckle(
    random: np.random.Generator, shape: tuple[int, int], contrast: float, length_px: tuple[float, float]
) -> Float[np.ndarray, "rows columns"]:
    """Factors of the laser's light in each pixel.

    Args:
        random: where chance comes from.
        shape: rows and columns of the photograph.
        contrast: standard deviation over mean, above 0 and at most 1.
        length_px: down the rows and along the columns: distance at which the correlation has fallen to 1/√e; 0 where
            each pixel is by itself.
    """
    field = random.standard_normal(shape, np.float32)
    if any(length_px):
        stretch = _stretch(contrast)
        down, along = (_amplitudes(n, stretch * length) for n, length in zip(shape, length_px, strict=True))
        field = np.asarray(irfft2(np.asarray(rfft2(field)) * np.outer(down, along[: shape[1] // 2 + 1]), shape))
    table = _quantiles(contrast)
    return table[np.rint(_ENTRIES * (field + _REACH)).astype(np.int32).clip(0, len(table) - 1)]


@lru_cache(maxsize=4)
def _quantiles(contrast: float) -> Float[np.ndarray, "entries"]:
    """What each value of the field becomes, from −`_REACH` on."""
    return _gamma(np.arange(-_REACH * _ENTRIES, _REACH * _ENTRIES + 1) / _ENTRIES, contrast).astype(np.float32)


def _gamma(g: Float[np.ndarray, "values"], contrast: float) -> Float[np.ndarray, "values"]:
    """The quantile of a gamma distribution of mean 1 where the normal one has g."""
    k = contrast**-2
    # Of each half the probability that is small, for the digits.
    return np.where(g < 0, gammaincinv(k, ndtr(g)), gammainccinv(k, ndtr(-g))) / k


@lru_cache(maxsize=4)
def _stretch(contrast: float) -> float:
    """Length of the field over that of the speckle."""
    g, weights = hermite_e.hermegauss(_NODES)
    orders = np.arange(1, _TERMS + 1)
    values = hermite_e.hermevander(g, _TERMS)[:, 1:]
    shares = (values.T @ (weights * _gamma(g, contrast))) ** 2 / factorial(orders)
    shares /= shares.sum()
    low, high = np.exp(-0.5), 1.0
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if (shares * middle**orders).sum() < np.exp(-0.5) else (low, middle)
    return float((-2 * np.log(low)) ** -0.5)


@lru_cache(maxsize=8)
def _amplitudes(count: int, length: float) -> Float[np.ndarray, "frequencies"]:
    """What white noise on a circle of pixels is filtered by, so that its covariance is e^(−r² / 2 l²)."""
    apart = np.minimum(np.arange(count), count - np.arange(count))
    covariance = np.exp(-0.5 * (apart / length) ** 2) if length else (apart == 0).astype(float)
    return np.sqrt(np.fft.fft(covariance).real.clip(0)).astype(np.float32)
