"""ROS's `camera_info`: the YAML file of `camera_info_manager`, or the message as `rostopic echo` prints it.

K and D describe the raw photographs, D with OpenCV's terms: `plumb_bob` k1 k2 p1 p2 k3, `rational_polynomial` on
to k6; of `equidistant` k1 k2 k3 k4 of its fisheye. R and P describe rectified photographs,
which jaxscan does not take; a pair's geometry in them is passed over with a warning. Binning and a region of interest
change which pixels there are, so they are refused. Pixel (0, 0) is the centre of
the top left pixel, as `camera_calibration` calls OpenCV.

Source: ROS's `sensor_msgs/CameraInfo` and REP 104; `camera_calibration_parsers`.
"""

from pathlib import Path
from typing import Final

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
from jaxscan.files.yaml_text import dump_yaml, read_yaml

# How many coefficients each of the distortion models that we have may hold: OpenCV pads with zeros.
_MODELS: Final = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8, 12, 14), "none": (0,), "": (0, 4, 5)}
_FISHEYE: Final = "equidistant"
_IDENTITY: Final = [1, 0, 0, 0, 1, 0, 0, 0, 1]
# The same quantity in the YAML file, in the message of ROS 1 and in that of ROS 2.
_WIDTH: Final = ("image_width", "width")
_HEIGHT: Final = ("image_height", "height")
_K: Final = ("camera_matrix", "K", "k")
_D: Final = ("distortion_coefficients", "D", "d")
_R: Final = ("rectification_matrix", "R", "r")
_P: Final = ("projection_matrix", "P", "p")


def recognises(table: Table) -> bool:
    """Whether a YAML file is a camera_info."""
    return any(key in table for key in _K)


def read(path: Path, name: str | None, image_size: tuple[int, int] | None) -> CameraFile:
    """The camera of a camera_info, at full resolution."""
    one_camera(path, name)
    table = read_yaml(path)
    _whole_sensor(table)
    size = size_of(table, (_key(table, _WIDTH), _key(table, _HEIGHT)), image_size)
    model = table.values.get("distortion_model", "plumb_bob")  # older files have none and mean this
    if not isinstance(model, str) or model not in (*_MODELS, _FISHEYE):
        raise table.error(
            "distortion_model",
            "jaxscan has no such lens: calibrate with plumb_bob, rational_polynomial or equidistant",
        )
    K, D = _key(table, _K), _key(table, _D)
    pinhole = pinhole_from_matrix(table, K, matrix_numbers(table, K))
    coefficients = matrix_numbers(table, D) if D in table or model != "none" else ()
    if model == _FISHEYE:
        camera = fisheye_from_terms(table, K, size, pinhole, coefficients)
    else:
        camera = camera_from_terms(table, K, size, pinhole, *terms_from(table, D, coefficients, _MODELS[model]))
    pass_over(path, _pair_geometry(table))
    return CameraFile(size, camera)


def write(path: Path, content: CameraFile) -> None:
    """The YAML file of `camera_info_manager`, of a camera that stands alone: R is the identity, P is K."""
    camera = content.the_camera(path)
    angular = fisheye_terms(path, camera, "ROS's equidistant")
    terms = terms_for(path, camera, 8, "ROS's rational_polynomial") if angular is None else angular
    rational = any(terms[5:])
    model = "rational_polynomial" if rational else "plumb_bob"
    D = terms if rational else terms[:5]
    K = matrix_of(camera)
    values = {
        "image_width": content.image_size[0],
        "image_height": content.image_size[1],
        "camera_name": "camera",
        "camera_matrix": _rows(K),
        "distortion_model": model if angular is None else _FISHEYE,
        "distortion_coefficients": _rows([D]),
        "rectification_matrix": _rows([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        "projection_matrix": _rows([[*row, 0.0] for row in K]),
    }
    with replacing(path, "w") as file:
        file.write(dump_yaml(values))


def _key(table: Table, names: tuple[str, ...]) -> str:
    """The name that the file has for a quantity, or the first one."""
    return next((name for name in names if name in table), names[0])


def _rows(matrix: list[list[float]]) -> dict[str, object]:
    return {"rows": len(matrix), "cols": len(matrix[0]), "data": [number for row in matrix for number in row]}


def _whole_sensor(table: Table) -> None:
    """Refuse photographs that are not all pixels of the sensor: K is that of full resolution (REP 104)."""
    for key in ("binning_x", "binning_y"):
        if key in table and table.whole(key) > 1:
            raise table.error(key, "the photographs are binned, K is not: record a camera_info without binning")
    roi = table.table("roi", "roi.") if isinstance(table.values.get("roi"), dict) else Table(table.path, "roi.", {})
    for key in ("x_offset", "y_offset", "width", "height"):
        whole = {"width": _key(table, _WIDTH), "height": _key(table, _HEIGHT)}.get(key)
        if key in roi and roi.whole(key) not in (0, table.values.get(whole or "", 0)):
            raise roi.error(key, "the photographs are cut out of the sensor's, K is not: record without a region")


def _pair_geometry(table: Table) -> list[str]:
    """What R and P say of a second camera."""
    R, P = _key(table, _R), _key(table, _P)
    turned = R in table and list(matrix_numbers(table, R)) not in (_IDENTITY, [0.0] * 9)
    shifted = P in table and any(matrix_numbers(table, P)[3::4])
    return [key for key, there in ((R, turned), (P, shifted)) if there]
