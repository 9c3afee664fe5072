"""The organised range image as an NPZ file: one point for each frame and each image column (or row)."""

import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Final

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.npy import NpyHeader, read_npz

_ALWAYS: Final = {
    "points": np.dtype(np.float32),
    "strength": np.dtype(np.float32),
    "sigma": np.dtype(np.float32),
    "valid": np.dtype(np.bool_),
    "steps": np.dtype(np.int64),
}
_WHERE_KNOWN: Final = {
    "pixels": np.dtype(np.float32),
    "sigma_pixel": np.dtype(np.float32),
    "light": np.dtype(np.float32),
    "colours": np.dtype(np.uint8),
    "albedo": np.dtype(np.float32),
    "positions": np.dtype(np.int64),
    "scanner": np.dtype(np.uint8),
    "per_step": np.dtype(np.float64),
}
_DTYPES: Final = _ALWAYS | _WHERE_KNOWN
_NOTES: Final = "notes"
_READ: Final = _DTYPES | {_NOTES: np.dtype(np.uint8)}
# What has no entry for each frame.
_OF_THE_SCAN: Final = ("scanner", "per_step")
_COPIED_AT_ONCE: Final = 1 << 20


@dataclass(frozen=True)
class RangeArrays:
    """A range image as plain arrays.

    Attributes:
        points: object frame, mm; NaN for none.
        strength: of the stripe, in grey levels.
        sigma: standard deviation of each point along its ray, mm; NaN where it is not known.
        valid: where there is a point.
        steps: motor step count of each frame.
        pixels: where the stripe was seen, in rows (or columns) of the photograph, where the file says so.
        sigma_pixel: the pixel's part of sigma, mm, where the file has it.
        positions: motor steps of each axis at each frame, where the file has them.
        scanner: the axes' names, the motion and the light, JSON in UTF-8 (`range_scanner`), where the file has them.
        per_step: in older files, how far what stands on the stage moves for one step, object frame, mm.
        light: read noise, gain, speckle contrast and saturation of each frame, where the file has them.
        colours: red, green and blue of each point, 0, 0, 0 for none, where the file has them.
        albedo: relative, NaN for none, where the file has it.
        notes: what the photographs have shown to be wrong in the scan or its settings; JSON in UTF-8 in the file.
    """

    points: Float32[np.ndarray, "frames columns 3"]
    strength: Float32[np.ndarray, "frames columns"]
    sigma: Float32[np.ndarray, "frames columns"]
    valid: Bool[np.ndarray, "frames columns"]
    steps: Int64[np.ndarray, "frames"]
    pixels: Float32[np.ndarray, "frames columns"] | None = None
    sigma_pixel: Float32[np.ndarray, "frames columns"] | None = None
    positions: Int64[np.ndarray, "frames axes"] | None = None
    scanner: UInt8[np.ndarray, "bytes"] | None = None
    per_step: Float64[np.ndarray, "3"] | None = None
    light: Float32[np.ndarray, "frames 4"] | None = None
    colours: UInt8[np.ndarray, "frames columns 3"] | None = None
    albedo: Float32[np.ndarray, "frames columns"] | None = None
    notes: tuple[str, ...] = ()


def write_range_npz(path: str | os.PathLike[str], image: RangeArrays) -> None:
    """Write a range image, whole or not at all.

    Raises:
        InputError: the arrays do not fit one another, or the file cannot be written.
    """
    with writing_range_npz(path) as add:
        add(image)


