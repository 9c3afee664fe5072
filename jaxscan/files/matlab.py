"""What Bouguet's Camera Calibration Toolbox for Matlab saves: `Calib_Results.mat` and `calib_data.mat`.

With (x, y) distorted as OpenCV does by kc = (k1, k2, p1, p2, k3), a pixel is (fc₁ (x + alpha_c y) + cc₁, fc₂ y + cc₂).
Pixel (0, 0) is the centre of the top left pixel, in cc and in the corners x_i alike: the toolbox subtracts 1 from
Matlab's coordinates. The board's frame is the toolbox's own, x along the first side that was clicked, z towards the
camera: omc_i and Tc_i take X_i to the camera's frame. Its `…_error` are three standard deviations.

`calib_data.mat` is the same without the camera and the poses. Of `n_ima` photographs those take part of which
`active_images` is 1; where no corners were found they are NaN, or not there.

Source: J.-Y. Bouguet, "Description of the calibration parameters", and the files that the toolbox writes.
"""

import re
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float64

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.camera_file import (
    BoardView,
    CameraFile,
    camera_from_terms,
    matrix_of,
    one_camera,
    pinhole_of,
    size_of,
    skewed,
    terms_for,
    terms_from,
)
from jaxscan.files.mat5 import read_matrices
from jaxscan.files.table import Table, show

_CAMERA: Final = ("fc", "cc", "kc", "alpha_c")
_READABLE: Final = re.compile(
    r"(fc|cc|kc|alpha_c)(_error)?|n[xy]|n_ima|active_images|(x|X|omc|Tc|omc_error|Tc_error)_[1-9][0-9]{0,4}"
)
_SIGMAS: Final = 3.0
_MOST: Final = 99999
# Where each of the terms of kc stands in `rig.json`.
_KC_NAMES: Final = ("radial.0", "radial.1", "tangential.0", "tangential.1", "radial.2")


def read(path: Path, name: str | None, image_size: tuple[int, int] | None) -> CameraFile:
    """Camera, standard deviations and the photographs of the board; the camera is None in `calib_data.mat`."""
    one_camera(path, name)
    arrays = read_matrices(path, _READABLE)
    views, unseen = _views(path, arrays)
    if not any(name in arrays for name in _CAMERA) and not views:
        raise InputError(
            f"{path}: has neither fc, cc and kc, as Calib_Results.mat of Bouguet's toolbox, nor X_1 and x_1, as its "
            "calib_data.mat: check which program wrote it"
        )
    table = Table(path, "", {name: array.ravel(order="F").tolist() for name, array in arrays.items()})
    scalars = Table(path, "", {name: table.numbers(name, 1)[0] for name in ("nx", "ny") if name in table})
    size = size_of(scalars, ("nx", "ny"), image_size)
    if not any(name in arrays for name in _CAMERA):
        return CameraFile(size, None, views=views, unseen=unseen)
    skew = table.numbers("alpha_c", 1)[0] if "alpha_c" in table else 0.0
    if skew != 0:
        raise skewed(table, "alpha_c", skew)
    terms = terms_from(table, "kc", table.numbers("kc"), (4, 5))
    camera = camera_from_terms(table, "fc", size, (*table.numbers("fc", 2), *table.numbers("cc", 2)), *terms)
    return CameraFile(size, camera, _sigmas(arrays), views, unseen)


def write(path: Path, content: CameraFile) -> None:
    """`Calib_Results.mat`, or `calib_data.mat` where there is no camera.

    Raises:
        InputError: the lens has a denominator.
    """
    import scipy.io

    variables = _camera_variables(path, content) if content.camera is not None else {}
    variables |= {"nx": content.image_size[0], "ny": content.image_size[1], "n_ima": len(content.views)}
    variables["active_images"] = np.array([[view.active for view in content.views]])
    for i, view in enumerate(content.views, start=1):
        variables |= {f"X_{i}": view.points.T, f"x_{i}": view.pixels.T}
        if content.camera is not None:
            variables |= {f"omc_{i}": view.pose[:3], f"Tc_{i}": view.pose[3:]}
            error = _SIGMAS * view.pose_sigma
            variables |= {f"omc_error_{i}": error[:3], f"Tc_error_{i}": error[3:]}
    as_matlab = {name: np.asarray(value, dtype=np.float64) for name, value in variables.items()}
    with replacing(path) as file:
        scipy.io.savemat(file, as_matlab, oned_as="column")


