"""What a photograph shows of its light and its sensor, in the terms of the standard EMVA 1288, and its speckle.

A pixel that is lit by the laser to S grey levels above its surroundings scatters by

    variance = read noise² + gain · S + (speckle contrast · S)²

and is full from its saturation on. The gain is in grey levels for one photoelectron: what the standard calls K.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float32

# What each photograph has, in this order.
LIGHT: Final = ("read_noise", "gain", "speckle_contrast", "saturation")
# What a stripe is, is said where at least this part of the photographs shows it.
_MANY = 0.5
# Where more than this part of the pixels beside a stripe is 0, something was probably cut off there.
_MANY_BLACK = 1 / 3


@dataclass(frozen=True)
class Light:
    """The light of a scan or of the photographs of a session: medians over them.

    Attributes:
        read_noise: σ of a pixel without the laser, grey levels.
        gain: grey levels for one photoelectron; 0 where shot noise does not stand out from the others.
        speckle_contrast: σ of the laser's light in a pixel, in parts of its mean; 0 where it does not stand out.
        saturation: from this grey level on a pixel is full.
    """

    read_noise: float
    gain: float
    speckle_contrast: float
    saturation: float

    @classmethod
    def of(cls, photographs: Sequence[Float32[np.ndarray, "*some 4"]]) -> "Light | None":
        """The median over photographs; None where none has a stripe. NaN is one that has none."""
        rows = np.concatenate([np.reshape(each, (-1, len(LIGHT))) for each in photographs]) if photographs else None
        known = None if rows is None else rows[np.isfinite(rows).all(axis=1)]
        return None if known is None or not len(known) else cls(*(float(x) for x in np.median(known, axis=0)))

    def in_words(self) -> str:
        """In the terms of EMVA 1288."""
        gain = (
            f"gain {self.gain:.2g} grey levels for each electron" if self.gain else "shot noise too little to be seen"
        )
        speckle = f"speckle contrast {self.speckle_contrast:.2f}" if self.speckle_contrast else "no speckle seen"
        return f"read noise {self.read_noise:.3g} grey levels, {gain}, {speckle}, full from {self.saturation:.0f} on"


def no_bell(odd: Sequence[bool], black: Sequence[float], photographs: str) -> str | None:
    """What is said of a stripe whose cross-section is no bell in at least half of the photographs.

    Args:
        odd: in which of those that have a stripe, as `Stripe` has it.
        black: which part of the pixels beside it is 0, in each of them.
        photographs: what they are called.
    """
    count = sum(odd)
    if not count or count < _MANY * len(odd):
        return None
    cut = float(np.median(black))
    level = "raise a black level that cuts off what is dark"
    first, later = (f"{level} ({cut:.0%} of the pixels are 0), ", "") if cut > _MANY_BLACK else ("", f"{level}, ")
    return (
        f"cross-section is not bell-shaped, all along it, in {count} of {len(odd)} {photographs}: its place may be "
        "off, by the same amount everywhere, which a calibration with this laser absorbs, and σ is not reliable: too "
        f"large, for a burnt-out stripe perhaps too small: {first}focus camera and laser, clean lens and laser, dim "
        f"a burnt-out line, switch off a gamma curve in the camera, {later}or use a laser of a single mode"
    )
