"""`profiles.toml`: what a laser profiler delivers, and how the object moved from one profile to the next.

A profiler measures in its own plane: x along the profile, z away from itself (`z = "distance"`) or towards itself
(`"height"`). Its files are CSV, range maps (an image or array of 16 bits or of float32, one row for each profile) or
raw buffers in the pixel formats Coord3D of GenICam's Pixel Format Naming Convention. A coordinate is number × scale +
offset, as Scan3dCoordinateScale and Scan3dCoordinateOffset of GenICam's SFNC say.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Shaped

from jaxscan.errors import InputError
from jaxscan.files.axes import Positions, read_axes
from jaxscan.files.listing import files_of
from jaxscan.files.profiles_csv import read_profiles_csv
from jaxscan.files.rig_parts import part_tables, read_motion
from jaxscan.files.settings import read_listing
from jaxscan.files.table import Table
from jaxscan.images import read_image
from jaxscan.npy import read_npy, read_npy_header
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Motion

PROFILES_FILE: Final = "profiles.toml"
UNITS_MM: Final = {"um": 0.001, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
# Of each pixel format the numbers of a pixel, and their type.
_FORMATS: Final = {
    "Coord3D_C16": (1, np.dtype("<u2")),
    "Coord3D_C32f": (1, np.dtype("<f4")),
    "Coord3D_AC16": (2, np.dtype("<u2")),
    "Coord3D_AC32f": (2, np.dtype("<f4")),
}
_CSV, _MAPS, _ARRAYS, _RAW = (".csv", ".txt"), (".png", ".tif", ".tiff"), (".npy",), (".raw", ".bin")
# A kilometre.
_FARTHEST_MM: Final = 1e6
# Of any device's numbers.
_BRIGHTEST: Final = 1e12
_PREFIX: Final = "[profiles] "


@dataclass(frozen=True)
class Profiles:
    """Profiles in the frame of the profiler: x along them, z away from it, y = z × x.

    Attributes:
        path: the TOML file.
        x: mm; NaN where there is no point.
        z: mm; NaN where there is no point.
        intensity: of the light that came back, in numbers of the device; NaN for none; None where it is not known.
        positions: of each axis at each profile, motor steps.
        motion: how the object moves, in this frame.
        sigma_mm: standard deviation of z, where it is given.
        name: what was scanned, or "".
    """

    path: Path
    x: Float[np.ndarray, "profiles points"]
    z: Float[np.ndarray, "profiles points"]
    intensity: Float[np.ndarray, "profiles points"] | None
    positions: Positions
    motion: Motion
    sigma_mm: float | None
    name: str


def read_profiles(path: str | os.PathLike[str]) -> Profiles:
    """Read and check profiles, given their folder or its `profiles.toml`.

    Raises:
        InputError: whatever is wrong: file, key, value, and how to fix it.
    """
    outer = read_listing(Path(path), PROFILES_FILE, ("profiles", "motion"))
    table = outer.table("profiles", _PREFIX).only(
        "files", "units", "z", "standoff_mm", "columns", "invalid", "pixel_format", "width", "a", "c", "sigma_mm",
        "steps", "steps_per_frame", "axes", "name",
    )  # fmt: skip
    scale = UNITS_MM[table.string("units", choices=tuple(UNITS_MM))]
    standoff = _standoff(table)
    unknown: list[str] = []
    tables = part_tables(outer, "motion", "axes")
    if not tables:
        raise outer.error(
            "motion", "is missing: add [[motion]] with axis, kind and per_step, as docs/profiles.md shows"
        )
    with float64():
        motion = as_numpy(read_motion(tables, unknown))
    if unknown:
        raise InputError(f"{outer.path}: {unknown[0]}: unknown key; an axis has axis, kind and the numbers of its kind")
    sigma = table.number("sigma_mm") if "sigma_mm" in table else None
    if sigma is not None and sigma <= 0:
        raise table.error("sigma_mm", "must be more than 0: the standard deviation of a distance, mm")
    x, z, intensity = _numbers(table)
    x, z = scale * x, scale * z
    z = standoff - z if standoff is not None else z
    none = ~(np.isfinite(x) & np.isfinite(z))
    if none.all():
        raise table.error("files", f"none of {none.size} points is valid: check invalid, scale and offset")
    x, z = np.where(none, np.nan, x), np.where(none, np.nan, z)
    farthest = max(np.abs(x[~none]).max(), np.abs(z[~none]).max())
    if farthest > _FARTHEST_MM:
        raise InputError(
            f"{table.path}: a point lies {farthest:.3g} mm away, and no profiler sees so far: check units, invalid, "
            "scale and offset"
        )
    if (z[~none] <= 0).any():
        raise InputError(
            f"{table.path}: a point lies {z[~none].min():.4g} mm before the profiler: z is the distance from it, "
            'or with z = "height" the way to it, and standoff_mm is where its height is 0'
        )
    if intensity is not None and np.nanmax(np.abs(intensity), initial=0.0) > _BRIGHTEST:
        raise InputError(f"{table.path}: an intensity is more than {_BRIGHTEST:g}: check which column is the intensity")
    positions, _ = read_axes(table, len(x), "profiles")
    known = [part.axis for part in motion.parts()]
    for axis, steps in positions.items():
        if axis not in known and len(set(steps)) > 1:
            raise outer.error("motion", f"has no axis {axis}, which moves; its axes are {', '.join(known)}")
    if not any(len(set(steps)) > 1 for steps in positions.values()):
        raise InputError(f"{table.path}: no axis moves from one profile to the next: give steps or steps_per_frame")
    name = table.string("name") if "name" in table else ""
    return Profiles(table.path, x, z, intensity, positions, motion, sigma, name)


def _standoff(table: Table) -> float | None:
    """Where the height is 0, mm; None for a z that is a distance."""
    if table.string("z", "distance", ("distance", "height")) == "distance":
        if "standoff_mm" in table:
            raise table.error("standoff_mm", 'is for z = "height": leave it out, or say that z is a height')
        return None
    if "standoff_mm" not in table:
        raise table.error("standoff_mm", "is missing: add the distance from the profiler at which the height is 0, mm")
    return table.number("standoff_mm")


def _numbers(
    table: Table,
) -> tuple[
    Float[np.ndarray, "profiles points"],
    Float[np.ndarray, "profiles points"],
    Float[np.ndarray, "profiles points"] | None,
]:
    """X, z and intensity in the file's unit, NaN where a point is not valid."""
    files = files_of(table, "files")
    if not files:
        raise table.error("files", "names none: give the CSV files or the range map")
    endings = {file.suffix.lower() for file in files}
    if not endings <= set((*_CSV, *_MAPS, *_ARRAYS, *_RAW)):
        raise table.error(
            "files", f"cannot read {', '.join(sorted(endings))}: give .csv, .txt, .png, .tif, .npy, .raw or .bin"
        )
    if endings <= set(_CSV):
        _only_for(table, ("pixel_format", "width", "c"), "range maps, and these are CSV")
        x, z, intensity = read_profiles_csv(table, files)
        if x is None:
            return _along(table, z.shape), z, None
        _only_for(table, ("a",), "files without a header, and these have x")
        return x, z, intensity
    if len(files) != 1:
        raise table.error("files", f"{len(files)} files: give one range map with a row for each profile, or CSV files")
    _only_for(table, ("columns",), "CSV, and this is a range map")
    values = _map(table, files[0])
    c = values[..., -1]
    invalid = _invalid(table, c.dtype)
    z = np.where(np.isin(c, invalid), np.nan, _coordinate(table, "c", c))
    return _coordinate(table, "a", values[..., 0]) if values.shape[2] == 2 else _along(table, c.shape), z, None


