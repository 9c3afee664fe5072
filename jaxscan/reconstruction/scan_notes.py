"""What is said of a scan beside its points: how far its axes go, and which lines have no point."""

from typing import Final

import numpy as np

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.images.stripes.validity import Verdict
from jaxscan.rig import Rig

# Why a line in which something is bright has no point, as programs are told.
REASONS: Final = {
    Verdict.OUTSIDE: "outside_of_the_depths",
    Verdict.SPOT: "no_line",
    Verdict.SECOND: "second_stripe",
    Verdict.WEAK: "too_weak",
}
# More full turns than these are a mistake; profiles further apart than this are not joined to a surface.
_MOST_TURNS: Final = 5
_WIDE_APART_DEG: Final = 10.0
# Below this part of the points nothing is said of those that are left out.
_WORTH_A_NOTE: Final = 0.02


def left_out_notes(left_out: dict[str, int], points: int, depths_mm: tuple[float, float] | None) -> list[str]:
    """What is said of lines without a point, where they are many."""
    outside, weak = (left_out[REASONS[verdict]] for verdict in (Verdict.OUTSIDE, Verdict.WEAK))
    notes = []
    if depths_mm is not None and outside:
        near, far = depths_mm
        notes.append(
            f"{outside} points were left out that would lie nearer than {near:.0f} or farther than {far:.0f} mm: set "
            "the depths of the scene with --depths NEAR,FAR, or keep all of them with --depths 0,inf"
        )
    if weak > _WORTH_A_NOTE * points:
        notes.append(
            f"{weak} lines, {weak / (weak + points):.0%} of those with a stripe, show it too weak to be told from "
            "noise: expose longer, open the lens, or take the laser nearer"
        )
    return notes


def way_notes(rig: Rig, scan: Scan) -> list[str]:
    """What is said of how far each axis goes.

    Raises:
        InputError: an axis turns so far that its steps must be those of another.
    """
    notes = []
    for axis in scan.moving:
        each = np.asarray(scan.axes.get(axis, ()), np.float64)
        if len(each) < 2:
            continue
        whole, unit = rig.axis(axis).amount(float(np.ptp(each)))
        apart, _ = rig.axis(axis).amount(float(np.abs(np.diff(each)).max()))
        if unit != "degrees":
            continue
        if whole > _MOST_TURNS * 360:
            raise InputError(
                f"{scan.path}: [scan] the {axis} turns by {whole:.0f} degrees, {whole / 360:.1f} full turns: are these "
                f"the steps of another axis? A full turn is {360 / rig.axis(axis).amount(1.0)[0]:.0f} steps"
            )
        if whole > 360 + apart:
            notes.append(
                f"the {axis} turns by {whole:.0f} degrees, more than one full turn: what was seen twice stands twice"
            )
        if apart > _WIDE_APART_DEG:
            notes.append(
                f"the frames are up to {apart:.1f} degrees of the {axis} apart: profiles so far from each other make "
                f"points, and no surface; take at least {int(np.ceil(whole / _WIDE_APART_DEG))} frames"
            )
    return notes
