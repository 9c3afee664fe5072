"""The range image: one point for each frame and each image column (or row), organised as the scanner saw them."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud, check_ending, writing_ply
from jaxscan.files.range_npz import RangeArrays, read_range_npz, writing_range_npz


@dataclass(frozen=True)
class RangeImage:
    """Points in the object frame, with what is known of each.

    Attributes:
        points: mm, object frame; NaN for none.
        pixels: where the stripe was seen: v for each image column, or u for each row; NaN for none.
        strength: of the stripe above its surroundings, grey levels of its response.
        sigma: standard deviation along the ray, rig and pixel together, mm; NaN where it is not known.
        sigma_pixel: the pixel's part of it, mm.
        valid: where there is a point.
        steps: motor step count of each frame.
        per_step: how far whatever stands on the stage moves for one step, mm, where it is known: the camera saw frame n
            from −steps[n] · per_step.
        light: read noise, gain, speckle contrast and saturation of each frame (`images.light`), where they are known.
    """

    points: Float[np.ndarray, "frames columns 3"]
    pixels: Float[np.ndarray, "frames columns"]
    strength: Float[np.ndarray, "frames columns"]
    sigma: Float[np.ndarray, "frames columns"]
    sigma_pixel: Float[np.ndarray, "frames columns"]
    valid: Bool[np.ndarray, "frames columns"]
    steps: Int[np.ndarray, "frames"]
    per_step: Float[np.ndarray, "3"] | None = None
    light: Float[np.ndarray, "frames 4"] | None = None

    @classmethod
    def of(cls, arrays: RangeArrays) -> "RangeImage":
        """A range image from what a file holds; what it does not hold is NaN."""
        shape = arrays.valid.shape
        return cls(
            points=arrays.points,
            pixels=np.full(shape, np.nan, np.float32) if arrays.pixels is None else arrays.pixels,
            strength=arrays.strength,
            sigma=arrays.sigma,
            sigma_pixel=np.full(shape, np.nan, np.float32) if arrays.sigma_pixel is None else arrays.sigma_pixel,
            valid=arrays.valid,
            steps=arrays.steps,
            per_step=arrays.per_step,
            light=arrays.light,
        )

    @classmethod
    def joined(cls, parts: Sequence["RangeImage"]) -> "RangeImage":
        """The frames of several range images of one scan, one after the other."""
        if len(parts) == 1:
            return parts[0]
        known = [f.name for f in fields(cls) if f.name != "per_step" and getattr(parts[0], f.name) is not None]
        arrays = {name: np.concatenate([getattr(p, name) for p in parts]) for name in known}
        return cls(**arrays, per_step=parts[0].per_step)

    def where(self, keep: Bool[np.ndarray, "frames columns"]) -> "RangeImage":
        """The same grid with those points alone for which `keep` holds."""
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
            steps=self.steps[place[0]],
            light=None if self.light is None else self.light[place[0]],
        )

    def cameras(self) -> Float[np.ndarray, "frames 3"]:
        """Where the camera was at each frame, object frame, mm; the origin where the stage's motion is not known."""
        per_step = np.zeros(3) if self.per_step is None else np.asarray(self.per_step, np.float64)
        return -self.steps[:, None].astype(np.float64) * per_step

    def cloud(self) -> Cloud:
        """The valid points, frame after frame."""
        known = bool(np.isfinite(self.sigma[self.valid]).any())
        return Cloud(
            points=self.points[self.valid],
            sigma=self.sigma[self.valid] if known else None,
            sigma_pixel=self.sigma_pixel[self.valid] if known else None,
        )

    def arrays(self) -> RangeArrays:
        """As the file format has it."""
        return RangeArrays(
            points=self.points,
            strength=self.strength,
            sigma=self.sigma,
            valid=self.valid,
            steps=self.steps,
            pixels=self.pixels,
            sigma_pixel=self.sigma_pixel,
            per_step=None if self.per_step is None else np.asarray(self.per_step, np.float64),
            light=self.light,
        )


def read_range_image(path: str | os.PathLike[str]) -> RangeImage:
    """Read a range image from its NPZ file.

    Raises:
        InputError: the file is missing or is no range image.
    """
    return RangeImage.of(read_range_npz(path))


def write_points(path: str | os.PathLike[str], image: RangeImage) -> None:
    """Write the valid points as .ply, or the whole range image as .npz, by the path's ending.

    Raises:
        InputError: another ending, no points, or the file cannot be written.
    """
    with writing_points(path) as add:
        add(image)


@contextmanager
def writing_points(path: str | os.PathLike[str]) -> Iterator[Callable[[RangeImage], None]]:
    """Write a range image that comes some frames at a time, as `write_points`: the block is given what adds them."""
    if check_ending(path) == ".ply":
        with writing_ply(path) as add_cloud:
            yield lambda image: add_cloud(image.cloud())
    else:
        with writing_range_npz(path) as add_arrays:
            yield lambda image: add_arrays(image.arrays())