def _map(table: Table, file: Path) -> Shaped[np.ndarray, "profiles points numbers"]:
    """The numbers of a range map, one or two for each pixel."""
    ending, wanted = file.suffix.lower(), table.values.get("pixel_format")
    if wanted is not None:
        table.string("pixel_format", choices=tuple(_FORMATS))
    if ending in _RAW:
        count, dtype = _FORMATS[table.string("pixel_format", choices=tuple(_FORMATS))]
        width, size = table.whole("width"), file.stat().st_size
        if width < 1:
            raise table.error("width", "must be the number of points of a profile, 1 or more")
        row = width * count * dtype.itemsize
        if size == 0 or size % row:
            raise table.error(
                "width",
                f"{file.name} has {size} bytes, which are no whole number of profiles of {row} bytes ({width} points "
                f"of {wanted}): correct width or pixel_format",
            )
        return np.fromfile(file, dtype).reshape(-1, width, count)
    _only_for(table, ("width",), "raw buffers")
    values = _array(file) if ending in _ARRAYS else read_image(file)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or values.shape[2] > 2 or not values.size or values.dtype.kind not in "iuf":
        raise InputError(
            f"{file}: has the shape {values.shape} of {values.dtype}, and a range map has (profiles, points) of z, or "
            "(profiles, points, 2) of x and z, whole numbers or floats"
        )
    if values.dtype == np.uint8:
        raise InputError(f"{file}: has 8 bits, which is a picture of a range map: export it with 16 bits or as float32")
    if wanted is not None and (values.shape[2], values.dtype.itemsize, values.dtype.kind) != (
        _FORMATS[wanted][0],
        _FORMATS[wanted][1].itemsize,
        _FORMATS[wanted][1].kind,
    ):
        raise table.error(
            "pixel_format", f"{file.name} holds {values.shape[2]} x {values.dtype} for each point: leave it out"
        )
    return values


