"""Points in the formats of other programs: XYZ, PCD, E57 and LAZ.

| ending | what it holds | step of a coordinate |
|---|---|---|
| `.xyz` | text, `x y z` in mm, a line for each point | 1e-5 mm |
| `.pcd` | Point Cloud Library's, version 0.7, binary: x, y, z, and what is known, in mm | float32 |
| `.e57` | ASTM E2807, by pye57: cartesian coordinates in *metres*, as the standard has it, and the strength as intensity | float64 |
| `.laz`, `.las` | ASPRS LAS 1.4, by laspy: integers of 1e-4 mm, and what is known in dimensions of our own | 1e-4 mm |

The last two need the extra `exchange`. E57 and LAZ are written when all points are there; the others as they come.
"""  # noqa: E501 (a table)

import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.files.cloud import NUMBERS, Cloud, adding_points, check_points, read_ply, writing_ply
from jaxscan.files.packed_colours import packed, unpacked
from jaxscan.missing import no_such_file

EXCHANGE: Final = (".xyz", ".pcd", ".e57", ".laz", ".las")
CLOUDS: Final = (".ply", *EXCHANGE)
_MM_PER_M: Final = 1000.0
_LAS_STEP_MM: Final = 1e-4
# Red, green and blue in the bytes of one number, as PCL has them.
_RGB: Final = "rgb"
# Digits that the number of points may have in a PCD's header, which is written before they are counted.
_DIGITS: Final = 12
_PCD_TYPES: Final = {"F": "f", "I": "i", "U": "u"}
# Rows of text that are made at a time.
_ROWS: Final = 100_000


def check_exchange(path: str | os.PathLike[str]) -> None:
    """Refuse a file that needs the extra `exchange` where that is not installed.

    Raises:
        InputError: it is not.
    """
    if Path(path).suffix.lower() in (".e57", ".laz", ".las"):
        extra("exchange")


def read_cloud(path: str | os.PathLike[str]) -> Cloud:
    """Read points from a `.ply`, or from one of the formats of `EXCHANGE`; millimetres, but what an E57 has in metres.

    Raises:
        InputError: the file is missing or damaged, holds no points, has another ending, or its extra is not installed.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in CLOUDS:
        raise InputError(f'{path}: the ending "{ending}" is not known: points are read from {", ".join(CLOUDS)}')
    if ending == ".ply":
        return read_ply(path)
    check_exchange(path)
    if not path.is_file():
        raise no_such_file(Path(path))
    cloud = _READERS[ending](path)
    if not len(cloud.points):
        raise InputError(f"{path}: holds no points: check which file it is")
    check_points(path, cloud.points, "points", "leave them out")
    return cloud


@contextmanager
def writing_cloud(path: str | os.PathLike[str]) -> Iterator[Callable[[Cloud], None]]:
    """Write points that come some at a time, whole or not at all: the block is given what adds them.

    Raises:
        InputError: there were no points, a coordinate is not finite, the file cannot be written, or the extra is not
            installed.
    """
    ending = Path(path).suffix.lower()
    if ending == ".ply":
        with writing_ply(path) as add:
            yield add
        return
    check_exchange(path)
    with _WRITERS[ending](Path(path)) as write, adding_points(path, write) as add:
        yield add


def write_cloud(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write points, whole or not at all; the ending says the format.

    Raises:
        InputError: as `writing_cloud`.
    """
    with writing_cloud(path) as add:
        add(cloud)


@contextmanager
def _writing_xyz(path: Path) -> Iterator[Callable[[Cloud], None]]:
    with replacing(path) as file:

        def add(cloud: Cloud) -> None:
            for first in range(0, len(cloud.points), _ROWS):
                rows = cloud.points[first : first + _ROWS].astype(np.float64)
                file.write(b"".join(b"%.5f %.5f %.5f\n" % tuple(row) for row in rows.tolist()))

        yield add


