"""Photographs that are the same to the last bit as the one before them: the noise of a sensor never repeats.

Without noise two photographs of a surface that is even along its way may be equal. So a repeated one is pointed out
only where the others show noise: between two of them something differs in nearly every row.
"""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import UInt

from jaxscan.images.decode import Image

# One row in this number is compared.
_EVERY: Final = 16
# A row of one level shows no noise, as where a camera cuts off what is dark: two photographs are compared where at
# least this part of their rows have several. Noise shows where this part of these differs.
_LIVE, _NOISY = 0.5, 0.9
# A note names this number of photographs.
_NAMED: Final = 3


class RepeatWatch:
    """Looks on while photographs are read, in their order."""

    def __init__(self) -> None:
        self._before: Image | None = None
        self._count = 0
        self._noise: list[bool] = []
        self._repeated: list[int] = []

    def see(self, images: UInt[np.ndarray, "frames rows columns *rgb"]) -> None:
        """The next photographs."""
        for image in images:
            if self._before is not None:
                self._compare(self._before, image)
            self._before = image
            self._count += 1
        # The buffer is used again.
        self._before = None if self._before is None else self._before.copy()

    def _compare(self, before: Image, image: Image) -> None:
        rows, rows_before = (each[::_EVERY].reshape(len(each[::_EVERY]), -1) for each in (image, before))
        live = (rows != rows[:, :1]).any(axis=1)
        if live.sum() < max(_LIVE * len(rows), 1):
            return
        differs = (rows != rows_before)[live].any(axis=1)
        if differs.any() or not np.array_equal(image, before):
            self._noise.append(bool(differs.mean() > _NOISY))
        else:
            self._repeated.append(self._count)

    def notes(self, frames: tuple[Path, ...]) -> list[str]:
        """What is said of photographs that were repeated.

        Args:
            frames: their files, in the order in which they were seen; none of a video.
        """
        if not self._repeated or 2 * sum(self._noise) <= len(self._noise):
            return []
        names = [path.name for path in frames] or [f"frame {i}" for i in range(self._count)]
        pairs = list(dict.fromkeys(f"{names[i]} is a copy of {names[i - 1]}" for i in self._repeated))
        more = f", and {len(pairs) - _NAMED} more are copies" if len(pairs) > _NAMED else ""
        return [
            f"{', '.join(pairs[:_NAMED])}{more}, to the last bit, which noise never is: the camera or its driver gave "
            "a photograph twice. If it replaces another photograph, leave it and its step out of scan.toml; if it was "
            "inserted, all that follow are one step off: leave it and the last step out, or scan again"
        ]
