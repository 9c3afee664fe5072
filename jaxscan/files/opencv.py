"""OpenCV's FileStorage, YAML or XML, as its calibration samples and most programs that call it write it.

Names differ from program to program, in case, underlines and length: camera_matrix, cameraMatrix, Camera_Matrix;
distortion_coefficients, distCoeffs, dist_coeffs. There are 4, 5, 8, 12 or 14 coefficients: k1 k2 p1 p2 k3 k4 k5 k6 s1
s2 s3 s4 τx τy; or, where `fisheye_model` is 1, k1 k2 k3 k4 of its fisheye. Pixel (0, 0) is
the centre of the top left pixel. The size of the image is not always there.

OpenCV writes these files here but does not read them: on damaged YAML its reader ends the process.

Source: OpenCV's documentation of `FileStorage` and `calibrateCamera`, and its calibration samples.
"""

import contextlib
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import cv2
import numpy as np

from jaxscan.atomic import replacing
from jaxscan.files.camera_file import (
    CameraFile,
    camera_from_terms,
    fisheye_from_terms,
    fisheye_terms,
    matrix_numbers,
    matrix_of,
    one_camera,
    pass_over,
    pinhole_from_matrix,
    size_of,
    terms_for,
    terms_from,
)
from jaxscan.files.table import Table
from jaxscan.files.text import parse_file
from jaxscan.files.yaml_text import read_yaml

_MATRIX: Final = ("cameramatrix", "intrinsicmatrix", "k")
_COEFFICIENTS: Final = ("distortioncoefficients", "distcoeffs", "distcoeff", "distortion", "d")
_WIDTH: Final = ("imagewidth", "width")
_HEIGHT: Final = ("imageheight", "height")
_FISHEYE: Final = ("fisheyemodel", "fisheye")
_POSES: Final = ("extrinsicparameters", "perviewextrinsics", "rvecs", "tvecs")
_COUNTS: Final = (4, 5, 8, 12, 14)


def is_storage(path: Path) -> bool:
    """Whether a file is a FileStorage: YAML with OpenCV's tags or its own kind of first line, or its XML."""
    text = parse_file(path, "YAML or XML", str)
    return text.startswith("%YAML:") or "opencv-matrix" in text or "<opencv_storage" in text


def read(path: Path, name: str | None, image_size: tuple[int, int] | None) -> CameraFile:
    """The camera of a FileStorage."""
    one_camera(path, name)
    table = _read_xml(path) if path.suffix.lower() == ".xml" else read_yaml(path)
    keys = {key.lower().replace("_", ""): key for key in table.values}

    def key(names: tuple[str, ...], usual: str) -> str:
        return next((keys[name] for name in names if name in keys), usual)

    fisheye = key(_FISHEYE, "")
    size = size_of(table, (key(_WIDTH, "image_width"), key(_HEIGHT, "image_height")), image_size)
    K, D = key(_MATRIX, "camera_matrix"), key(_COEFFICIENTS, "distortion_coefficients")
    pinhole = pinhole_from_matrix(table, K, matrix_numbers(table, K))
    coefficients = matrix_numbers(table, D)
    if fisheye and table.values[fisheye]:
        camera = fisheye_from_terms(table, K, size, pinhole, coefficients)
    else:
        camera = camera_from_terms(table, K, size, pinhole, *terms_from(table, D, coefficients, _COUNTS))
    pass_over(path, [keys[name] for name in _POSES if name in keys])
    return CameraFile(size, camera)


def write(path: Path, content: CameraFile) -> None:
    """YAML, or XML where the file ends in .xml, with the names of OpenCV's own samples."""
    camera = content.the_camera(path)
    angular = fisheye_terms(path, camera, "OpenCV's fisheye")
    terms = terms_for(path, camera, 8, "OpenCV's rational model", tilts=True) if angular is None else angular
    if camera.tilt:
        terms += [0.0] * 4 + [float(angle) for angle in camera.tilt]
    kind = cv2.FILE_STORAGE_FORMAT_XML if path.suffix.lower() == ".xml" else cv2.FILE_STORAGE_FORMAT_YAML
    storage = cv2.FileStorage("", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | kind)
    storage.write("image_width", content.image_size[0])
    storage.write("image_height", content.image_size[1])
    if angular is not None:
        storage.write("fisheye_model", 1)
    storage.write("camera_matrix", np.array(matrix_of(camera)))
    storage.write("distortion_coefficients", np.array(terms if any(terms[5:]) else terms[:5])[:, None])
    text = storage.releaseAndGetString()
    with replacing(path, "w") as file:
        file.write(text)


def _read_xml(path: Path) -> Table:
    """The outermost table of OpenCV's XML: matrices as `{rows, cols, data}`, numbers as numbers."""

    def parse(text: str) -> dict[str, Any]:
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ValueError(str(error)) from error
        if root.tag != "opencv_storage":
            raise ValueError(f"its outermost element is <{root.tag}>, not <opencv_storage>")
        return {element.tag: _value(element) for element in root}

    return Table(path, "", parse_file(path, "OpenCV FileStorage", parse))


def _value(element: ElementTree.Element) -> Any:
    if len(element):
        return {child.tag: _value(child) for child in element} | {"data": _numbers(element.findtext("data", ""))}
    numbers = _numbers(element.text or "")
    return numbers[0] if len(numbers) == 1 else numbers


def _numbers(text: str) -> list[Any]:
    """The numbers of a text, whole ones as such; what is none stays a text."""
    return [_number(word) for word in text.split()]


def _number(word: str) -> Any:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(word)
    return word
