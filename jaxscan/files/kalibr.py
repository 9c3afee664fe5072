"""Kalibr's `camchain.yaml`: one camera or several, by the names cam0, cam1, ….

`intrinsics` of a pinhole are f_u, f_v, u₀, v₀; `radtan` is OpenCV's k1 k2 p1 p2, `equidistant`
the k1 k2 k3 k4 of its fisheye. Pixel (0, 0) is the centre of the top
left pixel, as the corners are those of OpenCV's `cornerSubPix`. The poses of the cameras among each other and to an
inertial sensor is passed over.

Source: Kalibr's wiki, "YAML formats" and "Supported models".
"""

from pathlib import Path
from typing import Final

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.camera_file import (
    CameraFile,
    camera_from_terms,
    check_size,
    fisheye_from_terms,
    fisheye_terms,
    pass_over,
    pinhole_of,
    terms_for,
)
from jaxscan.files.table import Table
from jaxscan.files.yaml_text import dump_yaml, read_yaml

# The distortion models that we have, and how many coefficients each has.
_DISTORTIONS: Final = {"radtan": 4, "equidistant": 4, "none": 0}
_KEYS: Final = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution")
# Of no meaning outside of the recording.
_SILENT: Final = ("rostopic", "cam_overlaps")


def recognises(table: Table) -> bool:
    """Whether a YAML file is a camchain."""
    return bool(_names(table))


def read(path: Path, name: str | None, image_size: tuple[int, int] | None) -> CameraFile:
    """One camera of a camchain."""
    whole = read_yaml(path)
    names = _names(whole)
    if not names:
        raise InputError(f"{path}: has no camera with camera_model and intrinsics, as a camchain has: check the file")
    if name is None and len(names) > 1:
        raise InputError(f"{path}: holds the cameras {', '.join(names)}: give the name of one")
    chosen = names[0] if name is None else name
    if chosen not in names:
        raise InputError(f'{path}: there is no camera "{chosen}", but {", ".join(names)}: give the name of one')
    table = whole.table(chosen, f"{chosen}.")
    model = table.string("camera_model")
    if model != "pinhole":
        raise table.error("camera_model", "jaxscan has no such camera: calibrate with pinhole-radtan")
    distortion = table.string("distortion_model", "none")
    if distortion not in _DISTORTIONS:
        raise table.error("distortion_model", "jaxscan has no such lens: calibrate with pinhole-radtan or pinhole-equi")
    pinhole = table.numbers("intrinsics", 4)
    count = _DISTORTIONS[distortion]
    terms = table.numbers("distortion_coeffs", count) if count or "distortion_coeffs" in table else ()
    size = check_size(table, "resolution", table.numbers("resolution", 2), image_size)
    make = fisheye_from_terms if distortion == "equidistant" else camera_from_terms
    camera = make(table, "intrinsics", size, pinhole, terms)
    pass_over(path, [f"{chosen}.{key}" for key in table.unknown((*_KEYS, *_SILENT))])
    return CameraFile(size, camera)


def write(path: Path, content: CameraFile) -> None:
    """A camchain of one camera, cam0, pinhole-radtan or pinhole-equi.

    Raises:
        InputError: the lens has k3 or a denominator.
    """
    camera = content.the_camera(path)
    angular = fisheye_terms(path, camera, "Kalibr's equidistant")
    terms = terms_for(path, camera, 4, "Kalibr's radtan") if angular is None else angular
    model = "radtan" if angular is None else "equidistant"
    values = ("pinhole", pinhole_of(camera), model, terms, list(content.image_size))
    with replacing(path, "w") as file:
        file.write(dump_yaml({"cam0": dict(zip(_KEYS, values, strict=True))}))


def _names(table: Table) -> list[str]:
    return [
        key
        for key, value in table.values.items()
        if isinstance(value, dict) and {"camera_model", "distortion_model"} & value.keys() and "intrinsics" in value
    ]
