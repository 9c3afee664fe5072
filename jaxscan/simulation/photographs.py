"""Photographs of a simulated rig, taken one after the other into a folder."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from jaxscan.errors import InputError
from jaxscan.images import write_image
from jaxscan.images.jpeg import write_jpeg
from jaxscan.rig import Rig
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Scene

JPEG_QUALITY: Final = 95

Advance = Callable[[int], object]


@dataclass(frozen=True)
class Photographer:
    """Takes photographs of a rig, all in the same way.

    Attributes:
        folder: they are written below it.
        rig: the true one.
        seed: of their noise.
        lighting: what lights the scenes.
        sensor: how the light becomes numbers.
        ending: format of the photographs.
        quality: of JPEG.
        advance: called with 1 after every photograph.
    """

    folder: Path
    rig: Rig
    seed: int
    lighting: Lighting
    sensor: Sensor
    ending: str
    quality: int
    advance: Advance

    def shoot(self, name: str, scene: Scene | Sequence[Scene], noise: Sequence[int], **how: Any) -> Path:
        """Take a photograph and write it.

        Args:
            name: of the file in the folder, without its ending.
            scene: what `render` takes.
            noise: numbers that only this photograph has: its noise is its own.
            **how: what else `render` takes: the positions of the axes, and the laser that is on.

        Raises:
            InputError: it cannot be written, or the rig has no such laser or axis.
        """
        seed = (2003, self.seed, *noise)
        image = render(self.rig, scene, lighting=self.lighting, sensor=self.sensor, seed=seed, **how)
        path = self.folder / f"{name}{self.ending}"
        _write(path, image, self.quality)
        self.advance(1)
        return path


def _write(path: Path, image: np.ndarray, quality: int) -> None:
    """Write a photograph, with this quality if it is a JPEG."""
    if path.suffix == ".jpg":
        write_jpeg(path, image, quality)
    else:
        write_image(path, image)


def make_folders(folder: Path, *inner: str) -> None:
    """Make folders."""
    try:
        for name in ("", *inner):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}): choose another folder") from error


def clear_for(listing: str, folder: Path, *inner: str) -> None:
    """Make folders for photographs, and take out the list of those of before: it would not fit what is there.

    Raises:
        InputError: they cannot be made.
    """
    make_folders(folder, *inner)
    (folder / listing).unlink(missing_ok=True)
