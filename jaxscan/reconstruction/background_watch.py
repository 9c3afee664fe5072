"""Whether each photograph's own laser-off photograph shows the same place, or the one before or behind it does.

Let F be a photograph, B its laser-off photograph and C that of a neighbour. Away from the stripe F = B + t (C − B) has

    t = Σ (C − B)(F − B) / Σ (C − B)²:

0 where B is of the same place, and 1 where C is. Where nothing moves C − B is noise alone, and t is ½, for both are as
near. What is in proportion to B is taken out of both first: lamps grow brighter and dimmer.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.files.scan import Scan
from jaxscan.images.decode import Image
from jaxscan.reconstruction.frames import Frames

# Pixels that are compared, about. What is brighter than without the laser by this part of a photograph's brightest
# pixel is left out: the stripe, and its light that other surfaces reflect.
_PIXELS: Final = 40_000
_LIT: Final = 0.05
# The neighbour fits clearly better from here on.
_CLEARLY: Final = 0.75
# It does so in this number of photographs at the least, and in this part of them: a photograph may be missing in the
# middle of the list.
_FEWEST, _PART = 5, 0.25

_Pixels = Float[np.ndarray, "pixels"]


class _Seen(NamedTuple):
    """A photograph and its laser-off photograph, a part of their pixels."""

    lit: _Pixels
    off: _Pixels


class BackgroundWatch:
    """Looks on while the photographs of a scan that has a laser-off photograph for each are read, in their order."""

    def __init__(self, scan: Scan) -> None:
        self._scan = scan
        self._watches = len(scan.backgrounds) > 1
        self._last: list[_Seen] = []
        # Of each photograph but the first and last, t for the one before and the one behind; NaN where they are alike.
        self._t: list[tuple[float, float]] = []

    def see(self, frames: Frames) -> None:
        """The next photographs."""
        if self._watches and frames.backgrounds is not None:
            for lit, off in zip(frames.photographs, frames.backgrounds, strict=False):
                self._see_one(_Seen(_some_pixels(lit), _some_pixels(off)))

    def _see_one(self, seen: _Seen) -> None:
        self._last = [*self._last[-2:], seen]
        if len(self._last) == 3:
            before, own, behind = self._last
            self._t.append((_goes_with(own, before.off), _goes_with(own, behind.off)))

    def notes(self) -> list[str]:
        """What is said of laser-off photographs that belong to a neighbour."""
        t = np.array(self._t).reshape(-1, 2)
        known = int(np.isfinite(t).all(axis=1).sum())
        better = t > _CLEARLY
        side = int(better.sum(axis=0).argmax())
        count = int(better[:, side].sum())
        if count < max(_FEWEST, _PART * known):
            return []
        # One from the middle: at the ends of a full turn its other end may stand beside it.
        one = 1 + int(np.flatnonzero(better[:, side])[count // 2])
        frames, off = self._scan.frames, self._scan.backgrounds
        name = frames[one].name if frames else f"frame {one}"
        which = "before" if side == 0 else "behind"
        other = off[one + 2 * side - 1].name
        return [
            f"the laser-off photographs seem to be shifted by one: {name} goes better with {other} than with its own, "
            f"{off[one].name}, and so do {count / known:.0%} of the photographs with the one {which} their own: "
            "begin frames and background at the same place, and see whether one is missing or too many"
        ]


def _some_pixels(image: Image) -> _Pixels:
    every = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / _PIXELS)))
    return image[::every, ::every].astype(np.float32).ravel()


def _goes_with(own: _Seen, other: _Pixels) -> float:
    """By the laser-off photograph of another place, t of a photograph; NaN where the two are the same."""
    lit = own.lit - np.maximum(own.off, other) > _LIT * own.lit.max(initial=0.0)
    F, B, C = own.lit[~lit], own.off[~lit], other[~lit]
    apart, off = C - B, F - B
    total = float(B @ B)
    if total > 0:
        apart, off = (each - float(each @ B) / total * B for each in (apart, off))
    squares = float(apart @ apart)
    return float(apart @ off) / squares if squares > 0 else np.nan
