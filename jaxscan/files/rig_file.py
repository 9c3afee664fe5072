"""`rig.json`: what calibration writes and reconstruction reads, format "jaxscan-rig/2"; format 1 is read too.

All numbers pass through the file unchanged: they are written with as many digits as a float64 needs, and read into
NumPy float64 leaves, whatever JAX's present default precision is.
"""

import json
import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np
from jaxtyping import Array

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.rig_checks import check_covariance, check_focal, check_image_size, image_rays
from jaxscan.files.rig_format_1 import FORMAT_1, PARTS_1, axis_tables_1, light_tables_1, parameter_names_1
from jaxscan.files.rig_parts import (
    leaves,
    lights_values,
    motion_values,
    part_numbers,
    part_tables,
    read_lens,
    read_lights,
    read_motion,
)
from jaxscan.files.table import LARGEST, PassedOverWarning, Table, show
from jaxscan.files.text import read_json
from jaxscan.precision import as_numpy
from jaxscan.rig import Camera, Covariance, Light, Rig
from jaxscan.rig.rig import parameter_names

FORMAT: Final = "jaxscan-rig/2"
# What words about the board's shape are made of.
_OF_SHAPE: Final = ("board_bent_mm", "board_bent_sigma_mm")


@dataclass(frozen=True)
class RigFile:
    """What a rig file holds.

    Attributes:
        rig: the rig, with NumPy float64 leaves.
        covariance: that of the rig's parameters, where it is known.
        fit: the quality of the fit: `corner_rms_px`, `stripe_rms_px`, `views` and what else the calibration reports.
            `warnings`, if present, are sentences that every user of the rig must see.
    """

    rig: Rig
    covariance: Covariance | None = None
    fit: dict[str, Any] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the rig, in words; empty for most."""
        return tuple(self.fit.get("warnings", ()))


def read_rig(path: str | os.PathLike[str]) -> RigFile:
    """Read and check a rig file.

    Keys that this version does not know are ignored, with a `PassedOverWarning` that names them.

    Raises:
        InputError: whatever is wrong with the file: what it is, the key, and how to fix it.
    """
    return _decode(read_json(Path(path), "the rig.json that `jaxscan calibrate` wrote"))


def write_rig(path: str | os.PathLike[str], content: RigFile) -> None:
    """Write a rig file, whole or not at all. A rig that could not be read again is refused.

    Raises:
        InputError: the rig or its covariance is not sound, or the file cannot be written.
    """
    values = _encode(content)
    _decode(Table(Path(path), "", values))
    with replacing(path, "w") as file:
        file.write(_layout(values))


def _decode(table: Table) -> RigFile:
    _check_format(table)
    _check_finite(table)
    first = table.values["format"] == FORMAT_1
    parts = PARTS_1 if first else ("lights", "motion")
    unknown = table.unknown(("format", "units", "camera", *parts, "covariance", "fit"))
    with jax.enable_x64(True):
        camera = _camera(table.table("camera", "camera."), unknown)
        lights = light_tables_1(table, unknown) if first else part_tables(table, "lights", "lights")
        axes = axis_tables_1(table, unknown) if first else part_tables(table, "motion", "axes")
        rig = as_numpy(Rig(camera, _lights(lights, camera, unknown), read_motion(axes, unknown)))
    names = parameter_names_1(rig) if first else parameter_names(rig)
    content = RigFile(rig, _covariance(table, rig, names, unknown), _fit(table, len(rig.lights)))
    if unknown:
        keys = ", ".join(unknown)
        warnings.warn(f"{table.path}: ignored keys that this version does not know: {keys}", PassedOverWarning, 3)
    return content


def _check_format(table: Table) -> None:
    form = table.string("format")
    if form not in (FORMAT, FORMAT_1):
        raise table.error(
            "format",
            f'this version of jaxscan reads "{FORMAT}" and "{FORMAT_1}": calibrate again, or use another version',
        )
    if table.string("units") != "mm":
        raise table.error("units", 'must be "mm": convert the light plane (1/mm) and the stage (mm for each step)')


def _check_finite(table: Table) -> None:
    """Refuse NaN, infinity and absurdly large numbers wherever they stand, also in keys that are not looked into."""
    pending: list[tuple[str, Any]] = [(key, value) for key, value in table.values.items()]
    while pending:
        name, value = pending.pop()
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{table.path}: {name} is {value}: a rig holds finite numbers alone; calibrate again")
        if isinstance(value, int | float) and abs(value) > LARGEST:
            raise InputError(
                f"{table.path}: {name} is {show(value)}, larger than any number of a rig, which are finite and at most "
                f"{LARGEST:g}: calibrate again"
            )
        if isinstance(value, dict | list):
            inner = value.items() if isinstance(value, dict) else enumerate(value)
            pending += [(f"{name}.{key}", entry) for key, entry in inner]


# What reconstruction takes a pixel's σ from.
_STRIPE_ERRORS: Final = ("stripe_rms_px", "stripe_sigma_px", "stripe_sigma_ratio")
_POSE_ERRORS: Final = ("pose_sigma_mm", "pose_sigma_deg")
_CAMERA_KEYS: Final = ("image_size", "focal", "principal", "tilt")
_STEEPEST_TILT: Final = math.pi / 2


def _camera(table: Table, unknown: list[str]) -> Camera:
    lens = read_lens(table, _CAMERA_KEYS, unknown)
    fault = getattr(lens, "fault", lambda: None)()
    if fault is not None:
        raise table.error(*fault)
    focal = table.numbers("focal", 2)
    check_focal(table, "focal", focal)
    size = table.size("image_size")
    check_image_size(table, "image_size", size)
    tilt = table.numbers("tilt", 2) if "tilt" in table else ()
    if any(abs(angle) >= _STEEPEST_TILT for angle in tilt):
        raise table.error("tilt", "must be two angles in radians, each below a quarter turn: calibrate again")
    return Camera(
        focal=_pair(focal),
        principal=_pair(table.numbers("principal", 2)),
        lens=lens,
        image_size=size,
        tilt=leaves(tilt) if any(tilt) else (),
    )


def _lights(tables: list[Table], camera: Camera, unknown: list[str]) -> tuple[Light, ...]:
    lights = read_lights(tables, unknown)
    rays = image_rays(camera) if lights else np.zeros((0, 3))
    for light, table in zip(lights, tables, strict=True):
        if (fault := light.fault(rays)) is not None:
            raise table.error(*fault)
    return lights


def _covariance(table: Table, rig: Rig, names: list[str], unknown: list[str]) -> Covariance | None:
    """That of the rig's parameters, whose names in the file are given in the order of its leaves."""
    if "covariance" not in table:
        return None
    inner = table.table("covariance", "covariance.")
    unknown += [f"covariance.{key}" for key in inner.unknown(("parameters", "matrix"))]
    given = inner.sequence("parameters", "parameter names")
    matrix = check_covariance(inner, given, names)
    known = dict(zip(names, parameter_names(rig), strict=True))
    return Covariance(tuple(known[name] for name in given), matrix)


