"""G. Matheron's variogram (1963) of what is measured line by line, by medians, which edges and outliers do not move."""

import numpy as np
from jaxtyping import Bool, Float

# The median of the square of a normal number is this part of its mean.
_MEDIAN_OF_SQUARE = 0.455


def variogram(
    values: Float[np.ndarray, "lines"], used: Bool[np.ndarray, "lines"], apart: int, fewest: int = 1
) -> float:
    """Half the mean square of the difference of lines so far apart; NaN where there are fewer pairs than asked.

    Args:
        values: of each line.
        used: which lines are read.
        apart: how many lines.
        fewest: pairs.
    """
    d = np.abs(values[apart:] - values[:-apart])[used[apart:] & used[:-apart]]
    if len(d) < max(fewest, 1):
        return np.nan
    middle = len(d) // 2
    return float(np.partition(d, middle)[middle]) ** 2 / (2 * _MEDIAN_OF_SQUARE)
