"""Which lines of a scan have no point, and what is said of them."""

from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float, UInt

from jaxscan.axis_details import is_detail
from jaxscan.files.axes import STAGE
from jaxscan.files.listing import gap_in_numbers
from jaxscan.files.scan import Scan
from jaxscan.files.text_order import text_order_note
from jaxscan.images.dark_frame import is_dark_frame
from jaxscan.images.decode import read_image
from jaxscan.images.stripe_settings import StripeSettings
from jaxscan.images.stripes.brightest import brighter_color
from jaxscan.images.stripes.other_colour import colour_that_shows
from jaxscan.images.stripes.stripe import u_and_v
from jaxscan.images.stripes.validity import Verdict
from jaxscan.reconstruction.scan_colours import object_stands
from jaxscan.rig import Rig

# Why a line in which something is bright has no point, as reported to programs.
REASONS: Final = {
    Verdict.OUTSIDE: "outside_of_the_depths",
    Verdict.SPOT: "no_line",
    Verdict.SECOND: "second_stripe",
    Verdict.WEAK: "too_weak",
}
# Below this part of the points nothing is said of those that are left out.
_WORTH_A_NOTE: Final = 0.02
# Outside of the depths lies more than this part of all points where a light does not stand where its steps say.
_MANY_OUTSIDE: Final = 0.1
# Frames in which other colours are tried.
_TRIED: Final = 3


def left_out_notes(
    left_out: dict[str, int], points: int, depths_mm: tuple[float, float] | None, swept_by: str | None = None
) -> list[str]:
    """What is said of lines without a point, where they are many.

    Args:
        left_out: how many lines have none, for each reason of `REASONS`.
        points: how many have one.
        depths_mm: the nearest and the farthest depth that was looked at; None for all.
        swept_by: the axis that moved the light in this scan; None where none did.
    """
    outside, weak = (left_out[REASONS[verdict]] for verdict in (Verdict.OUTSIDE, Verdict.WEAK))
    notes = []
    if depths_mm is not None and outside:
        near, far = depths_mm
        first = ""
        if swept_by is not None and outside > _MANY_OUTSIDE * (outside + points):
            first = (
                f'see whether the steps of axis "{swept_by}" are counted from the same place and in the same direction '
                "as in the session that the rig is from, or all points are wrong; if they are, "
            )
        notes.append(
            f"{outside} points were left out that would lie nearer than {near:.0f} or farther than {far:.0f} mm: "
            f"{first}set the depths of the scene with --depths NEAR,FAR, or keep all of them with --depths 0,inf"
        )
    if weak > _WORTH_A_NOTE * points:
        notes.append(
            f"{weak} lines, {weak / (weak + points):.0%} of those with a stripe, have one too weak to distinguish from "
            "noise: expose longer, open the lens, or take the laser nearer"
        )
    return notes


def gap_notes(scan: Scan) -> list[str]:
    """What is said of photographs that are missing among those of an evenly moving axis."""
    gap = gap_in_numbers(scan.frames) if scan.exposures_s is None else None
    moving = {axis: steps for axis, steps in scan.axes.items() if len(set(steps)) > 1}
    even = bool(moving) and all(len({b - a for a, b in pairwise(steps)}) == 1 for steps in moving.values())
    if gap is None or not even:
        return []
    under = "steps" if list(moving) == [STAGE] else f"[scan.axes] {' and '.join(moving)}"
    return [
        f"{gap[1].name} follows {gap[0].name}, as if photographs were missing, but by scan.toml the axis moved evenly "
        f"from each to the next: put them there, or list its position for each photograph under {under}"
    ]


def order_notes(scan: Scan) -> list[str]:
    """What is said of photographs that are listed in alphabetical order; of given poses they stand by name."""
    if scan.poses is not None or scan.exposures_s is not None:
        return []
    steps = [n for axis, n in scan.axes.items() if not is_detail(axis)]
    frames = text_order_note("frames", scan.frames, steps)
    # Those of frames in the same order go with them.
    dark = None if frames else text_order_note("the photographs of background", scan.backgrounds, steps)
    return [note for note in (frames, dark) if note]


def background_notes(rig: Rig, scan: Scan) -> list[str]:
    """What is said of one laser-off photograph that is subtracted from photographs of an object that moves.

    Nothing where it is a dark frame, which shows no object.
    """
    if len(scan.backgrounds) != 1 or object_stands(rig, scan) or is_dark_frame(read_image(scan.backgrounds[0])):
        return []
    return [
        f"{scan.backgrounds[0].name} is subtracted from all frames, but the object moves, and leaves its shape from "
        "that photograph in every other one: take one with the laser off at each step, or leave background "
        "out of scan.toml"
    ]


def in_another_colour(scan: Scan) -> str:
    """What to add where a scan shows no stripe of its laser's colour, but one of another; empty for no other."""
    if not scan.frames:
        return ""
    some = np.unique(np.linspace(0, len(scan.frames) - 1, _TRIED + 2).astype(int)[1:-1])
    shown = colour_that_shows([read_image(scan.frames[i]) for i in some], scan.laser)
    return "" if shown is None else f', but with color = "{shown}" there is one'


def brighter_colors(
    photographs: UInt[np.ndarray, "frames rows columns *rgb"],
    position: Float[np.ndarray, "frames lines"],
    laser: StripeSettings,
) -> list[str | None]:
    """The colour in which each photograph's stripe is far brighter than in the laser's, or None; of those with one.

    Args:
        photographs: as they are, 8 or 16 bits.
        position: of the stripe, the row of each column, or the column of each row, px; NaN for none.
        laser: how it was looked for.
    """
    return [
        brighter_color(image, np.stack(u_and_v(at, laser.columns), axis=-1), laser)
        for image, at in zip(photographs, position, strict=True)
        if np.isfinite(at).any()
    ]


def channels_note(
    photographs: UInt[np.ndarray, "frames rows columns *rgb"],
    position: Float[np.ndarray, "frames lines"],
    laser: StripeSettings,
) -> str | None:
    """What is said of photographs in memory whose stripe has another colour than it is looked for; None for nothing.

    The arguments are those of `brighter_colors`.
    """
    found = brighter_colors(photographs, position, laser)
    shown = next((color for color in set(found) if color and 2 * found.count(color) > len(found)), None)
    if not found:
        shown = colour_that_shows(photographs[:_TRIED], laser)
    if shown is None:
        return None
    swapped = {shown, laser.color} == {"red", "blue"}
    turn = "turn photographs that OpenCV has read, which are BGR, with image[..., ::-1]; or " if swapped else ""
    return (
        f"the stripe is searched in {laser.color}, but the photographs show it in {shown}: {turn}give "
        f'laser=StripeSettings(color="{shown}")'
    )
