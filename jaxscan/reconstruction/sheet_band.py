"""Where in the image a stripe can be: the epipolar band of the working volume.

A pixel whose ray meets the sheet at depth z shows a stripe only where a surface is at that depth, whatever moves the
object, for camera and sheet do not move with it. Depths from 1 / 1.5 of the nearest to 1.5 times the farthest stripe
point of the calibration leave, in each column (or row) of the image, a band of rows (or columns).
"""

from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.images import StripeSettings
from jaxscan.images.stripes.settle import Band
from jaxscan.reconstruction.triangulate import FramePoses, Kernel, triangulate
from jaxscan.rig import Fixed

# By how much the calibration's range of depths is widened, either way.
WIDENED: Final = 1.5
# The sheet's depth is computed at every Nth pixel of a line, and the band widened by as much.
_EVERY: Final = 4


def depths_of(content: RigFile) -> tuple[float, float] | None:
    """The depths of a rig's working volume (`sheet_band`), mm; None where the rig does not determine it."""
    depths = content.fit.get("stripe_depths_mm")
    return None if depths is None else (float(depths[0]) / WIDENED, float(depths[1]) * WIDENED)


def check_depths(depths_mm: tuple[float, float]) -> None:
    """Refuse depths that are none.

    Raises:
        InputError: they are negative, not in order, or not numbers.
    """
    near, far = depths_mm
    if not 0 <= near < far:
        raise InputError(f"depths {near:g} to {far:g} mm: give the nearest and the farthest, as 200,500, or 0,inf")


def sheet_band(
    kernel: Kernel, laser: StripeSettings, size: tuple[int, int], depths_mm: tuple[float, float]
) -> Band | None:
    """The first and the last row (or column) of each line at which the sheet is between two depths; None for all.

    Args:
        kernel: of the laser.
        laser: whether lines are columns.
        size: columns and rows of the image.
        depths_mm: the nearest and the farthest, along the optical axis; of a fisheye, from the camera's centre.
    """
    near, far = depths_mm
    if near == 0 and far == np.inf:
        return None
    lines, length = size if laser.columns else size[::-1]
    line, place = np.meshgrid(
        np.arange(lines), np.arange(0, length + _EVERY, _EVERY).clip(max=length - 1), indexing="ij"
    )
    u, v = (line, place) if laser.columns else (place, line)
    still = FramePoses.create(Fixed(), {}, len(line))
    found = triangulate(kernel, still, *(jnp.asarray(x, jnp.float32) for x in (u, v)))
    depth: Float[np.ndarray, "lines places"] = kernel.chart.range_of(np.asarray(found))
    # NaN where a ray does not meet the sheet.
    inside = (depth >= near) & (depth <= far)
    low = np.where(inside, place, np.inf).min(axis=1) - _EVERY
    high = np.where(inside, place, -np.inf).max(axis=1) + _EVERY
    return low.astype(np.float32), high.astype(np.float32)
