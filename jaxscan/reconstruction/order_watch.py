"""Whether the photographs of a scan follow one another: a surface that moves on a little shows nearly the same stripe.

Photographs that were copied or sorted into another order have as good stripes as any, and the points of each are right
by themselves; only together they are no surface.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Num

from jaxscan.axis_details import is_detail
from jaxscan.reconstruction.closing import closing_notes
from jaxscan.reconstruction.odd_frames import odd_frame_notes, stripes_apart
from jaxscan.reconstruction.stalled import stalled_notes
from jaxscan.reconstruction.turns import full_turn
from jaxscan.rig import Motion

_Steps = Num[np.ndarray, "frames"]

# Lines of each frame that are remembered.
_LINES: Final = 256
# Pairs of frames that say something.
_FEWEST: Final = 16
# Frames that follow one another differ by this part of what frames far apart do, at the least, if they are in no order:
# in a scan of 20 frames around an object they do by a tenth. Where those far apart hardly differ, px, nothing shows.
_PART, _DIFFER_PX = 0.7, 3.0


class OrderWatch:
    """Watches the stripes of a scan as its frames are measured."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._stripes: list[Float[np.ndarray, "frames some"]] = []
        self._positions: dict[str, list[_Steps]] = {}

    def see(self, stripes: Float[np.ndarray, "frames lines"], positions: Mapping[str, _Steps]) -> None:
        """Some more frames.

        Args:
            stripes: the position of each line's stripe, px; NaN where there is none.
            positions: of each axis, motor steps.
        """
        self._stripes.append(stripes[:, :: max(1, stripes.shape[1] // _LINES)].copy())
        for axis, steps in positions.items():
            if not is_detail(axis):
                self._positions.setdefault(axis, []).append(np.asarray(steps))

    def notes(self, names: Sequence[str] = ()) -> list[str]:
        """What is said of photographs in no order, of single ones, of an axis that stalled, of a turn that is open.

        Order and turn are those of scans that only one axis moves.

        Args:
            names: of the photographs; nothing is said of single ones without.
        """
        if not self._stripes:
            return []
        stripes = np.concatenate(self._stripes)
        positions = {axis: np.concatenate(each) for axis, each in self._positions.items()}
        moving = [axis for axis, each in positions.items() if len(set(each.tolist())) > 1]
        if len(moving) != 1:
            return odd_frame_notes(stripes, names) if len(names) else []
        (axis,) = moving
        order = np.argsort(positions[axis], kind="stable")
        stripes = stripes[order]
        if disorder := self._disorder(stripes):
            return disorder
        steps, single = positions[axis][order].astype(float), []
        if len(names):
            ordered = [names[int(i)] for i in order]
            single = odd_frame_notes(stripes, ordered) + stalled_notes(stripes, steps, axis, ordered)
        return single + self._open_turn(stripes, steps, axis)

    def _open_turn(self, stripes: Float[np.ndarray, "frames some"], steps: _Steps, axis: str) -> list[str]:
        turn = full_turn(self._motion, [axis])
        return [] if turn is None else closing_notes(stripes, steps, turn, axis)

    def _disorder(self, stripes: Float[np.ndarray, "frames some"]) -> list[str]:
        near, far = _apart(stripes, 1), _apart(stripes, max(len(stripes) // 3, 2))
        if min(len(near), len(far)) < _FEWEST:
            return []
        near_px, far_px = float(np.median(near)), float(np.median(far))
        if far_px < _DIFFER_PX or near_px < _PART * far_px:
            return []
        return [
            f"the photographs seem to be in no order: the stripe differs by {near_px:.1f} px from each to the next, "
            f"and by {far_px:.1f} px from those far away: check that frames and motor steps belong together"
        ]


def _apart(stripes: Float[np.ndarray, "frames some"], by: int) -> Float[np.ndarray, "pairs"]:
    """By how much the stripes of frames so far apart differ, in the median of their lines, px."""
    pairs = zip(stripes[by:], stripes[:-by], strict=True)
    return np.array([px for one, other in pairs if (px := stripes_apart(one, other)) is not None])