@contextmanager
def writing_range_npz(
    path: str | os.PathLike[str], notes: Callable[[], Sequence[str]] = tuple
) -> Iterator[Callable[[RangeArrays], None]]:
    """Write a range image whose frames come some at a time, whole or not at all: the block is given what adds them.

    Each array waits in a file of its own beside `path` until its length is known.

    Args:
        path: the file.
        notes: asked once all frames have come: what is noted beside what they bring.

    Raises:
        InputError: the arrays do not fit one another, or the file cannot be written.
    """
    folder = os.path.dirname(os.path.realpath(path))
    shapes: dict[str, tuple[int, ...]] = {}
    noted: dict[str, None] = {}
    with replacing(path, "wb") as file, ExitStack() as stack:
        parts: dict[str, IO[bytes]] = {}

        def add(image: RangeArrays) -> None:
            arrays = {
                name: np.ascontiguousarray(value, dtype=dtype)
                for name, dtype in _DTYPES.items()
                if (value := getattr(image, name)) is not None
            }
            _check(path, arrays)
            noted.update(dict.fromkeys(image.notes))
            for name in arrays if not parts else ():
                parts[name] = stack.enter_context(TemporaryFile(dir=folder))
            if arrays.keys() != parts.keys():
                raise InputError(f"{path}: frames with {sorted(arrays)} cannot follow frames with {sorted(parts)}")
            for name, array in arrays.items():
                frames, *rest = shapes.get(name, (0, *array.shape[1:]))
                if tuple(rest) != array.shape[1:]:
                    raise InputError(f"{path}: {array.shape[1]} columns cannot follow {rest[0]}: they are two scans")
                if name in _OF_THE_SCAN:
                    # It is the same for all frames.
                    parts[name].seek(0)
                    frames = 0
                shapes[name] = (frames + len(array), *rest)
                parts[name].write(array.data)

        yield add
        with zipfile.ZipFile(file, "w") as archive:
            for name, part in parts.items():
                header = {"descr": _DTYPES[name].str, "fortran_order": False, "shape": shapes[name]}
                # Of no date, so that the same points are the same bytes.
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as entry:
                    np.lib.format.write_array_header_1_0(entry, header)
                    part.seek(0)
                    shutil.copyfileobj(part, entry, _COPIED_AT_ONCE)
            noted.update(dict.fromkeys(notes()))
            if noted:
                with archive.open(zipfile.ZipInfo(f"{_NOTES}.npy"), "w") as entry:
                    np.lib.format.write_array(entry, as_json(list(noted)))


def read_range_npz(path: str | os.PathLike[str]) -> RangeArrays:
    """Read and check a range image.

    Raises:
        InputError: the file is missing, is no range image, or its arrays do not fit one another.
    """
    path = Path(path)

    def check(headers: Mapping[str, NpyHeader]) -> None:
        missing = [name for name in _ALWAYS if name not in headers]
        if missing:
            raise InputError(
                f'{path}: has no array "{missing[0]}", so it is not a range image: '
                "name one that `jaxscan reconstruct` has written"
            )
        for name, header in headers.items():
            if header.dtype != _READ[name]:
                raise InputError(f'{path}: "{name}" is {header.dtype}, {_READ[name]} is expected: reconstruct again')
        _check_shapes(path, {name: header.shape for name, header in headers.items()})

    arrays = read_npz(path, lambda name: name in _READ, check)
    notes = _read_notes(path, arrays.pop(_NOTES, None))
    _check_points(path, arrays)
    return RangeArrays(**arrays, notes=notes)


def as_json(values: Any) -> UInt8[np.ndarray, "bytes"]:
    """Values as the file has those that are no numbers: JSON in UTF-8."""
    return np.frombuffer(json.dumps(values, ensure_ascii=False).encode(), np.uint8)


def from_json(path: str | os.PathLike[str], name: str, encoded: UInt8[np.ndarray, "bytes"]) -> Any:
    """The inverse of `as_json`, for an array of a name.

    Raises:
        InputError: it is no JSON.
    """
    try:
        return json.loads(encoded.tobytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f'{path}: "{name}" is no JSON ({error}): reconstruct again') from error


def _read_notes(path: Path, encoded: UInt8[np.ndarray, "bytes"] | None) -> tuple[str, ...]:
    notes = [] if encoded is None else from_json(path, _NOTES, encoded)
    if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
        raise InputError(f'{path}: "{_NOTES}" is no list of sentences: reconstruct again')
    return tuple(notes)


def _check(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    _check_shapes(path, {name: array.shape for name, array in arrays.items()})
    _check_points(path, arrays)


def _check_shapes(path: str | os.PathLike[str], shapes: Mapping[str, tuple[int, ...]]) -> None:
    shape = shapes["valid"]
    expected = {"points": (*shape, 3), "strength": shape, "sigma": shape, "valid": shape, "steps": shape[:1]}
    expected |= {"pixels": shape, "sigma_pixel": shape, "per_step": (3,), "light": (*shape[:1], 4)}
    expected |= {"colours": (*shape, 3), "albedo": shape}
    # As many axes as they are, and as many letters.
    expected |= {"positions": (*shape[:1], *(shapes.get("positions", ())[1:2] or (0,)))}
    expected |= {name: shapes.get(name, ())[:1] or (0,) for name in ("scanner", _NOTES)}
    for name, own in shapes.items():
        if len(shape) != 2 or own != expected[name]:
            raise InputError(
                f'{path}: "{name}" has the shape {own}, beside "valid" of shape {shape}: '
                "valid is (frames, columns), and the others go with it"
            )


def _check_points(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    if not np.isfinite(arrays["points"][arrays["valid"]]).all():
        raise InputError(f"{path}: a valid point has a coordinate that is not a finite number: reconstruct again")
