"""mrcal's `.cameramodel`: a Python dictionary of plain values.

`intrinsics` are f_u, f_v, u₀, v₀ and the lens's terms; LENSMODEL_OPENCV4, 5 and 8 are OpenCV's first 4, 5 and 8. Pixel
(0, 0) is the centre of the top left pixel: mrcal's own tests put the middle of the imager at (imagersize − 1) / 2.
Whatever describes the camera's place or the solve (`extrinsics`, `rt_cam_ref`, `optimization_inputs`,
`valid_intrinsics_region`) is no part of a camera here.

Source: mrcal, "Camera model file formats", and its parsers of them.
"""

import ast
import re
import warnings
from pathlib import Path
from typing import Any, Final

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.camera_file import (
    CameraFile,
    camera_from_terms,
    check_size,
    one_camera,
    pass_over,
    pinhole_of,
    terms_for,
)
from jaxscan.files.table import Table, show
from jaxscan.files.text import parse_file
from jaxscan.rig import Camera

# The lens models that we have, and how many terms each has.
MODELS: Final = {"LENSMODEL_PINHOLE": 0, "LENSMODEL_OPENCV4": 4, "LENSMODEL_OPENCV5": 5, "LENSMODEL_OPENCV8": 8}
# The first is written; the others are older.
_MODEL_KEYS: Final = ("lensmodel", "lens_model", "distortion_model")
# Python takes a kilobyte for each number; what mrcal packs into quotes, the inputs of the solve, is one value.
_MOST_OUTSIDE_QUOTES: Final = 500_000
_QUOTED: Final = re.compile(r"'[^'\n]*'|\"[^\"\n]*\"")
_POSES: Final = ("extrinsics", "rt_cam_ref")


def read(path: Path, name: str | None, image_size: tuple[int, int] | None) -> CameraFile:
    """The camera of a camera model."""
    one_camera(path, name)
    table = _dictionary(path)
    key = next((key for key in _MODEL_KEYS if key in table), _MODEL_KEYS[0])
    model = table.string(key).replace("DISTORTION_", "LENSMODEL_").replace("LENSMODEL_NONE", "LENSMODEL_PINHOLE")
    if model not in MODELS:
        raise table.error(key, f"jaxscan has no such lens: fit one of {', '.join(MODELS)} with mrcal-convert-lensmodel")
    numbers = table.numbers("intrinsics", 4 + MODELS[model])
    size = check_size(table, "imagersize", table.numbers("imagersize", 2), image_size)
    camera = camera_from_terms(table, "intrinsics", size, numbers[:4], numbers[4:])
    placed = [key for key in _POSES if key in table and any(table.numbers(key, 6))]
    pass_over(path, placed + table.unknown((*_MODEL_KEYS, *_POSES, "intrinsics", "imagersize")))
    return CameraFile(size, camera)


def write(path: Path, content: CameraFile) -> None:
    """A camera model at the origin, of the leanest lens model that has the camera's terms."""
    camera = content.the_camera(path)
    model, terms = _leanest(path, camera)
    values = {
        _MODEL_KEYS[0]: model,
        "intrinsics": pinhole_of(camera) + terms,
        "extrinsics": [0.0] * 6,
        "imagersize": list(content.image_size),
    }
    with replacing(path, "w") as file:
        file.write("{\n" + "".join(f"    {key!r}: {value!r},\n" for key, value in values.items()) + "}\n")


def _leanest(path: Path, camera: Camera) -> tuple[str, list[float]]:
    terms = terms_for(path, camera, 8, "mrcal's LENSMODEL_OPENCV8")
    return next((model, terms[:count]) for model, count in MODELS.items() if not any(terms[count:]))


def _dictionary(path: Path) -> Table:
    def parse(text: str) -> Any:
        if len(_QUOTED.sub("", text)) > _MOST_OUTSIDE_QUOTES:
            raise ValueError(f"it has more than {_MOST_OUTSIDE_QUOTES} letters outside of quotes")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SyntaxWarning)
                return ast.literal_eval(text.strip())
        except (SyntaxError, TypeError, MemoryError) as error:
            raise ValueError(str(error) or type(error).__name__) from error

    values = parse_file(path, "mrcal camera model", parse)
    if not isinstance(values, dict):
        raise InputError(
            f"{path}: holds {show(values)}, but a dictionary in braces is expected: check which file it is"
        )
    return Table(path, "", {str(key): _plain(value) for key, value in values.items()})


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
