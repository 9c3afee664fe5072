"""What any pipeline finds from a session and scans."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.rig import Rig


@dataclass(frozen=True)
class Found:
    """A rig and clouds.

    Attributes:
        rig: camera, light plane and stage.
        clouds: for each scan, points in the object frame by frame and column, mm; NaN for none.
        lit: for each view, the columns in which the stripe was found on the board.
    """

    rig: Rig
    clouds: tuple[Float[np.ndarray, "frames columns 3"], ...]
    lit: Bool[np.ndarray, "views columns"]
