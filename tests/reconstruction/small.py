"""A small rig and photographs of a bright, wavy stripe: what tests of files and frames scan with."""

import numpy as np
from jaxtyping import Float

from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig

ROWS, COLUMNS = 96, 128


def small_rig() -> Rig:
    """The rig whose camera has the size of the photographs."""
    with float64():
        camera = Camera.create((COLUMNS, ROWS), [140.0, 140.0], [63.5, 47.5], "radial1", [-0.1])
        return as_numpy(Rig(camera, (LightPlane.create([0.0, -0.005, 0.003]),), Linear.create([0.0, 1e-3, -1e-4])))


def wavy_stripe(lower: float) -> Float[np.ndarray, "rows columns"]:
    """Grey levels of one photograph, without noise, with the stripe `lower` rows lower."""
    centre = 40 + lower + 8 * np.sin(np.arange(COLUMNS) / 20)
    return 20 + 180 * np.exp(-0.5 * ((np.arange(ROWS)[:, None] - centre) / 1.5) ** 2)
