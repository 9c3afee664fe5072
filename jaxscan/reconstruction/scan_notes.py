"""Which lines of a scan have no point, and what is said of them."""

from typing import Final

from jaxscan.images.stripes.validity import Verdict

# Why a line in which something is bright has no point, as programs are told.
REASONS: Final = {
    Verdict.OUTSIDE: "outside_of_the_depths",
    Verdict.SPOT: "no_line",
    Verdict.SECOND: "second_stripe",
    Verdict.WEAK: "too_weak",
}
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