def _fit(table: Table, lights: int) -> dict[str, Any]:
    if "fit" not in table:
        return {}
    fit = table.table("fit", "fit.")
    for key in (*_STRIPE_ERRORS, *_POSE_ERRORS):
        if key in fit and fit.number(key) < 0:
            raise fit.error(key, "must be a number that is not negative: calibrate again")
    for key in _OF_SHAPE if "board_shape" in fit else ():
        if fit.number(key) < 0:
            raise fit.error(key, "must be a number that is not negative: calibrate again")
    if "sheet_sigma_mm" in fit and min(fit.numbers("sheet_sigma_mm", lights), default=0.0) < 0:
        raise fit.error("sheet_sigma_mm", "must be a number for each light, 0 if it is not known: calibrate again")
    if "stripe_depths_mm" in fit and not 0 < (depths := fit.numbers("stripe_depths_mm", 2))[0] <= depths[1]:
        raise fit.error("stripe_depths_mm", "must be the nearest and the farthest depth of a stripe: calibrate again")
    if "light_positions" in fit:
        swept = fit.table("light_positions", "fit.light_positions.")
        _ = [swept.numbers(axis, 2) for axis in swept.values]
    _check_vectors(fit, "pose_offset_unknown", "directions")
    if "pose_range" in fit:
        poses = fit.table("pose_range", "fit.pose_range.")
        _ = [poses.numbers(key, 3) for key in ("least_mm", "most_mm", "turn")], poses.number("within_rad")
        _check_vectors(poses, "turns", "rotation vectors")
    if "sigma_over_noise_alone" in fit:
        ratios = fit.table("sigma_over_noise_alone", "fit.sigma_over_noise_alone.")
        if not ratios.values or any(ratios.number(name) <= 0 for name in ratios.values):
            raise fit.error("sigma_over_noise_alone", "must be a number above 0 for each parameter: calibrate again")
    if "warnings" in fit and not all(isinstance(word, str) for word in fit.sequence("warnings", "sentences")):
        raise fit.error("warnings", "must be a list of sentences: calibrate again")
    return dict(fit.values)


def _check_vectors(table: Table, key: str, of: str) -> None:
    """Refuse a list whose entries are not three numbers each; it may be left out."""
    for i, vector in enumerate(table.sequence(key, of) if key in table else ()):
        Table(table.path, f"{table.prefix}{key}.", {str(i): vector}).numbers(str(i), 3)


def _pair(values: tuple[float, ...]) -> tuple[Array, Array]:
    a, b = leaves(values)
    return a, b


def _encode(content: RigFile) -> dict[str, Any]:
    rig = content.rig
    camera = rig.camera
    values: dict[str, Any] = {
        "format": FORMAT,
        "units": "mm",
        "camera": {
            "image_size": list(camera.image_size),
            "focal": _floats(camera.focal),
            "principal": _floats(camera.principal),
            "lens": camera.lens.kind,
            **part_numbers(camera.lens),
            **({"tilt": _floats(camera.tilt)} if camera.tilt else {}),
        },
    }
    values |= {"lights": lights_values(rig.lights), "motion": motion_values(rig.motion)}
    if content.covariance is not None:
        matrix = np.asarray(content.covariance.matrix, dtype=np.float64).tolist()
        values["covariance"] = {"parameters": list(content.covariance.names), "matrix": matrix}
    if content.fit:
        values["fit"] = content.fit
    return values


def _floats(leaves: tuple[Any, ...]) -> list[float]:
    return [float(leaf) for leaf in leaves]


def _layout(values: dict[str, Any]) -> str:
    """JSON with one line for each part of the rig and one for each row of the covariance: a person reads it."""
    parts = [
        f'  "{key}": {_matrix_by_rows(value) if key == "covariance" else _line(value)}' for key, value in values.items()
    ]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _matrix_by_rows(covariance: dict[str, Any]) -> str:
    rows = ",\n      ".join(_line(row) for row in covariance["matrix"])
    return f'{{\n    "parameters": {_line(covariance["parameters"])},\n    "matrix": [\n      {rows}\n    ]\n  }}'


_line: Callable[[Any], str] = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
