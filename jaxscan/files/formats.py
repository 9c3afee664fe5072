"""The formats of cameras: their names, what they are called in words, and by which endings a file is known.

Light to import, so that a command line can list them; `cameras` reads and writes them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jaxscan.errors import InputError


@dataclass(frozen=True)
class Format:
    """A format of cameras.

    Attributes:
        title: what it is, in words.
        endings: of the files that may hold it, the usual one first.
        module: the module with its `read` and `write`.
        keeps_views: whether a file of this format can hold board poses, corners and standard deviations.
    """

    title: str
    endings: tuple[str, ...]
    module: str
    keeps_views: bool = False


FORMATS: Final = {
    "rig": Format("jaxscan's rig.json", (".json",), "jaxscan.files.rig_camera"),
    "bouguet": Format("Bouguet's toolbox", (".mat",), "jaxscan.files.matlab", keeps_views=True),
    "opencv": Format("OpenCV's FileStorage", (".yml", ".yaml", ".xml"), "jaxscan.files.opencv"),
    "ros": Format("ROS's camera_info", (".yaml", ".yml"), "jaxscan.files.ros"),
    "kalibr": Format("Kalibr's camchain", (".yaml", ".yml"), "jaxscan.files.kalibr"),
    "mrcal": Format("mrcal's .cameramodel", (".cameramodel",), "jaxscan.files.mrcal"),
}
ENDINGS: Final = tuple(dict.fromkeys(ending for form in FORMATS.values() for ending in form.endings))


def formats_of(path: Path) -> list[str]:
    """The names of the formats that a file of this ending may hold.

    Raises:
        InputError: there is none.
    """
    names = [name for name, form in FORMATS.items() if path.suffix.lower() in form.endings]
    if not names:
        raise InputError(
            f'{path}: no format of cameras is known by the ending "{path.suffix}": use one of {", ".join(ENDINGS)}'
        )
    return names


def format_to_write(path: Path, name: str | None) -> str:
    """The name of the format to write: the one asked for, or the only one of the ending.

    Raises:
        InputError: there is no such format, it does not go with the ending, or the ending leaves a choice.
    """
    if name is not None and name not in FORMATS:
        raise InputError(f'there is no format "{name}": use one of {", ".join(FORMATS)}')
    names = formats_of(path)
    if name is None and len(names) > 1:
        raise InputError(f"{path}: several formats are known by this ending: give the format, {' or '.join(names)}")
    if name is not None and name not in names:
        endings = " or ".join(FORMATS[name].endings)
        raise InputError(f"{path}: the format {name} is not read back from this ending: end the name in {endings}")
    return name or names[0]
