"""The range image: one point for each frame and each image column (or row), organised as the scanner saw them."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.axis_details import is_detail
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.files.cloud import Cloud, check_ending
from jaxscan.files.exchange import writing_cloud
from jaxscan.files.range_npz import RangeArrays, read_range_npz, writing_range_npz
from jaxscan.files.range_scanner import read_scanner, scanner_arrays
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.reconstruction.turns import full_turn, gaps_between, sweeps_of
from jaxscan.rig import Fixed, Light, Motion
from jaxscan.rig.light import light_at

_STILL: Final = Fixed()
# Profiles of a turn that are further apart make no surface.
WIDE_APART_DEG: Final = 10.0
# What has an entry for each frame, the positions apart.
_BY_FRAME: Final = (
    "points",
    "pixels",
    "strength",
    "sigma",
    "sigma_pixel",
    "valid",
    "light",
    "colours",
    "albedo",
    "width",
)


@dataclass(frozen=True)
class RangeImage:
    """Points in the object frame, with their pixels, strength and σ.

    Attributes:
        points: mm, object frame; NaN for none.
        pixels: where the stripe was seen: v for each image column, or u for each row; NaN for none.
        strength: of the stripe above its surroundings, grey levels of its response.
        sigma: standard deviation along the ray, rig and pixel together, mm; NaN where it is not known.
        sigma_pixel: the pixel's part of it, mm.
        valid: where there is a point.
        positions: motor steps of each axis at each frame, and the run of one that has play (`rig.run_of`).
        motion: what carried the object, by these positions; `Fixed` where it is not known.
        sheets: the light in which the object was seen; empty where it is not known.
        light: read noise, gain, speckle contrast and saturation of each frame (`images.light`), where they are known.
        colours: red, green and blue of each point without the laser, as photographed, 8 bits; 0, 0, 0 for a point
            without a colour; None where there are none.
        albedo: of each point, relative: the scan's median is 1 (`surface.albedo`); NaN for a point without; None where
            it was not asked for.
        width: of the stripe, full at half its height, px; NaN where a pixel near it was full, so that its strength is
            too low; None where it is not known. It is in no file.
        notes: what the photographs have shown to be wrong in the scan or its settings, a sentence each.
    """

    points: Float[np.ndarray, "frames columns 3"]
    pixels: Float[np.ndarray, "frames columns"]
    strength: Float[np.ndarray, "frames columns"]
    sigma: Float[np.ndarray, "frames columns"]
    sigma_pixel: Float[np.ndarray, "frames columns"]
    valid: Bool[np.ndarray, "frames columns"]
    positions: Mapping[str, Int[np.ndarray, "frames"]]
    motion: Motion = _STILL
    sheets: tuple[Light, ...] = ()
    light: Float[np.ndarray, "frames 4"] | None = None
    colours: UInt8[np.ndarray, "frames columns 3"] | None = None
    albedo: Float[np.ndarray, "frames columns"] | None = None
    width: Float[np.ndarray, "frames columns"] | None = None
    notes: tuple[str, ...] = ()

    @property
    def moving(self) -> tuple[str, ...]:
        """The axes that move at some time."""
        axes = {axis: np.asarray(steps) for axis, steps in self.positions.items() if not is_detail(axis)}
        return tuple(axis for axis, steps in axes.items() if len(set(steps.tolist())) > 1)

    @property
    def leading(self) -> str:
        """The axis that distinguishes frames: of the axes that move, the one that turns, or else the first."""
        turning = [axis for axis in self.moving if full_turn(self.motion, [axis]) is not None]
        return next(iter(turning or self.moving or self.positions))

    @property
    def full_turn(self) -> int | None:
        """Motor steps of a full turn, to the nearest, where the leading axis turns the object; else None."""
        return full_turn(self.motion, [self.leading]) if self.moving else None

    @property
    def steps(self) -> Int[np.ndarray, "frames"]:
        """Motor steps of the leading axis."""
        return np.asarray(self.positions[self.leading])

    def sweeps(self) -> list["RangeImage"]:
        """The scan in pieces along which the same axes move; itself where it is one."""
        if len(self.moving) < 2:
            return [self]
        return [self[some, :] for some in sweeps_of(self.positions)]

    @classmethod
    def of(cls, path: str | os.PathLike[str], arrays: RangeArrays) -> "RangeImage":
        """A range image from what a file holds; what it does not hold is NaN.

        Raises:
            InputError: its scanner is not one.
        """
        shape = arrays.valid.shape
        scanner = read_scanner(path, arrays)
        return cls(
            points=arrays.points,
            pixels=np.full(shape, np.nan, np.float32) if arrays.pixels is None else arrays.pixels,
            strength=arrays.strength,
            sigma=arrays.sigma,
            sigma_pixel=np.full(shape, np.nan, np.float32) if arrays.sigma_pixel is None else arrays.sigma_pixel,
            valid=arrays.valid,
            positions=scanner.positions,
            motion=scanner.motion,
            sheets=scanner.sheets,
            light=arrays.light,
            colours=arrays.colours,
            albedo=arrays.albedo,
            notes=arrays.notes,
        )

    @classmethod
    def joined(cls, parts: Sequence["RangeImage"]) -> "RangeImage":
        """The frames of several range images of one scan, one after the other."""
        if len(parts) == 1:
            return parts[0]
        known = [name for name in _BY_FRAME if getattr(parts[0], name) is not None]
        arrays = {name: np.concatenate([getattr(p, name) for p in parts]) for name in known}
        positions = {axis: np.concatenate([p.positions[axis] for p in parts]) for axis in parts[0].positions}
        notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
        return replace(parts[0], **arrays, positions=positions, notes=notes)

    def where(self, keep: Bool[np.ndarray, "frames columns"]) -> "RangeImage":
        """The same grid with only those points for which `keep` is true."""
        valid = self.valid & keep
        points = np.where(valid[..., None], self.points, np.float32(np.nan))
        return replace(self, points=points, valid=valid)

    def cropped(self, low: Sequence[float], high: Sequence[float]) -> "RangeImage":
        """The points within a box from (x, y, z) to (x, y, z), object frame, mm; the grid is cut to what holds them.

        Raises:
            InputError: there are none.
        """
        with np.errstate(invalid="ignore"):
            inside = self.valid & ((self.points >= low) & (self.points <= high)).all(axis=-1)
        if not inside.any():
            raise InputError(
                f"no point lies in the box from {list(low)} to {list(high)} mm: look at the points' extent"
            )
        rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
        return self.where(inside)[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    def __getitem__(self, place: tuple[slice, slice]) -> "RangeImage":
        """Some frames and columns of the grid: `image[::2, ::4]` is every second frame and every fourth column."""
        return replace(
            self,
            **{name: getattr(self, name)[place] for name in ("points", "pixels", "strength", "sigma", "sigma_pixel")},
            valid=self.valid[place],
            positions={axis: np.asarray(steps)[place[0]] for axis, steps in self.positions.items()},
            light=None if self.light is None else self.light[place[0]],
            colours=None if self.colours is None else self.colours[place],
            albedo=None if self.albedo is None else self.albedo[place],
            width=None if self.width is None else self.width[place],
        )

    def from_camera(self) -> Pose[np.ndarray]:
        """T_object_camera of each frame: where the camera was as the object sees it."""
        pose = as_numpy(self.motion.pose({axis: np.asarray(steps, float) for axis, steps in self.positions.items()}))
        back = pose.inverse()
        shape = (len(self.valid), 3)
        return Pose(np.broadcast_to(back.rotation, shape), np.broadcast_to(back.translation, shape))

    def cameras(self) -> Float[np.ndarray, "frames 3"]:
        """Where the camera was at each frame, object frame, mm; the origin where the motion is not known."""
        return self.from_camera().translation

    def gaps(self) -> Int[np.ndarray, "gaps"]:
        """Motor steps from each frame to the next, full turns left out.

        There is one fewer than frames; as many where one axis alone turned the object all around: the last is from the
        last frame to the first.
        """
        gaps = gaps_between(self.steps, self.full_turn)
        return gaps if len(self.moving) < 2 else gaps[: len(self.valid) - 1]

    def sheets_in_frames(self) -> tuple[Light, ...]:
        """`sheets` where they stood; one that moves as a stack of (frames, 1) lights."""
        q = {axis: np.asarray(steps, np.float64)[:, None] for axis, steps in self.positions.items()}
        return tuple(light_at(sheet, q) for sheet in self.sheets)

    def closed(self) -> "RangeImage":
        """The image with its first frame repeated after the last if the object made a full turn; else unchanged."""
        gaps = self.gaps()
        if len(gaps) < len(self.valid):
            return self
        (axis,) = self.moving
        again = self[:1, :]
        first = {**again.positions, axis: self.steps[-1:] + gaps[-1:]}
        return RangeImage.joined([self, replace(again, positions=first)])

    def travel(self) -> Float[np.ndarray, "3"] | None:
        """The direction in which the object moved, unit, object frame; None where it turned, or none is known."""
        at = self.from_camera()
        way = at.translation[0] - at.translation[-1]
        length = float(np.linalg.norm(way))
        turned = np.abs(at.rotation - at.rotation[0]).max() > 0
        return None if turned or length == 0 else way / length

    def seen(self) -> Float[np.ndarray, "frames columns 3"]:
        """The points in the camera's frame, mm."""
        return self.from_camera().inverse().apply(np.asarray(self.points, np.float64))

    def cloud(self) -> Cloud:
        """The valid points, frame after frame."""
        known = bool(np.isfinite(self.sigma[self.valid]).any())
        bright = bool((self.strength[self.valid] > 0).any())
        return Cloud(
            points=self.points[self.valid],
            sigma=self.sigma[self.valid] if known else None,
            sigma_pixel=self.sigma_pixel[self.valid] if known else None,
            strength=self.strength[self.valid] if bright else None,
            colours=None if self.colours is None else self.colours[self.valid],
            albedo=None if self.albedo is None else self.albedo[self.valid],
        )

    def arrays(self) -> RangeArrays:
        """As the file format has it."""
        positions, scanner = scanner_arrays(self.positions, self.motion, self.sheets)
        return RangeArrays(
            points=self.points,
            strength=self.strength,
            sigma=self.sigma,
            valid=self.valid,
            steps=np.asarray(self.positions.get(STAGE, self.steps)),
            positions=positions,
            scanner=scanner,
            pixels=self.pixels,
            sigma_pixel=self.sigma_pixel,
            light=self.light,
            colours=self.colours,
            albedo=self.albedo,
            notes=self.notes,
        )


def read_range_image(path: str | os.PathLike[str]) -> RangeImage:
    """Read a range image from its NPZ file.

    Raises:
        InputError: the file is missing or is not a range image.
    """
    return RangeImage.of(path, read_range_npz(path))


def write_points(path: str | os.PathLike[str], image: RangeImage) -> None:
    """Write the valid points as .ply or another cloud, or the whole range image as .npz, by the path's ending.

    Raises:
        InputError: another ending, no points, or the file cannot be written.
    """
    with writing_points(path) as add:
        add(image)


@contextmanager
def writing_points(
    path: str | os.PathLike[str], notes: Callable[[], Sequence[str]] = tuple
) -> Iterator[Callable[[RangeImage], None]]:
    """Write a range image that comes some frames at a time, as `write_points`: the block is given what adds them.

    A .npz also has what `notes` returns once they have come.
    """
    if check_ending(path) != ".npz":
        with writing_cloud(path) as add_cloud:
            yield lambda image: add_cloud(image.cloud())
    else:
        with writing_range_npz(path, notes) as add_arrays:
            yield lambda image: add_arrays(image.arrays())
