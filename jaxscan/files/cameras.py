"""Cameras in any format: which one a file is in, and the verbs that read and write them."""

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from jaxscan.errors import InputError
from jaxscan.files import opencv
from jaxscan.files.camera_file import CameraFile
from jaxscan.files.formats import FORMATS, format_to_write, formats_of
from jaxscan.rig import Camera


def read_camera(
    path: str | os.PathLike[str], *, name: str | None = None, image_size: tuple[int, int] | None = None
) -> Camera:
    """The camera of a file: `rig.json`, or Bouguet's, OpenCV's, ROS's, Kalibr's or mrcal's.

    Its lens is the leanest of the ladder that has all the terms that are not zero in the file.

    Args:
        path: the file.
        name: which camera of a camchain of several.
        image_size: columns and rows, where the file (OpenCV's need not) has none.

    Raises:
        InputError: whatever is wrong with the file, or a term of its model that jaxscan lacks: the key, and how to fix
            it.
    """
    return read_camera_file(path, name=name, image_size=image_size).the_camera(Path(path))


def write_camera(path: str | os.PathLike[str], camera: Camera, *, format: str | None = None) -> None:
    """Write a camera, whole or not at all; reading it again gives the same numbers, bit for bit.

    Args:
        path: the file. Its ending determines the format, except for .yml and .yaml, which three programs use.
        camera: the camera.
        format: "rig", "bouguet", "opencv", "ros", "kalibr" or "mrcal".

    Raises:
        InputError: a lens term has no counterpart in the format, or the file cannot be written.
    """
    write_camera_file(path, CameraFile(camera.image_size, camera), format=format)


def read_camera_file(
    path: str | os.PathLike[str], *, name: str | None = None, image_size: tuple[int, int] | None = None
) -> CameraFile:
    """As `read_camera`, with all that the file says of the camera's uncertainty and of the boards that it saw."""
    return _module(format_of(Path(path))).read(Path(path), name, image_size)


def write_camera_file(path: str | os.PathLike[str], content: CameraFile, *, format: str | None = None) -> None:
    """As `write_camera`, with all of it that the format takes; `lost` says what it does not."""
    _module(format_to_write(Path(path), format)).write(Path(path), content)


def lost(content: CameraFile, format: str) -> list[str]:
    """What of a file's content another format does not take, in words."""
    gone = list(content.beside)
    if not FORMATS[format].keeps_views:
        gone += ["the standard deviations"] if content.sigma else []
        gone += [f"{len(content.views)} photographs of the board"] if content.views else []
    return gone


def format_of(path: Path) -> str:
    """The name of the format that a file is in, by its ending and, for YAML, by what is in it.

    Raises:
        InputError: it is none that is known.
    """
    names = formats_of(path)
    if len(names) == 1:
        return names[0]
    if opencv.is_storage(path):
        return "opencv"
    from jaxscan.files import kalibr, ros
    from jaxscan.files.yaml_text import read_yaml

    table = read_yaml(path)
    for module, format in ((kalibr, "kalibr"), (ros, "ros")):
        if module.recognises(table):
            return format
    raise InputError(
        f"{path}: holds {', '.join(table.values) or 'nothing'}: neither OpenCV's matrices (!!opencv-matrix), nor "
        "camera_matrix or K, as a ROS camera_info has, nor cam0 with camera_model, as a Kalibr camchain has: "
        "check which file it is"
    )


def _module(format: str) -> Any:
    """Each brings what it needs, SciPy or PyYAML, when it is first used."""
    return import_module(FORMATS[format].module)
