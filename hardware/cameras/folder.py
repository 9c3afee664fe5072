"""Photographs that were taken before, instead of a camera."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt

from hardware.errors import CameraError
from hardware.frame import Frame, in_words

# Reads a photograph; raises `CameraError` where it is none.
Reader = Callable[[Path], UInt[np.ndarray, "rows columns *rgb"]]


class FolderCamera:
    """Photographs from files.

    Args:
        paths: in their order.
        read: reads one of them, as `hardware.devices.read_photograph` does.
        positions: of each, by which it is chosen; without them, or asked for none, each is the next.
    """

    def __init__(self, paths: Sequence[Path], read: Reader, positions: Sequence[Mapping[str, int]] | None = None):
        self._paths, self._read = tuple(paths), read
        places = None if positions is None else [frozenset(place.items()) for place in positions]
        self._by_place = None if places is None else dict(zip(places, paths, strict=True))
        self._next = 0
        self._exposure_s = 1 / 30

    def open(self) -> None:
        """See that there are any.

        Raises:
            CameraError: there are none.
        """
        if not self._paths:
            raise CameraError("the folder camera has no photographs: name a folder with PNG or JPEG files")

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """They were exposed long ago."""
        self._exposure_s = exposure_s

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """The next photograph, or that of these positions.

        Raises:
            CameraError: there is none, or it cannot be read.
        """
        if self._by_place is None or not positions:
            path = self._paths[self._next] if self._next < len(self._paths) else None
            self._next += 1
        else:
            path = self._by_place.get(frozenset(positions.items()))
        if path is None:
            raise CameraError(
                f"the folder camera has no photograph for {in_words(positions)}, and {len(self._paths)} in all"
            )
        return Frame(self._read(path), positions, time.time(), self._exposure_s)

    def close(self) -> None:
        """Nothing to do."""
