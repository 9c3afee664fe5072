"""What photograph would help most: the one place of the report where that is said."""

from dataclasses import dataclass

import numpy as np

from jaxscan.calibration import Observations
from jaxscan.calibration.hand import Hand
from jaxscan.calibration.next_pose import NextPose
from jaxscan.reconstruction.next_best_views import NextBestViews
from jaxscan.reconstruction.working_volume import WorkingVolume
from jaxscan.view import calibration_plots as plots
from jaxscan.view.report import Figure, draw

# A gain of less is not worth a photograph.
_WORTH = 0.02
# Tilts and turns of less are not worth a word.
_LEVEL_DEG = 8.0
_SIDES = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")


@dataclass(frozen=True)
class Advice:
    """What to photograph next.

    Attributes:
        words: the most useful first.
        figures: that show it.
    """

    words: tuple[str, ...]
    figures: tuple[Figure, ...] = ()


def advise(
    planned: NextBestViews, volumes: tuple[WorkingVolume, ...], observations: Observations, hand: Hand | None = None
) -> Advice:
    """The advice in words and as a picture.

    Args:
        planned: the poses that lower σ most.
        volumes: for the share of a point's variance that calibration does not change.
        observations: the photographs that there are.
        hand: the given poses, where there are any.
    """
    before = (planned.median_now, *planned.medians)
    worth = bool(planned.poses) and planned.medians[-1] <= (1 - _WORTH) * planned.median_now
    limit = [
        words + (". The most that the board can do is drawn in the report" if worth else "")
        for words in _what_else_limits(volumes, hand)
    ]
    if not worth:
        return Advice((*limit, _MORE))
    words = []
    for i, (pose, sigma) in enumerate(zip(planned.poses, planned.medians, strict=True)):
        what = "a point" if planned.unit == "mm" else "where a point is seen"
        falls = f"the median σ of {what} would fall from {before[i]:#.3g} to {sigma:#.3g} {planned.unit}"
        words.append(f"{'then ' if i else ''}{place(pose, observations.image_size)} (outline {i + 1}): {falls}")
    caption = (
        "Where to hold the board, as the camera sees it (outline 1 first; dotted: the stripe on it), over the present "
        "boards (pale: their outermost points). A place a centimetre and five degrees off is nearly as good."
    )
    picture = draw("next-photographs", caption, plots.next_best_views(planned.poses, observations))
    return Advice((*limit, *words), (picture,))


def advise_unplanned(volumes: tuple[WorkingVolume, ...], hand: Hand | None = None) -> Advice:
    """What can be said where no poses were sought: only whether more photographs of the board help at all."""
    return Advice((*_what_else_limits(volumes, hand), f"{_MORE}; --report draws where the board helps most"))


_MORE = "more views like the present ones: each σ falls with the root of their number"


def poses_limit(volumes: tuple[WorkingVolume, ...], hand: Hand | None) -> bool:
    """Whether given poses move a profile by more than its points are off within it."""
    return hand is not None and hand.profile_mm > max((volume.median_mm for volume in volumes), default=np.inf)


def _what_else_limits(volumes: tuple[WorkingVolume, ...], hand: Hand | None) -> list[str]:
    """That the board will do little, where given poses or the stripe's own error are most of a point's."""
    if poses_limit(volumes, hand):
        return ["more photographs hardly help: the given poses limit a scan, and not the stripe"]
    if not volumes or (share := 1 - max(volumes, key=lambda v: v.median_mm).rig_share) <= 0.5:
        return []
    return [
        f"another photograph of the board hardly helps: {100 * share:.0f} % of a point's variance is the stripe's own, "
        "which calibration does not change. A finer or brighter stripe and a longer exposure in the scans help more"
    ]


def place(pose: NextPose, image_size: tuple[int, int]) -> str:
    """Where and how to hold the board, in words."""
    middle = (pose.outline_px.mean(axis=0) + 0.5) / image_size
    across = ("left", "", "right")[int(np.clip(3 * middle[0], 0, 2))]
    down = ("upper", "", "lower")[int(np.clip(3 * middle[1], 0, 2))]
    where = f"{down} {across}".strip() or "middle"
    words = [f"the board {pose.distance_mm:.0f} mm away in the {where} part of the image"]
    angle = float(np.linalg.norm(pose.tilt_deg))
    if angle > _LEVEL_DEG:
        eighth = round(float(np.degrees(np.arctan2(pose.tilt_deg[1], pose.tilt_deg[0]))) / 45) % 8
        words.append(f"tilted by {angle:.0f}° with its {_SIDES[eighth]} side nearer")
    else:
        words.append("facing the camera")
    row = pose.outline_px[1] - pose.outline_px[0]
    # Half a turn shows the same points again.
    turn = (np.degrees(np.arctan2(row[1], row[0])) + 90) % 180 - 90
    if abs(turn) > _LEVEL_DEG:
        words.append(f"its rows turned by {abs(turn):.0f}° {'clockwise' if turn > 0 else 'anticlockwise'}")
    crossed = np.isfinite(pose.stripes_px).all(axis=(1, 2))
    if crossed.size:
        words.append(
            "the laser on and its stripe across the board"
            if crossed.all()
            else "one laser's stripe across it"
            if crossed.any()
            else "the stripe beside it: its corners are what is wanted"
        )
    return ", ".join(words)
