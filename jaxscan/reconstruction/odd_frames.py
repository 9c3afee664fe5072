"""Single photographs that do not go with those beside them: of another laser, of an object that was pushed, or dark.

Its stripe is as good as any, so no photograph shows this by itself. From one photograph to the next a stripe moves by
little; one that lies far from both its neighbours in nearly all lines, while these lie close to each other, is odd.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.files.scan import Scan
from jaxscan.phrases import first_few
from jaxscan.reconstruction.merged_steps import step_groups

# Lines that two photographs must both have, and the part of its neighbours' lines that an odd one must have.
_BOTH, _SHARED = 16, 0.5
# An odd one is this far from its neighbours, px, and this multiple of what these, and photographs that follow one
# another, differ by. So far off are all of its lines but this part: a rib, seen in one photograph only, has the table
# beside it.
_FAR_PX, _FAR, _BUT = 3.0, 6.0, 0.1
# Where more than this part of the photographs stands out, the object is jagged.
_FEW: Final = 0.1
# Photographs that a note names.
_NAMED: Final = 4


def frame_names(scan: Scan, count: int) -> list[str]:
    """What to call each frame of a scan: its file, the first file of a step with several exposures, or its number."""
    groups = step_groups(scan)
    if len(groups) == count and len(scan.frames) == len(scan.positions):
        return [scan.frames[group.start].name for group in groups]
    return [f"frame {i}" for i in range(count)]


def odd_frame_notes(stripes: Float[np.ndarray, "frames lines"], names: Sequence[str]) -> list[str]:
    """What is said of photographs that do not go with those beside them.

    Args:
        stripes: the position of each line's stripe, px; NaN where there is none; in the order in which they were taken.
        names: of the photographs, in the same order.
    """
    lines = np.isfinite(stripes).sum(axis=1)
    shown: list[int] = np.flatnonzero(lines >= _BOTH).tolist()
    if len(shown) < 3:
        return []
    near = [px for a, b in pairwise(shown) if (px := stripes_apart(stripes[a], stripes[b])) is not None]
    usual = float(np.median(near)) if near else 0.0
    return _odd(stripes, shown, usual, names) + _dark(stripes, lines, shown, usual, names)


def _odd(stripes: Float[np.ndarray, "frames lines"], shown: list[int], usual: float, names: Sequence[str]) -> list[str]:
    odd: list[tuple[int, float, float]] = []
    for before, i, after in zip(shown[:-2], shown[1:-1], shown[2:], strict=True):
        agree = stripes_apart(stripes[before], stripes[after])
        if agree is None:
            continue
        off = np.abs(stripes[i] - stripes[[before, after]]).min(axis=0)
        off = off[np.isfinite(off)]
        both = int(np.isfinite(stripes[before] - stripes[after]).sum())
        if len(off) < max(_BOTH, _SHARED * both):
            continue
        if np.quantile(off, _BUT) > max(_FAR_PX, _FAR * max(agree, usual)):
            odd.append((i, float(np.median(off)), agree))
    if not odd or len(odd) > max(1, _FEW * len(shown)):
        return []
    some = first_few([f"{names[i]} ({px:.0f} px from theirs)" for i, px, _ in odd], _NAMED)
    do = "does" if len(odd) == 1 else "do"
    return [
        f"the stripe of {some} {do} not fit those before and after it, which are within "
        f"{max(agree for *_, agree in odd):.1f} px of each other: check that only this laser was on and that nothing "
        "was pushed; leave such photographs and their steps out of scan.toml. Nothing is wrong only if a narrow rib "
        "fills the photograph"
    ]


def _dark(
    stripes: Float[np.ndarray, "frames lines"],
    lines: Int[np.ndarray, "frames"],
    shown: list[int],
    usual: float,
    names: Sequence[str],
) -> list[str]:
    dark: list[int] = []
    for before, after in pairwise(shown):
        between = range(before + 1, after)
        # Another object begins where the stripe is elsewhere behind the gap.
        apart = stripes_apart(stripes[before], stripes[after])
        if apart is not None and apart < max(_FAR_PX, _FAR * usual * (len(between) + 1)):
            dark += [i for i in between if not lines[i]]
    if not dark:
        return []
    some = first_few([names[i] for i in dark], _NAMED)
    shows = "shows" if len(dark) == 1 else "show"
    return [
        f"{some} {shows} no stripe, and those before and after do: check that the laser was on; if its light met "
        "nothing there, nothing is wrong"
    ]


def stripes_apart(one: Float[np.ndarray, "lines"], other: Float[np.ndarray, "lines"]) -> float | None:
    """By how much the stripes of two photographs differ, in the median of their lines, px; None where few have both."""
    off = np.abs(one - other)
    off = off[np.isfinite(off)]
    return float(np.median(off)) if len(off) >= _BOTH else None
