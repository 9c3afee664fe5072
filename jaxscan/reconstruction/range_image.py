"""The range image: one point for each frame and each image column (or row), organised as the scanner saw them."""

import os
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.files.cloud import Cloud, check_ending, write_ply
from jaxscan.files.range_npz import RangeArrays, write_range_npz


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
    """

    points: Float[np.ndarray, "frames columns 3"]
    pixels: Float[np.ndarray, "frames columns"]
    strength: Float[np.ndarray, "frames columns"]
    sigma: Float[np.ndarray, "frames columns"]
    sigma_pixel: Float[np.ndarray, "frames columns"]
    valid: Bool[np.ndarray, "frames columns"]
    steps: Int[np.ndarray, "frames"]

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
        return RangeArrays(self.points, self.strength, self.sigma, self.valid, self.steps)


def write_points(path: str | os.PathLike[str], image: RangeImage) -> None:
    """Write the valid points as .ply, or the whole range image as .npz, by the path's ending.

    Raises:
        InputError: another ending, no points, or the file cannot be written.
    """
    if check_ending(path) == ".ply":
        write_ply(path, image.cloud())
    else:
        write_range_npz(path, image.arrays())
