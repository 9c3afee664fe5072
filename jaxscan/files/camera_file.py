"""What a file of some other program says of a camera, and how its lens terms and ours go together.

All the formats count pixels as we do, (0, 0) the *centre* of the top left pixel; each module names its source. All take
OpenCV's lens terms, in OpenCV's order (`calib3d`): k1 k2 p1 p2 k3 k4 k5 k6, then s1 … s4, which we have not, and
τx, τy, the tilt of the sensor.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64

from jaxscan.errors import InputError
from jaxscan.files.rig_checks import check_focal, check_image_size
from jaxscan.files.table import PassedOverWarning, Table, show
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, Rig
from jaxscan.rig.fisheye import Fisheye
from jaxscan.rig.opencv_lens import LADDER, OpenCVLens

TERMS: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_THIN_PRISM: Final = ("s1", "s2", "s3", "s4")


@dataclass(frozen=True)
class BoardView:
    """One photograph of a board, as another program saw it, in that program's board frame.

    Attributes:
        name: how messages call it.
        pose: T_cam_board, a rotation vector and a translation in the file's unit of length; NaN where it is not known.
        pose_sigma: their standard deviations; NaN where they are not known.
        points: points of the board, in the file's unit of length.
        pixels: where they were seen, (u, v).
        active: whether it was to take part in the calibration.
    """

    name: str
    pose: Float64[np.ndarray, "6"]
    pose_sigma: Float64[np.ndarray, "6"]
    points: Float64[np.ndarray, "points 3"]
    pixels: Float64[np.ndarray, "points 2"]
    active: bool = True


@dataclass(frozen=True)
class CameraFile:
    """What a file says of a camera.

    Attributes:
        image_size: columns and rows.
        camera: the camera, with NumPy float64 leaves; None where the file holds corners alone.
        sigma: standard deviations by the names that `rig.json` has for parameters, where they are known.
        views: the photographs of the board, where the format has them.
        unseen: the names of further photographs, in which no corner was found.
        beside: what else the file holds and no other format takes, in words.
        rig: the whole rig, of a rig.json.
    """

    image_size: tuple[int, int]
    camera: Camera | None
    sigma: Mapping[str, float] = field(default_factory=dict)
    views: tuple[BoardView, ...] = ()
    unseen: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    rig: Rig | None = None

    def the_camera(self, path: Path) -> Camera:
        """The camera.

        Raises:
            InputError: there are corners alone.
        """
        if self.camera is None:
            raise InputError(f"{path}: there are the corners of photographs and no camera: name Calib_Results.mat")
        return self.camera


def camera_from_terms(
    table: Table,
    focal_key: str,
    size: tuple[int, int],
    pinhole: Sequence[float],
    terms: Sequence[float],
    tilt: Sequence[float] = (),
) -> Camera:
    """A camera with the leanest lens of the ladder that has all the terms that are not zero.

    Args:
        table: where the numbers are from, for errors.
        focal_key: the key there that holds the focal length.
        size: columns and rows.
        pinhole: f_u, f_v, u₀, v₀, in pixels.
        terms: as many of `TERMS` as there are; the others are zero.
        tilt: τx, τy, if there are; zeros are a sensor that is not tilted.

    Raises:
        InputError: a focal length that no camera has.
    """
    check_focal(table, focal_key, pinhole[:2])
    k1, k2, p1, p2, *higher = (*terms, *[0.0] * (len(TERMS) - len(terms)))
    radial, tangential = (k1, k2, *higher), (p1, p2)
    for kind in LADDER.values():
        n_radial, n_tangential = kind.numbers.values()
        if not any(radial[n_radial:]) and not any(tangential[n_tangential:]):
            break
    else:
        raise AssertionError("the last lens of the ladder has every term")
    with float64():
        f_u, f_v, u0, v0 = _leaves(pinhole)
        lens = kind(_leaves(radial[:n_radial]), _leaves(tangential[:n_tangential]))
        return as_numpy(Camera((f_u, f_v), (u0, v0), lens, size, _leaves(tilt) if any(tilt) else ()))


def fisheye_from_terms(
    table: Table, focal_key: str, size: tuple[int, int], pinhole: Sequence[float], terms: Sequence[float]
) -> Camera:
    """A camera with a fisheye, as OpenCV's `fisheye` has it, and ROS and Kalibr under the name of equidistant.

    Args:
        table: where the numbers are from, for errors.
        focal_key: the key there that holds the focal length.
        size: columns and rows.
        pinhole: f_u, f_v, u₀, v₀, in pixels.
        terms: k1 … k4.

    Raises:
        InputError: a focal length that no camera has, or not four terms.
    """
    check_focal(table, focal_key, pinhole[:2])
    if len(terms) != Fisheye.numbers["angular"]:
        raise InputError(f"{table.path}: a fisheye has 4 coefficients, here are {len(terms)}: write the file again")
    with float64():
        f_u, f_v, u0, v0 = _leaves(pinhole)
        return as_numpy(Camera((f_u, f_v), (u0, v0), Fisheye(_leaves(terms)), size))


def fisheye_terms(path: Path, camera: Camera, title: str) -> list[float] | None:
    """k1 … k4 of a fisheye; None of a camera with another lens.

    Raises:
        InputError: the sensor is tilted.
    """
    if not isinstance(camera.lens, Fisheye):
        return None
    if camera.tilt:
        raise _tilted(path, camera, title)
    return [float(term) for term in camera.lens.angular]


def _tilted(path: Path, camera: Camera, title: str) -> InputError:
    angles = " and ".join(f"{float(angle):.6g}" for angle in camera.tilt)
    return InputError(
        f"{path}: the sensor is tilted by {angles} rad, which has no counterpart in {title}: write a rig.json or "
        "OpenCV's format"
    )


def _leaves(values: Sequence[float]) -> tuple[Float[Array, ""], ...]:
    return tuple(jnp.asarray(value, jnp.float64) for value in values)


def pinhole_of(camera: Camera) -> list[float]:
    """f_u, f_v, u₀, v₀."""
    return [float(leaf) for leaf in (*camera.focal, *camera.principal)]


def terms_for(path: Path, camera: Camera, count: int, title: str, *, tilts: bool = False) -> list[float]:
    """The first `count` of the camera's `TERMS`, for a format that has a place for tilted sensors or not.

    Raises:
        InputError: a term beyond them is not zero; it is named. Or the lens has terms of its own, or the sensor
            is tilted and the format has no place for it.
    """
    if camera.tilt and not tilts:
        raise _tilted(path, camera, title)
    if not isinstance(camera.lens, OpenCVLens):
        raise InputError(
            f'{path}: the lens "{camera.lens.kind}" has no counterpart in {title}, which has OpenCV\'s terms: write a '
            f"rig.json, or calibrate with one of {', '.join(LADDER)}"
        )
    k = [float(leaf) for leaf in camera.lens.radial] + [0.0] * (6 - len(camera.lens.radial))
    p = [float(leaf) for leaf in camera.lens.tangential] or [0.0, 0.0]
    terms = [k[0], k[1], *p, *k[2:]]
    for name, value in zip(TERMS[count:], terms[count:], strict=True):
        if value != 0:
            raise InputError(
                f"{path}: the lens term {name} = {value:.6g} has no counterpart in {title}, which ends with "
                f"{TERMS[count - 1]}: write another format, or calibrate with a leaner lens"
            )
    return terms[:count]


def terms_from(
    table: Table, key: str, values: Sequence[float], counts: Sequence[int]
) -> tuple[Sequence[float], Sequence[float]]:
    """The terms that we have of coefficients in OpenCV's order, and the tilt of the sensor, empty where there is none.

    Raises:
        InputError: their number is none of `counts`, or one of s1 … s4 is not zero; it is named.
    """
    if len(values) not in counts:
        wanted = " or ".join(map(str, counts))
        raise table.error(key, f"must hold {wanted} coefficients, it holds {len(values)}: write the file again")
    for name, value in zip(_THIN_PRISM, values[len(TERMS) :], strict=False):
        if value != 0:
            raise table.error(
                key, f"the lens term {name} = {value:.6g} has no counterpart in jaxscan: calibrate without it"
            )
    return values[: len(TERMS)], values[len(TERMS) + len(_THIN_PRISM) :]


def pinhole_from_matrix(table: Table, key: str, matrix: Sequence[float]) -> tuple[float, float, float, float]:
    """f_u, f_v, u₀, v₀ of a camera matrix, row by row.

    Raises:
        InputError: it has not nine numbers, it has skew, or it is no camera matrix.
    """
    if len(matrix) != 9:
        raise table.error(key, f"must be a matrix of 3 × 3 numbers, it has {len(matrix)}: write the file again")
    f_u, skew, u0, below, f_v, v0, *last = matrix
    if skew != 0:
        raise skewed(table, key, skew)
    if below != 0 or last != [0, 0, 1]:
        raise table.error(
            key, "is no camera matrix, which is f_u, 0, u₀; 0, f_v, v₀; 0, 0, 1 row by row: write the file again"
        )
    return f_u, f_v, u0, v0


def matrix_numbers(table: Table, key: str) -> tuple[float, ...]:
    """The numbers of a matrix, row by row: of `{rows, cols, data}`, or of a plain list.

    Raises:
        InputError: there is none, a number is not finite, or there are not rows × cols of them.
    """
    if not isinstance(table.values.get(key), dict):
        return table.numbers(key)
    inner = table.table(key, f"{table.prefix}{key}.")
    data = inner.numbers("data")
    if {"rows", "cols"} <= inner.values.keys() and inner.whole("rows") * inner.whole("cols") != len(data):
        raise inner.error("data", f"must hold rows × cols numbers, it holds {len(data)}: write the file again")
    return data


def matrix_of(camera: Camera) -> list[list[float]]:
    """The camera matrix, row by row."""
    f_u, f_v, u0, v0 = pinhole_of(camera)
    return [[f_u, 0.0, u0], [0.0, f_v, v0], [0.0, 0.0, 1.0]]


def skewed(table: Table, key: str, skew: float) -> InputError:
    """The error for pixel axes that are not square to each other."""
    return table.error(key, f"the skew {skew:.6g} has no counterpart in jaxscan: calibrate without skew")


def size_of(table: Table, keys: tuple[str, str], asked: tuple[int, int] | None) -> tuple[int, int]:
    """Columns and rows from two keys of the file, or as asked for where the file has neither.

    Raises:
        InputError: the file has none and none was asked for, or they are not positive whole numbers, or the two differ.
    """
    missing = [key for key in keys if key not in table]
    if missing and asked is None:
        raise table.error(
            missing[0],
            "is missing, so the size of the photographs is not known: write it there, or give the image size",
        )
    if missing:
        return asked or (0, 0)
    return check_size(table, keys[0], [table.number(key) for key in keys], asked)


def check_size(table: Table, key: str, numbers: Sequence[float], asked: tuple[int, int] | None) -> tuple[int, int]:
    """Columns and rows as positive whole numbers that are what was asked for, if anything was.

    Raises:
        InputError: they are not.
    """
    if len(numbers) != 2 or any(not number.is_integer() or number < 1 for number in map(float, numbers)):
        raise table.error(key, f"the image size {show(list(numbers))} must be columns and rows, whole and positive")
    size = int(numbers[0]), int(numbers[1])
    check_image_size(table, key, size)
    if asked is not None and asked != size:
        raise other_size(table.path, size, asked)
    return size


def other_size(path: Path, size: tuple[int, int], asked: tuple[int, int]) -> InputError:
    """The error for a camera whose photographs have another size than those that it is wanted for."""
    return InputError(
        f"{path}: is a camera of {size[0]} x {size[1]} pixels, but {asked[0]} x {asked[1]} are wanted: "
        "name the camera that took the photographs"
    )


def one_camera(path: Path, name: str | None) -> None:
    """Refuse a camera's name for a format that holds one camera alone."""
    if name is not None:
        raise InputError(f'{path}: this format holds one camera, without a name: leave out the name "{name}"')


def pass_over(path: Path, what: Sequence[str]) -> None:
    """Say what of a file is not read, if anything."""
    if what:
        warnings.warn(f"{path}: passed over {', '.join(what)}", PassedOverWarning, stacklevel=2)
