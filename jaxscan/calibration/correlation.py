"""How many stripe points are worth one: the correlation of errors along a stripe.

Neighbouring columns share speckle, a bent plate, a burnt-out core: their errors are not independent, and a thousand of
them do not fix a plane √1000 times better than one. What the parameters see varies slowly along a stripe, so the
correct weight of a point is that of the noise at long wavelengths: its variance times the integrated correlation
τ = 1 + 2 Σ ρ_k, summed up to five times itself (A. Sokal, "Monte Carlo methods in statistical mechanics", 1997).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

# The sum ends at the first lag that is this multiple of the sum so far: further ones add only noise.
_WINDOW = 5.0


def integrated_correlation(errors: Sequence[Float[np.ndarray, "_"]], kept: Sequence[Bool[np.ndarray, "_"]]) -> float:
    """τ of errors along stripes: 1 for independent ones.

    Args:
        errors: of each stripe, one entry for each neighbouring column (or row).
        kept: which of them count.
    """
    longest = max((len(e) for e in errors), default=0)
    if longest == 0:
        return 1.0
    # Autocovariance over pairs of which both are kept, by FFT of values and of masks, zero-padded against wrapping.
    size = 2 * longest
    total, pairs = np.zeros(size), np.zeros(size)
    for error, mask in zip(errors, kept, strict=True):
        for out, values in ((total, np.where(mask, error, 0.0)), (pairs, mask.astype(np.float64))):
            spectrum = np.fft.rfft(values, size)
            out += np.fft.irfft(spectrum * spectrum.conj(), size)
    pairs = np.round(pairs[:longest])
    if pairs[0] == 0 or total[0] <= 0:
        return 1.0
    covariance = np.divide(total[:longest], pairs, out=np.zeros(longest), where=pairs > 0)
    tau = 2 * np.cumsum(covariance / covariance[0]) - 1
    ends = np.flatnonzero(np.arange(longest) >= _WINDOW * tau)
    return float(max(1.0, tau[ends[0] if ends.size else -1]))


def weights_anew(
    before: Float[np.ndarray, "2"],
    left: Float[np.ndarray, "2"],
    tau: float,
    errors: Sequence[Float[np.ndarray, "_"]],
    kept: Sequence[Bool[np.ndarray, "_"]],
) -> Float[np.ndarray, "2"]:
    """How much more residuals of corners and of stripes weigh once something more of them is explained.

    Args:
        before: the sums of squares of both as they were.
        left: those that are left.
        tau: the integrated correlation by which stripes were weighted.
        errors: of each stripe, what is left.
        kept: which of them count.
    """
    weights = np.sqrt(before / np.where(left > 0, left, 1.0))
    if before[1] > 0:
        weights[1] *= np.sqrt(tau / integrated_correlation(errors, kept))
    return np.where(weights > 0, weights, 1.0)
