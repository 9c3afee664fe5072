"""What a rig file must fulfil beyond its types: a covariance that is one."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from jaxscan.files.table import Table, show
from jaxscan.images.headers import MOST_PIXELS
from jaxscan.rig import Camera
from jaxscan.rig.projection import pixel_rays

# Pixels along each axis of the image at which rays are looked at; odd, so that one is the middle.
_GRID: Final = 17
# The shortest and the longest focal length, px: the sixth power of a pixel's angle is still a float32.
_FOCAL_LENGTHS: Final = (1e-3, 1e9)
# Rounding of a covariance, relative to the standard deviations of the parameters.
_ROUNDING: Final = 1e-8


def image_rays(camera: Camera) -> Float64[np.ndarray, "rays 3"]:
    """The rays of a grid of pixels from border to border, row by row; that of the image's middle is the middle one.

    Not of the border alone: that of a very wide lens may lie outside its invertible range, where rays are NaN.
    """
    columns, rows = camera.image_size
    u = np.linspace(-0.5, columns - 0.5, _GRID)
    v = np.linspace(-0.5, rows - 0.5, _GRID)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return pixel_rays(camera, pixels)


def check_focal(table: Table, key: str, focal: Sequence[float]) -> None:
    """Refuse focal lengths that no camera has.

    Raises:
        InputError: one is not positive, or so small or large that what is computed with it overflows.
    """
    least, most = _FOCAL_LENGTHS
    if not all(least <= length <= most for length in focal):
        raise table.error(
            key,
            f"must be two positive numbers of pixels, the focal lengths, from {least:g} to {most:g}: calibrate again",
        )


def check_image_size(table: Table, key: str, size: tuple[int, int]) -> None:
    """Refuse the size of photographs that cannot be read.

    Raises:
        InputError: they have too many pixels.
    """
    if size[0] * size[1] > MOST_PIXELS:
        raise table.error(key, f"a photograph has at most {MOST_PIXELS // 10**6} million pixels: correct it")


def check_covariance(table: Table, names: list[Any], parameters: list[str]) -> Float64[np.ndarray, "n n"]:
    """The matrix of a covariance, once its names and its numbers are seen to fit.

    Args:
        table: with the keys `parameters` and `matrix`.
        names: what `parameters` holds.
        parameters: the names that the rig has.

    Raises:
        InputError: a name that the rig has not or that appears twice, a matrix that is not square, not symmetric or
            not positive semidefinite.
    """
    for i, name in enumerate(names):
        if name not in parameters:
            raise table.error("parameters", f"this rig has no {show(name)}; it has {', '.join(parameters)}")
        if name in names[:i]:
            raise table.error("parameters", f"{show(name)} appears twice: name each parameter once")
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
