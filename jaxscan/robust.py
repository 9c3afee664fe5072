"""What robust estimates share."""

from typing import Final

import numpy as np
from jaxtyping import Float

# σ of a normal distribution over the median distance from its median: 1 / Φ⁻¹(3 / 4).
NORMAL_MAD: Final = 1.4826


def weighted_median(values: Float[np.ndarray, "some"], weights: Float[np.ndarray, "some"]) -> float:
    """The least value such that it and those below it have half of the weight: where Σ w |x − value| is least."""
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(sums, 0.5 * sums[-1])])
