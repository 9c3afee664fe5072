"""What a rig file must fulfil beyond its types: a light plane that the camera sees, a covariance that is one."""

import math
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from jaxscan.files.table import Table, show
from jaxscan.rig import Camera
from jaxscan.rig.projection import pixel_rays

# A sheet nearer to the centre of projection than this (mm) is seen edge on: its depth is lost in rounding.
_NEAREST_SHEET: Final = 1e-3
# Pixels along each axis of the image at which rays are looked at; odd, so that one is the middle.
_GRID: Final = 17
# Rounding of a covariance, relative to the standard deviations of the parameters.
_ROUNDING: Final = 1e-8


def check_light_plane(table: Table, camera: Camera, plane: tuple[float, ...]) -> None:
    """Refuse a light plane through the camera, and one that no pixel sees.

    Raises:
        InputError: ω · x > 0 for no pixel of the image, or the plane passes within a thousandth of a millimetre.
    """
    omega = np.array(plane)
    length = math.hypot(*plane)
    if length > 1 / _NEAREST_SHEET:
        raise table.error(
            "plane",
            f"the light plane passes through the camera, {1 / length:.1g} mm from its centre: "
            "the laser must stand beside the camera; calibrate again, with the board tilted and at several distances",
        )
    if not _is_seen(camera, omega):
        raise table.error(
            "plane",
            "no pixel sees the light plane (ω · x is nowhere positive, so the sheet lies behind the camera): "
            "check its sign; ω · X = 1 on the sheet, with z forward",
        )


def _is_seen(camera: Camera, omega: Float64[np.ndarray, "3"]) -> bool:
    """Whether ω · x > 0 for some pixel of the image.

    ω · x is linear in the ray, and a lens takes the border of the image to the border of the field of view: besides
    the ray of the principal point, (0, 0, 1), only the border has to be looked at.
    """
    columns, rows = camera.image_size
    u0, v0 = (float(c) for c in camera.principal)
    if omega[2] > 0 and -0.5 <= u0 <= columns - 0.5 and -0.5 <= v0 <= rows - 0.5:
        return True
    return bool(np.any(image_rays(camera) @ omega > 0))


def image_rays(camera: Camera) -> Float64[np.ndarray, "rays 3"]:
    """The rays of a grid of pixels from border to border, row by row; that of the image's middle is the middle one.

    Not of the border alone: that of a very wide lens may lie outside its invertible range, where rays are NaN.
    """
    columns, rows = camera.image_size
    u = np.linspace(-0.5, columns - 0.5, _GRID)
    v = np.linspace(-0.5, rows - 0.5, _GRID)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return pixel_rays(camera, pixels)


def check_covariance(table: Table, names: list[Any], parameters: list[str]) -> Float64[np.ndarray, "n n"]:
    """The matrix of a covariance, once its names and its numbers are seen to fit.

    Args:
        table: with the keys `parameters` and `matrix`.
        names: what `parameters` holds.
        parameters: the names that the rig has.

    Raises:
        InputError: a name that the rig has not or that stands twice, a matrix that is not square, not symmetric or
            not positive semidefinite.
    """
    for i, name in enumerate(names):
        if name not in parameters:
            raise table.error("parameters", f"this rig has no {show(name)}; it has {', '.join(parameters)}")
        if name in names[:i]:
            raise table.error("parameters", f"{show(name)} stands twice: name each parameter once")
    matrix = _square(table, len(names))
    deviation = np.sqrt(np.abs(np.diag(matrix)))
    scaled = matrix / np.outer(scale := np.where(deviation > 0, deviation, 1.0), scale)
    if np.abs(scaled - scaled.T).max(initial=0.0) > _ROUNDING:
        raise table.error("matrix", "is not symmetric, so it is no covariance: calibrate again")
    if len(names) and np.linalg.eigvalsh(scaled).min() < -_ROUNDING * len(names):
        raise table.error("matrix", "is not positive semidefinite, so it is no covariance: calibrate again")
    return matrix


def _square(table: Table, n: int) -> Float64[np.ndarray, "n n"]:
    rows = table.sequence("matrix", "rows")
    if len(rows) != n or any(not isinstance(row, list) or len(row) != n for row in rows):
        raise table.error("matrix", f"must have {n} rows of {n} numbers, as there are {n} parameters: calibrate again")
    lines = [Table(table.path, f"{table.prefix}matrix.", {str(i): row}).numbers(str(i)) for i, row in enumerate(rows)]
    return np.array(lines, dtype=np.float64).reshape(n, n)