def _array(file: Path) -> Shaped[np.ndarray, "*shape"]:
    with file.open("rb") as content:
        header = read_npy_header(str(file), content)
        return read_npy(str(file), content, header, file.stat().st_size - content.tell())


def _invalid(table: Table, dtype: np.dtype) -> list[float]:
    """Numbers that stand for no point: by default what devices write, 0, or the least of a signed format."""
    if "invalid" in table:
        return [table.number("invalid")]
    if dtype.kind == "u":
        return [0.0]
    return [float(np.iinfo(dtype).min)] if dtype.kind == "i" else []


def _coordinate(table: Table, key: str, numbers: Shaped[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Numbers of a device as lengths in the file's unit."""
    if key not in table and numbers.dtype.kind == "f":
        return numbers.astype(np.float64)
    scale, offset = _scale(table, key)
    return scale * numbers.astype(np.float64) + offset


def _along(table: Table, shape: tuple[int, int]) -> Float[np.ndarray, "profiles points"]:
    """The x of points that are evenly spaced: the number of a point times the scale, and the offset."""
    scale, offset = _scale(table, "a")
    return np.broadcast_to(scale * np.arange(shape[1]) + offset, shape)


def _scale(table: Table, key: str) -> tuple[float, float]:
    if key not in table:
        what = "x along the profile" if key == "a" else "z"
        raise table.error(
            key,
            f"is missing: add [profiles.{key}] with scale and offset of {what}, the device's Scan3dCoordinateScale and "
            f"Scan3dCoordinateOffset of coordinate {key.upper()}",
        )
    one = table.table(key, f"[profiles.{key}] ").only("scale", "offset")
    if (scale := one.number("scale")) == 0:
        raise one.error("scale", "must not be 0: the length of one step of the numbers")
    return scale, one.number("offset") if "offset" in one else 0.0


def _only_for(table: Table, keys: tuple[str, ...], what: str) -> None:
    for key in keys:
        if key in table:
            raise table.error(key, f"is for {what}: leave it out")