def _camera_variables(path: Path, content: CameraFile) -> dict[str, Any]:
    camera = content.the_camera(path)
    terms = terms_for(path, camera, 5, "Bouguet's toolbox")
    f_u, f_v, u0, v0 = pinhole_of(camera)
    K = np.array(matrix_of(camera))

    def errors(*names: str) -> list[float]:
        return [_SIGMAS * content.sigma.get(f"camera.{name}", np.nan) for name in names]

    return {
        "fc": [f_u, f_v],
        "cc": [u0, v0],
        "alpha_c": 0.0,
        "kc": terms,
        "KK": K,
        "inv_KK": np.linalg.inv(K),
        "fc_error": errors("focal.0", "focal.1"),
        "cc_error": errors("principal.0", "principal.1"),
        "alpha_c_error": 0.0,
        "kc_error": errors(*_KC_NAMES),
        "est_fc": [1.0, 1.0],
        "est_aspect_ratio": 1.0,
        "center_optim": 1.0,
        "est_alpha": 0.0,
        "est_dist": [float(term != 0) for term in terms],
    }


def _sigmas(arrays: dict[str, np.ndarray]) -> dict[str, float]:
    sigma = {}
    for error, names in (
        ("fc_error", ("focal.0", "focal.1")),
        ("cc_error", ("principal.0", "principal.1")),
        ("kc_error", _KC_NAMES),
    ):
        values = arrays.get(error, np.zeros(0)).ravel(order="F") / _SIGMAS
        # A term that was held has the error 0.
        sigma |= {f"camera.{name}": float(s) for name, s in zip(names, values, strict=False) if s > 0}
    return sigma


def _views(path: Path, arrays: dict[str, np.ndarray]) -> tuple[tuple[BoardView, ...], tuple[str, ...]]:
    """The photographs in which the board was seen, and the names of the others."""
    numbers = sorted({int(name.rsplit("_", 1)[1]) for name in arrays if re.match(r"(x|X|omc)_[0-9]+$", name)})
    active = _active(path, arrays, max(numbers, default=0))
    views, unseen = [], []
    for i in range(1, len(active) + 1):
        pixels = _shaped(path, arrays, f"x_{i}", 2)
        points = _shaped(path, arrays, f"X_{i}", 3)
        if len(pixels) != len(points):
            raise InputError(f"{path}: x_{i} has {len(pixels)} corners, X_{i} has {len(points)}: save the file again")
        pose, sigma = (
            np.concatenate([_three(path, arrays, f"{name}_{i}") for name in names])
            for names in (("omc", "Tc"), ("omc_error", "Tc_error"))
        )
        if np.isfinite(pixels).any() or np.isfinite(pose).all():
            views.append(BoardView(f"image {i}", pose, sigma / _SIGMAS, points, pixels, bool(active[i - 1])))
        else:
            unseen.append(f"image {i}")
    return tuple(views), tuple(unseen)


def _active(path: Path, arrays: dict[str, np.ndarray], last: int) -> Bool[np.ndarray, "images"]:
    """Which photographs take part: of n_ima, or of as many as there are corners of."""
    active = arrays.get("active_images")
    count = arrays["n_ima"].ravel() if "n_ima" in arrays else np.array([last if active is None else active.size])
    if count.size != 1 or not float(count[0]).is_integer() or not last <= count[0] <= _MOST:
        raise InputError(
            f"{path}: n_ima = {show(count.tolist())}, but it must be the number of images, here {last} or more: "
            "save the file again"
        )
    if active is None:
        return np.ones(int(count[0]), bool)
    if active.size != count[0] or not np.isin(active, (0, 1)).all():
        raise InputError(
            f"{path}: active_images must be 0 or 1 for each of the {int(count[0])} images, it is "
            f"{show(active.ravel().tolist())}: save the file again"
        )
    return active.ravel() == 1


def _shaped(path: Path, arrays: dict[str, np.ndarray], name: str, rows: int) -> Float64[np.ndarray, "points rows"]:
    array = arrays.get(name, np.zeros((rows, 0)))
    if array.ndim != 2 or array.shape[0] != rows:
        raise InputError(f"{path}: {name} has the shape {array.shape}, but {rows} rows are expected: save it again")
    return np.ascontiguousarray(array.T)


def _three(path: Path, arrays: dict[str, np.ndarray], name: str) -> Float64[np.ndarray, "3"]:
    array = arrays.get(name, np.full(3, np.nan)).ravel()
    if array.size == 1 and np.isnan(array).all():
        return np.full(3, np.nan)
    if array.size != 3:
        raise InputError(f"{path}: {name} holds {array.size} numbers, but 3 are expected: save the file again")
    return array
