"""Points as a PLY file: binary, little endian, `float x y z`, then what is known of each point.

A file whose points stand first and in fixed-size binary records, as here, is read as one array. Any other PLY goes
through trimesh, and gives its coordinates alone.
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from jaxtyping import Float32, UInt8

from jaxscan.atomic import replacing
from jaxscan.errors import InputError

_NEEDS_SURFACE: Final = (".stl", ".obj", ".glb", ".gltf", ".off", ".3mf")
_SCALARS: Final = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS: Final = {"binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS: Final = ("red", "green", "blue")
_LONGEST_HEADER: Final = 1 << 16


@dataclass(frozen=True)
class Cloud:
    """Points in the object frame.

    Attributes:
        points: mm.
        sigma: standard deviation along the ray, rig and pixel together (mm), where it is known.
        sigma_pixel: the pixel's part of it (mm), where it is known.
        colours: red, green, blue, where they are known.
    """

    points: Float32[np.ndarray, "points 3"]
    sigma: Float32[np.ndarray, "points"] | None = None
    sigma_pixel: Float32[np.ndarray, "points"] | None = None
    colours: UInt8[np.ndarray, "points 3"] | None = None


def check_ending(path: str | os.PathLike[str]) -> str:
    """The ending of a file that points can be written to: ".ply" (a cloud) or ".npz" (an organised range image).

    Raises:
        InputError: another ending.
    """
    ending = Path(path).suffix.lower()
    if ending in _NEEDS_SURFACE:
        raise InputError(f"{path}: {ending} holds a surface, and these are points without one: write .ply or .npz")
    if ending not in (".ply", ".npz"):
        raise InputError(f'{path}: the ending "{ending}" is not known: write .ply (a cloud) or .npz (a range image)')
    return ending


def write_ply(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write a cloud, whole or not at all.

    Raises:
        InputError: there are no points, a coordinate is not finite, or the file cannot be written.
    """
    if not len(cloud.points):
        raise InputError(f"{path}: there are no points to write: check that the photographs show the stripe")
    if not np.isfinite(cloud.points).all():
        raise InputError(f"{path}: a point has a coordinate that is not a finite number: leave missing points out")
    columns: dict[str, Any] = dict(zip("xyz", cloud.points.T, strict=True))
    columns |= {name: getattr(cloud, name) for name in ("sigma", "sigma_pixel") if getattr(cloud, name) is not None}
    types = dict.fromkeys(columns, ("float", "<f4"))
    if cloud.colours is not None:
        columns |= dict(zip(_COLOURS, cloud.colours.T, strict=True))
        types |= dict.fromkeys(_COLOURS, ("uchar", "u1"))
    records = np.empty(len(cloud.points), dtype=[(name, scalar) for name, (_, scalar) in types.items()])
    for name, values in columns.items():
        records[name] = values
    header = ["ply", "format binary_little_endian 1.0", "comment units mm", f"element vertex {len(records)}"]
    header += [f"property {word} {name}" for name, (word, _) in types.items()]
    with replacing(path, "wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        file.write(records.data)


def read_ply(path: str | os.PathLike[str]) -> Cloud:
    """Read the points of a PLY file.

    Raises:
        InputError: the file is missing, is no PLY, is cut short, or holds no points.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            if not file.readline(_LONGEST_HEADER).strip() == b"ply":
                raise InputError(
                    f"{path}: is not a PLY file, it does not begin with the line ply: check which file it is"
                )
            layout = _plain_layout(file)
            cloud = _as_cloud(_read_records(path, file, *layout)) if layout else _through_trimesh(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file: check the path") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder: name a PLY file in it") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check its permissions") from error
    if not len(cloud.points):
        raise InputError(f"{path}: holds no points: check which file it is")
    return cloud


def _plain_layout(file: IO[bytes]) -> tuple[int, np.dtype, bool] | None:
    """Number, record and "nothing follows" of points that stand first, binary, without lists; None of any others."""
    order, count, fields, elements = None, 0, [], 0
    while (line := file.readline(_LONGEST_HEADER)).strip() != b"end_header":
        words = line.decode("ascii", "replace").split()
        match words:
            case []:
                if not line:
                    return None
            case ["format", name, _]:
                order = _BYTE_ORDERS.get(name)
            case ["element", name, number]:
                elements += 1
                if elements == 1:
                    if name != "vertex" or not number.isdecimal():
                        return None
                    count = int(number)
            case ["property", kind, name] if elements == 1 and kind in _SCALARS:
                fields.append((name, f"{order}{_SCALARS[kind]}"))
            case ["property", *_] if elements == 1:
                return None
    names = [name for name, _ in fields]
    if order is None or not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        return None
    return count, np.dtype(fields), elements == 1


def _read_records(path: Path, file: IO[bytes], count: int, record: np.dtype, last: bool) -> np.ndarray:
    there = path.stat().st_size - file.tell()
    promised = count * record.itemsize
    if there < promised or (last and there > promised):
        raise InputError(
            f"{path}: its header promises {count} points ({promised} bytes), {there} bytes follow: "
            "the file is damaged; copy or write it again"
        )
    return np.fromfile(file, dtype=record, count=count)


def _as_cloud(records: np.ndarray) -> Cloud:
    names = records.dtype.names or ()

    def column(name: str) -> Float32[np.ndarray, "points"] | None:
        return records[name].astype(np.float32) if name in names else None

    coloured = all(name in names and records.dtype[name] == np.uint8 for name in _COLOURS)
    return Cloud(
        points=np.stack([records[name] for name in "xyz"], axis=-1).astype(np.float32, copy=False),
        sigma=column("sigma"),
        sigma_pixel=column("sigma_pixel"),
        colours=np.stack([records[name] for name in _COLOURS], axis=-1) if coloured else None,
    )


def _through_trimesh(path: Path) -> Cloud:
    import trimesh

    try:
        loaded = trimesh.load(path, file_type="ply", process=False, skip_materials=True)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, struct.error) as error:
        raise InputError(f"{path}: cannot be read as PLY ({error}): write it again") from error
    points = np.asarray(getattr(loaded, "vertices", ()), dtype=np.float32).reshape(-1, 3)
    # Trimesh takes an ASCII file that ends early for a shorter one; it makes more vertices of some, never fewer.
    promised = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("length", 0)
    if len(points) < promised:
        raise InputError(
            f"{path}: its header promises {promised} points, {len(points)} can be read: "
            "the file is damaged; copy or write it again"
        )
    return Cloud(points)
