"""Cross-sections of a laser's light, kind by kind, each as a sum of bells (Gaussians).

A single-mode laser behind a cylinder lens gives a bell. A Powell lens or a line of diffracted beams gives a flat top, a
multi-mode diode two lobes or more, a diode astride its lens a skew, a dirty lens or a surface that scatters light a
halo, and an edge that cuts the beam off a side lobe.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError

# Bells: height, place and standard deviation, the last two in units of the sheet's σ.
_BELLS: Final = {
    "gaussian": ((1.0, 0.0, 1.0),),
    "flat-top": tuple((1.0, place, 0.5) for place in np.linspace(-1.25, 1.25, 9)),
    "two-lobed": ((1.0, -0.94, 0.56), (1.0, 0.94, 0.56)),
    "skewed": ((1.0, 0.0, 0.75), (0.5, 0.94, 1.0)),
    "halo": ((1.0, 0.0, 1.0), (0.1, 0.0, 4.0)),
    "side-lobe": ((1.0, 0.0, 1.0), (0.15, 3.2, 0.75)),
}
LASER_PROFILES: Final = tuple(_BELLS)


def bells(kind: str) -> Float[np.ndarray, "bells 3"]:
    """Height, place and standard deviation of each bell, in units of the sheet's σ.

    The peak of the sum is 1, its centre of gravity is at 0.

    Raises:
        InputError: there is no such kind.
    """
    if kind not in _BELLS:
        raise InputError(f'laser_profile = "{kind}": give one of {", ".join(LASER_PROFILES)}')
    height, place, sigma = np.array(_BELLS[kind]).T
    place = place - (height * sigma * place).sum() / (height * sigma).sum()
    at = np.linspace(-3, 3, 1201)[:, None]
    peak = (height * np.exp(-0.5 * ((at - place) / sigma) ** 2)).sum(axis=1).max()
    return np.stack([height / peak, place, sigma], axis=1)
