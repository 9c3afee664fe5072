"""Do the photographs on the stage go with their step counts? Each board is placed by its own corners, and put in order.

Where another order of the same photographs makes a straight line in equal steps of what was a scatter, they were mixed
up: names that sort otherwise than they were taken, or step counts in another order.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.result import Calibration
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, float64
from jaxscan.rig.line import Line

_FEWEST = 3
# In another order the places must be nearer to a line by so much.
_NEARER = 0.3


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


def stage_orders(calibration: Calibration) -> tuple[StageOrder, ...]:
    """The sequences on the stage that were mixed up."""
    found = []
    middle = calibration.observations.board.points().mean(axis=0)
    for sequence in calibration.observations.sequences:
        if not isinstance(calibration.rig.axis(sequence.axis), Line) or len(sequence.views) < _FEWEST:
            continue
        with float64():
            blocks = view_blocks(replace(calibration.observations, views=sequence.views, sequences=()))
            poses = np.array(first_poses(as_float64(calibration.rig.camera), blocks))[: len(sequence.views)]
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
    A = np.stack([np.ones_like(at), (steps - steps.mean()) / max(float(np.ptp(steps)), 1e-9)], axis=1)
    return float(np.sqrt(((at - A @ np.linalg.lstsq(A, at, rcond=None)[0]) ** 2).mean()))
