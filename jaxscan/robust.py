"""What robust estimates share."""

from typing import Final

# σ of a normal distribution over the median distance from its median: 1 / Φ⁻¹(3 / 4).
NORMAL_MAD: Final = 1.4826
