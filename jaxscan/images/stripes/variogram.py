"""G. Matheron's variogram (1963) of what is measured line by line, by medians, which edges and outliers do not move."""

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.images.stripes.ranks import ranked

# The median of the square of a normal number is this part of its mean.
_MEDIAN_OF_SQUARE = 0.455


def variogram(
    values: Float[np.ndarray, "frames lines"], used: Bool[np.ndarray, "frames lines"], apart: int, fewest: int = 1
) -> Float[np.ndarray, "frames"]:
    """Half the mean square of the difference of lines so far apart; NaN where there are fewer pairs than asked.

    Args:
        values: of each line of each frame.
        used: which lines are read.
        apart: how many lines.
        fewest: pairs.
    """
    both = used[:, apart:] & used[:, :-apart]
    usual = ranked(np.abs(values[:, apart:] - values[:, :-apart]), both, 0.5).astype(np.float64)
    return np.where(both.sum(axis=1) >= fewest, usual**2 / (2 * _MEDIAN_OF_SQUARE), np.nan)
