"""σ of a mean of points that one rig measured: each has noise of its own, and what the rig is wrong by is in all.

With weights wᵢ that add up to 1, σᵢ of the pixel and ρᵢ of the rig,

    σ_pixel² = Σ wᵢ² σᵢ²,    σ² = σ_pixel² + Σ wᵢ ρᵢ².

The rig's part is that of errors which are alike in all points; where they differ it is an upper bound.
"""

import numpy as np
from jaxtyping import Float


def mean_sigma(
    weight: Float[np.ndarray, "*places points"],
    pixel: Float[np.ndarray, "*places points"],
    rig: Float[np.ndarray, "*places points"],
) -> tuple[Float[np.ndarray, "*places"], Float[np.ndarray, "*places"]]:
    """σ of each mean, of rig and pixel together and of the pixel alone, mm.

    Args:
        weight: of each point, adding up to 1; points of weight 0 do not count, whatever their σ.
        pixel: σ of the pixel's part, mm.
        rig: σ of the rig's part, mm; NaN where it is not known.
    """
    counts = weight > 0
    own = np.where(counts, (weight * np.where(counts, pixel, 0.0)) ** 2, 0.0).sum(axis=-1)
    common = np.where(counts, weight * np.where(counts, rig, 0.0) ** 2, 0.0).sum(axis=-1)
    return np.sqrt(own + common), np.sqrt(own)
