"""Where in the image a stripe can be: the epipolar band of the working volume.

A pixel whose ray meets the sheet at depth z shows a stripe only where a surface is at that depth, whatever moves the
object, for camera and sheet do not move with it. Depths from 1 / 1.5 of the nearest to 1.5 times the farthest stripe
point of the calibration leave, in each column (or row) of the image, a band of rows (or columns).
"""

from collections.abc import Callable
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.images import StripeSettings
from jaxscan.images.stripes.settle import Band
from jaxscan.reconstruction.triangulate import FramePoses, Kernel, triangulate
from jaxscan.rig import Fixed, Positions, Rig
from jaxscan.rig.light import light_at
from jaxscan.rig.projection import pixel_rays

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


def swept_band(rig: Rig, laser: StripeSettings, depths_mm: tuple[float, float]) -> Callable[[Positions], Band] | None:
    """As `sheet_band`, of a light that moves: the band of each frame by positions of the axes, motor steps."""
    near, far = depths_mm
    if near == 0 and far == np.inf:
        return None
    light, (line, place) = rig.light(laser.name), _grid(laser, rig.camera.image_size)
    pixels = np.stack([line, place] if laser.columns else [place, line], axis=-1).reshape(-1, 2).astype(np.float64)
    rays = pixel_rays(rig.camera, pixels).astype(np.float32)
    ranges = rig.camera.chart.range_of(rays)

    def of_frames(q: Positions) -> Band:
        each = []
        for i in range(len(next(iter(q.values())))):
            w = np.asarray(light_at(light, {axis: np.float32(n[i]) for axis, n in q.items()}).inverse_depth(rays))
            each.append(_ends(ranges / np.where(w > 0, w, np.nan), place, near, far))
        low, high = (np.stack(edge) for edge in zip(*each, strict=True))
        return low, high

    return of_frames


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
    line, place = _grid(laser, size)
    u, v = (line, place) if laser.columns else (place, line)
    still = FramePoses.create(Fixed(), {}, len(line))
    found = triangulate(kernel, still, *(jnp.asarray(x, jnp.float32) for x in (u, v)))
    return _ends(kernel.chart.range_of(np.asarray(found)), place, near, far)


def _grid(
    laser: StripeSettings, size: tuple[int, int]
) -> tuple[Int[np.ndarray, "lines places"], Int[np.ndarray, "lines places"]]:
    """The lines of an image of this size, and the places in them that are looked at."""
    lines, length = size if laser.columns else size[::-1]
    places = np.arange(0, length + _EVERY, _EVERY).clip(max=length - 1)
    line, place = np.meshgrid(np.arange(lines), places, indexing="ij")
    return line, place


def _ends(
    depth: Float[np.ndarray, "*points"], place: Int[np.ndarray, "lines places"], near: float, far: float
) -> tuple[Float[np.ndarray, "lines"], Float[np.ndarray, "lines"]]:
    """The first and the last place of each line whose depth is between two; NaN where a ray does not meet the sheet."""
    depth = depth.reshape(place.shape)
    inside = (depth >= near) & (depth <= far)
    low = np.where(inside, place, np.inf).min(axis=1) - _EVERY
    high = np.where(inside, place, -np.inf).max(axis=1) + _EVERY
    return low.astype(np.float32), high.astype(np.float32)