def _read_xyz(path: Path) -> Cloud:
    try:
        with warnings.catch_warnings():
            # A file without a line is said by whoever asked.
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(path, dtype=np.float64, ndmin=2, usecols=(0, 1, 2), comments="#")
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not a text of x, y and z in each line ({error}): check the file") from error
    return Cloud(table.reshape(-1, 3).astype(np.float32))


@contextmanager
def _writing_pcd(path: Path) -> Iterator[Callable[[Cloud], None]]:
    count, names, places = 0, (), ()
    with replacing(path) as file:

        def add(cloud: Cloud) -> None:
            nonlocal count, names, places
            known = {name: getattr(cloud, name) for name in NUMBERS if getattr(cloud, name) is not None}
            if cloud.colours is not None:
                known[_RGB] = packed(cloud.colours)
            if not count:
                names = tuple(known)
                places = _pcd_header(file, names)
            columns = [*cloud.points.T, *(known[name] for name in names)]
            file.write(np.stack(columns, axis=-1).astype("<f4").tobytes())
            count += len(cloud.points)

        yield add
        for place in places:
            file.seek(place)
            file.write(b"%-*d" % (_DIGITS, count))


def _pcd_header(file: IO[bytes], known: tuple[str, ...]) -> tuple[int, int]:
    """Write the header, and return where the number of points is to stand, twice."""
    n = 3 + len(known)
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format, millimetres",
        "VERSION 0.7",
        f"FIELDS x y z{''.join(f' {name}' for name in known)}",
        f"SIZE{' 4' * n}",
        f"TYPE{' F' * n}",
        f"COUNT{' 1' * n}",
        "WIDTH " + " " * _DIGITS,
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        "POINTS " + " " * _DIGITS,
        "DATA binary",
        "",
    ]
    header = "\n".join(lines).encode()
    file.write(header)
    return header.index(b"WIDTH ") + 6, header.index(b"POINTS ") + 7


def _read_pcd(path: Path) -> Cloud:
    data = path.read_bytes()
    head, mark, rest = data.partition(b"DATA ")
    values = {}
    for line in head.decode("latin-1").splitlines():
        key, _, value = line.partition(" ")
        values[key] = value.split()
    kind, _, body = rest.partition(b"\n")
    try:
        sizes, types, counts = values["SIZE"], values["TYPE"], values.get("COUNT", ["1"] * len(values["SIZE"]))
        number = int(values["POINTS"][0])
        layout = [
            (name, f"<{_PCD_TYPES[kind]}{int(size)}", int(count))
            for name, size, kind, count in zip(values["FIELDS"], sizes, types, counts, strict=True)
        ]
        row = np.dtype([each if each[2] != 1 else each[:2] for each in layout])
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(f"{path}: is no PCD, or its header is damaged ({error}): check the file") from error
    if not mark or kind.strip() != b"binary":
        raise InputError(
            f"{path}: has DATA {kind.decode('latin-1').strip()}; only binary is read: save it as binary, or as .ply"
        )
    if not set("xyz") <= set(row.names or ()) or number < 0 or len(body) < number * row.itemsize:
        raise InputError(f"{path}: holds less than its header says: it was cut short, write it again")
    table = np.frombuffer(body, row, number)
    known: dict[str, Any] = {name: table[name].astype(np.float32) for name in NUMBERS if name in (row.names or ())}
    if _RGB in (row.names or ()) and row[_RGB].itemsize == np.dtype("<u4").itemsize:
        known["colours"] = unpacked(table[_RGB])
    return Cloud(np.stack([table[axis] for axis in "xyz"], axis=-1).astype(np.float32), **known)


