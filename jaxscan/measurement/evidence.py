"""How large errors of a kind are, by what several shapes of a scan show of them.

Each shape gives numbers x ~ N(0, V + a² I): V what its noise makes of them, a the size of the errors, one for the scan.
Sizes on a grid are weighed by their likelihood (a random-effects model: N. Laird and J. Ware, 1982). Where the noise
hides the errors, the prior is what is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

# No number is known better, px: numbers with the same noise have a difference of none, but for rounding.
_LEAST_PX: Final = 1e-4


@dataclass(frozen=True)
class Shown:
    """What a shape shows of some errors.

    Attributes:
        found: the errors, px.
        noise: their covariance by all else, px².
    """

    found: Float[np.ndarray, "numbers"]
    noise: Float[np.ndarray, "numbers numbers"]


def weights(shown: Sequence[Shown], sizes: Float[np.ndarray, "sizes"], none: float = 1.0) -> Float[np.ndarray, "sizes"]:
    """How likely each size is; the sum is 1.

    Args:
        shown: of each shape.
        sizes: px; the first is 0.
        none: how much likelier 0 is beforehand than the others together, each of which is as likely.
    """
    logs = np.zeros(len(sizes))
    for each in shown:
        values, vectors = np.linalg.eigh(each.noise)
        total = np.maximum(values, _LEAST_PX**2) + sizes[:, None] ** 2
        logs -= 0.5 * (np.log(total) + (vectors.T @ each.found) ** 2 / total).sum(axis=1)
    prior = np.where(sizes > 0, 1 / (len(sizes) - 1), none)
    likely = prior * np.exp(logs - logs.max())
    return likely / likely.sum()
