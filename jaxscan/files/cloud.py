"""Points as a PLY file: binary, little endian, `float x y z`, then what is known of each point."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt8

from jaxscan.errors import InputError
from jaxscan.files.ply import Column, Element, Ply
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.ply_write import writing_ply_file

COLOURS: Final = ("red", "green", "blue")
# What else may be known of a point, by the names that a PLY file has for it.
NUMBERS: Final = ("sigma", "sigma_pixel", "strength", "albedo")
# Points can be written to these: clouds, and the organised range image.
_WRITTEN: Final = (".ply", ".npz", ".xyz", ".pcd", ".e57", ".laz", ".las")
# Ten thousand kilometres: vertices in one place are found on a grid of whole numbers, which ends at nine times this.
_FARTHEST_MM: Final = 1e10
_NEEDS_SURFACE: Final = (".stl", ".obj", ".glb", ".gltf", ".off", ".3mf")
# The grey level of a point without a colour, where it must have one to be shown.
_NO_COLOUR: Final = 128


@dataclass(frozen=True)
class Cloud:
    """Points in the object frame.

    Attributes:
        points: mm.
        sigma: standard deviation along the ray, rig and pixel together (mm), where it is known.
        sigma_pixel: the pixel's part of it (mm), where it is known.
        colours: red, green, blue, where they are known of the cloud; 0, 0, 0 for a point without one.
        strength: of the stripe above its surroundings, grey levels, where it is known.
        albedo: relative, the median of the scan is 1 (`surface.albedo`), where it is known; NaN for a point without.
    """

    points: Float32[np.ndarray, "points 3"]
    sigma: Float32[np.ndarray, "points"] | None = None
    sigma_pixel: Float32[np.ndarray, "points"] | None = None
    colours: UInt8[np.ndarray, "points 3"] | None = None
    strength: Float32[np.ndarray, "points"] | None = None
    albedo: Float32[np.ndarray, "points"] | None = None


def check_ending(path: str | os.PathLike[str]) -> str:
    """The ending of a file that points can be written to: a cloud's, or ".npz" (an organised range image).

    Raises:
        InputError: another ending.
    """
    ending = Path(path).suffix.lower()
    if ending in _NEEDS_SURFACE:
        raise InputError(f"{path}: {ending} holds a surface, and these are points without one: write .ply or .npz")
    if ending not in _WRITTEN:
        others = ", ".join(_WRITTEN[2:])
        raise InputError(
            f'{path}: the ending "{ending}" is not known: write .ply (a cloud) or .npz (a range image); or {others}'
        )
    return ending


def write_ply(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write a cloud, whole or not at all.

    Raises:
        InputError: there are no points, a coordinate is not finite, or the file cannot be written.
    """
    with writing_ply(path) as add:
        add(cloud)


@contextmanager
def writing_ply(path: str | os.PathLike[str]) -> Iterator[Callable[[Cloud], None]]:
    """Write a cloud whose points come some at a time, whole or not at all: the block is given what adds them.

    Raises:
        InputError: there were no points, a coordinate is not finite, or the file cannot be written.
    """
    with (
        writing_ply_file(path, "vertex", ("comment units mm",)) as add_rows,
        adding_points(path, lambda cloud: add_rows(vertices_of(cloud))) as add,
    ):
        yield add


@contextmanager
def adding_points(path: str | os.PathLike[str], write: Callable[[Cloud], None]) -> Iterator[Callable[[Cloud], None]]:
    """Points on their way to a file of any format: the block is given what writes some of them, if there are any.

    Raises:
        InputError: there were no points at the end of the block, or a coordinate is not finite.
    """
    points = 0

    def add(cloud: Cloud) -> None:
        nonlocal points
        if not np.isfinite(cloud.points).all():
            raise InputError(f"{path}: a point has a coordinate that is not a finite number: leave missing points out")
        if len(cloud.points):
            points += len(cloud.points)
            write(cloud)

    yield add
    if not points:
        raise InputError(f"{path}: there are no points to write: check that the photographs show the stripe")


def vertices_of(cloud: Cloud) -> Element:
    """The points, and what is known of each, as an element of a PLY file."""
    columns: dict[str, Column] = dict(zip("xyz", cloud.points.T, strict=True))
    columns |= {name: known for name in NUMBERS if (known := getattr(cloud, name)) is not None}
    if cloud.colours is not None:
        columns |= dict(zip(COLOURS, cloud.colours.T, strict=True))
    return Element(len(cloud.points), columns)


def read_ply(path: str | os.PathLike[str]) -> Cloud:
    """Read the points of a PLY file, whatever else it holds.

    Raises:
        InputError: the file is missing, is not a PLY, is cut short, holds no points, or a coordinate is not finite.
    """
    return cloud_of(path, read_ply_file(path))


def cloud_of(path: str | os.PathLike[str], content: Ply) -> Cloud:
    """The points of what was read from a PLY file.

    Raises:
        InputError: there are none, or a coordinate is not finite.
    """
    vertex = content.elements.get("vertex", Element(0))
    numbers = {name: column for name, column in vertex.columns.items() if isinstance(column, np.ndarray)}
    if not vertex.count or not set("xyz") <= set(numbers):
        raise InputError(f"{path}: holds no points: check which file it is")
    points = _as_float32(np.stack([numbers[axis] for axis in "xyz"], axis=-1))
    check_points(path, points, "points", "leave them out")

    def known(name: str) -> Float32[np.ndarray, "points"] | None:
        return _as_float32(numbers[name]) if name in numbers else None

    coloured = all(name in numbers and numbers[name].dtype == np.uint8 for name in COLOURS)
    return Cloud(
        points=points,
        sigma=known("sigma"),
        sigma_pixel=known("sigma_pixel"),
        colours=np.stack([numbers[name] for name in COLOURS], axis=-1) if coloured else None,
        strength=known("strength"),
        albedo=known("albedo"),
    )


def shown_colours(colours: UInt8[np.ndarray, "points 3"]) -> UInt8[np.ndarray, "points 3"]:
    """The same with grey in place of 0, 0, 0, for points without a colour: as bright as the others in the median."""
    known = np.any(colours, axis=1)
    grey = np.median(colours[known].mean(axis=1)) if known.any() else _NO_COLOUR
    return np.where(known[:, None], colours, np.uint8(round(float(grey))))


def check_points(path: str | os.PathLike[str], points: Float[np.ndarray, "points 3"], what: str, fix: str) -> None:
    """Refuse coordinates that are not finite, or so large that what is computed with them overflows.

    Raises:
        InputError: there is one.
    """
    bad = int((~(np.abs(points) <= _FARTHEST_MM).all(axis=1)).sum())
    if bad:
        raise InputError(
            f"{path}: {bad} of {len(points)} {what} have a coordinate that is not a finite number of at most "
            f"{_FARTHEST_MM:g}: {fix}"
        )


def _as_float32(values: Shaped[np.ndarray, "*any"]) -> Float32[np.ndarray, "*any"]:
    """What no float32 holds is infinite, and a signalling NaN a quiet one, without a word."""
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32, copy=False)
