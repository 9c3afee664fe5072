"""Do the photographs on the stage go with their step counts? Each board is placed by its own corners, and put in order.

Where another order of the same photographs makes a straight line in equal steps of what was a scatter, they were mixed
up: names that sort otherwise than they were taken, or step counts in another order.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.observations import Observations
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig
from jaxscan.rig.line import Line

_FEWEST = 3
# In another order the places must be nearer to a line by so much.
_NEARER = 0.3
# Up to this number of photographs that moved, and up to a third of all, each is named; of more the whole order is said.
_NAMED: Final = 5
_ORDER_NAMED: Final = 40


@dataclass(frozen=True)
class StageOrder:
    """A sequence whose photographs and step counts do not go together.

    Attributes:
        names: of the photographs, by their step counts.
        by_place: the same, by where the board stood.
        error_mm: RMS distance of the places from a line along the travel by the step counts as they are.
        sorted_mm: the same, with the step counts sorted by place.
    """

    names: tuple[str, ...]
    by_place: tuple[str, ...]
    error_mm: float
    sorted_mm: float

    @property
    def statement(self) -> tuple[str, str]:
        """What is the case, and what to do."""
        what = (
            "The photographs on the stage do not go with their step counts: the board stood "
            f"{self.error_mm:.2g} mm RMS away from where they say, and {self.sorted_mm:.2g} mm "
            f"{correction(self.names, self.by_place)}"
        )
        return what, (
            "Photograph names that sort otherwise than they were taken do this: correct images or steps under [stage] "
            "in session.toml."
        )


def correction(names: Sequence[str], by_place: Sequence[str]) -> str:
    """What puts names into another order of them, in words: two to exchange, the fewest to move, or the whole order."""
    wrong = [name for name, right in zip(names, by_place, strict=True) if name != right]
    if len(wrong) == 2:
        return f"if {wrong[0]} and {wrong[1]} were exchanged"
    moved = [name for name in by_place if name in fewest_to_move(names, by_place)]
    if len(moved) > min(_NAMED, len(by_place) // 3):
        more = len(by_place) - _ORDER_NAMED
        return f"if they were in the order {', '.join(by_place[:_ORDER_NAMED])}" + (f" and {more} more" * (more > 0))
    places = []
    for name in moved:
        at = by_place.index(name)
        before, behind = by_place[at - 1 : at], by_place[at + 1 : at + 2]
        if before and behind:
            places.append(f"{name} were between {before[0]} and {behind[0]}")
        else:
            places.append(f"{name} were {'last' if before else 'first'}")
    return f"if {', and '.join(places)}"


def fewest_to_move(names: Sequence[str], by_place: Sequence[str]) -> set[str]:
    """The smallest set of names such that the others already stand in the other order: all but a longest rising run."""
    rank = {name: i for i, name in enumerate(by_place)}
    ends: list[int] = []
    last: list[str] = []
    before: dict[str, str | None] = {}
    for name in names:
        at = bisect_left(ends, rank[name])
        ends[at:], last[at:] = [rank[name], *ends[at + 1 :]], [name, *last[at + 1 :]]
        before[name] = last[at - 1] if at else None
    stays, name = set(), last[-1] if last else None
    while name is not None:
        stays.add(name)
        name = before[name]
    return set(names) - stays


def stage_orders(observations: Observations, rig: Rig) -> tuple[StageOrder, ...]:
    """The sequences on the stage that were mixed up; of the rig its camera is used, and which axes are lines."""
    found = []
    middle = observations.board.points().mean(axis=0)
    for sequence in observations.sequences:
        if not isinstance(rig.axis(sequence.axis), Line) or len(sequence.views) < _FEWEST:
            continue
        with float64():
            blocks = view_blocks(replace(observations, views=sequence.views, sequences=()))
            poses = np.array(first_poses(as_float64(rig.camera), blocks))[: len(sequence.views)]
        places = Pose.from_vector(poses).apply(middle)
        order = out_of_order(sequence.steps, places)
        if order is not None:
            by_step = np.argsort(sequence.steps, kind="stable")
            names = [view.name for view in sequence.views]
            found.append(
                StageOrder(tuple(names[i] for i in by_step), tuple(names[i] for i in order[0]), order[1], order[2])
            )
    return tuple(found)


def out_of_order(
    steps: Float[np.ndarray, "images"], places: Float[np.ndarray, "images 3"]
) -> tuple[np.ndarray, float, float] | None:
    """The order by place, and the RMS distance from a line before and after (mm); None where the steps do as well."""
    along = np.linalg.svd(places - places.mean(axis=0))[2][0]
    at = places @ along
    if np.dot(at - at.mean(), steps - steps.mean()) < 0:
        at = -at
    order = np.argsort(at)
    before, after = _from_line(steps, at), _from_line(np.sort(steps), at[order])
    return (order, before, after) if after < _NEARER * before else None


def _from_line(steps: Float[np.ndarray, "images"], at: Float[np.ndarray, "images"]) -> float:
    left = about_a_line(steps, at[:, None], np.ones((len(at), 1)))
    return float(np.sqrt((left**2).mean()))


def about_a_line(
    steps: Float[np.ndarray, "images"],
    values: Float[np.ndarray, "images ways"],
    sigma: Float[np.ndarray, "images ways"],
) -> Float[np.ndarray, "images ways"]:
    """Values less the line over the steps that fits them best, each way by itself; fewer than three stay."""
    if len(steps) < _FEWEST:
        return values
    A = np.stack([np.ones_like(steps), (steps - steps.mean()) / max(float(np.ptp(steps)), 1e-9)], axis=1)
    left = values.copy()
    for way in range(values.shape[1]):
        weight = 1 / sigma[:, way]
        left[:, way] -= A @ np.linalg.lstsq(A * weight[:, None], values[:, way] * weight, rcond=None)[0]
    return left