@contextmanager
def _whole(path: Path, write: Callable[[Path, Cloud], None]) -> Iterator[Callable[[Cloud], None]]:
    """Gather all points, and let a library write them to a file beside, which is then renamed into place."""
    parts: list[Cloud] = []
    yield parts.append
    if not parts:
        return
    names = [field.name for field in fields(Cloud) if getattr(parts[0], field.name) is not None]
    cloud = Cloud(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
    with tempfile.TemporaryDirectory() as folder, replacing(path) as file:
        made = Path(folder) / f"points{path.suffix.lower()}"
        write(made, cloud)
        file.write(made.read_bytes())


def _pye57() -> Any:
    extra("exchange")
    import pye57

    return pye57


def _write_e57(path: Path, cloud: Cloud) -> None:
    pye57 = _pye57()
    metres = cloud.points.astype(np.float64) / _MM_PER_M
    values = {f"cartesian{axis}": np.ascontiguousarray(metres[:, i]) for i, axis in enumerate("XYZ")}
    if cloud.strength is not None:
        values["intensity"] = cloud.strength.astype(np.float64)
    if cloud.colours is not None:
        values |= {f"color{name}": cloud.colours[:, i] for i, name in enumerate(("Red", "Green", "Blue"))}
    file = pye57.E57(str(path), mode="w")
    try:
        file.write_scan_raw(values)
    finally:
        file.close()


def _read_e57(path: Path) -> Cloud:
    pye57 = _pye57()
    try:
        file = pye57.E57(str(path))
        scans = [
            file.read_scan(i, ignore_missing_fields=True, intensity=True, colors=True) for i in range(file.scan_count)
        ]
        file.close()
    except Exception as error:  # libE57Format's own class, in another module in each version
        raise InputError(f"{path}: cannot be read as E57 ({error}): check the file") from error
    if not scans:
        return Cloud(np.zeros((0, 3), np.float32))
    points = np.concatenate([np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=-1) for scan in scans])
    strength = colours = None
    if all("intensity" in scan for scan in scans):
        strength = np.concatenate([scan["intensity"] for scan in scans]).astype(np.float32)
    if all("colorRed" in scan for scan in scans):
        rgb = [np.stack([scan[f"color{name}"] for name in ("Red", "Green", "Blue")], axis=-1) for scan in scans]
        colours = np.concatenate(rgb).astype(np.uint8)
    return Cloud((_MM_PER_M * points).astype(np.float32), strength=strength, colours=colours)


def _write_las(path: Path, cloud: Cloud) -> None:
    laspy = extra("exchange")
    header = laspy.LasHeader(point_format=7 if cloud.colours is not None else 6, version="1.4")
    header.offsets = np.floor(cloud.points.min(axis=0).astype(np.float64))
    header.scales = np.full(3, _LAS_STEP_MM)
    known = {name: getattr(cloud, name) for name in NUMBERS if getattr(cloud, name) is not None}
    for name in known:
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=np.float32))
    file = laspy.LasData(header)
    file.x, file.y, file.z = cloud.points.astype(np.float64).T
    for name, values in known.items():
        file[name] = values
    if cloud.colours is not None:
        # LAS has 16 bits for each.
        file.red, file.green, file.blue = (257 * cloud.colours.astype(np.uint16)).T
    file.write(str(path))


def _read_las(path: Path) -> Cloud:
    laspy = extra("exchange")
    try:
        file = laspy.read(str(path))
    except Exception as error:  # laspy's and lazrs's own classes, struct.error, and more
        raise InputError(f"{path}: cannot be read as LAS ({error}): check the file") from error
    names = set(file.point_format.dimension_names)
    known: dict[str, Any] = {name: np.asarray(file[name], np.float32) for name in NUMBERS if name in names}
    if {"red", "green", "blue"} <= names:
        rgb = np.stack([np.asarray(file[name]) for name in ("red", "green", "blue")], axis=-1)
        known["colours"] = (rgb // 257).astype(np.uint8)
    return Cloud(np.asarray(file.xyz, np.float32), **known)


_WRITERS: Final[dict[str, Callable[[Path], Any]]] = {
    ".xyz": _writing_xyz,
    ".pcd": _writing_pcd,
    ".e57": lambda path: _whole(path, _write_e57),
    ".laz": lambda path: _whole(path, _write_las),
    ".las": lambda path: _whole(path, _write_las),
}
_READERS: Final[dict[str, Callable[[Path], Cloud]]] = {
    ".xyz": _read_xyz,
    ".pcd": _read_pcd,
    ".e57": _read_e57,
    ".laz": _read_las,
    ".las": _read_las,
}
