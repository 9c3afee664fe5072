"""Do the photographs on an axis go with their step counts? Each board is placed by its own corners, and put in order.

Where another order of the same photographs makes a straight line in equal steps of what was a scatter, they were mixed
up: names that sort otherwise than they were taken, or step counts in another order.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.reorder import NEARER, correction
from jaxscan.calibration.turn_order import turned_out_of_order
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig
from jaxscan.rig.line import Line
from jaxscan.rig.rotary import Rotary

_FEWEST = 3


@dataclass(frozen=True)
class StageOrder:
    """A sequence whose photographs and step counts do not go together.

    Attributes:
        names: of the photographs, by their step counts.
        by_place: the same, by where the board stood.
        error: RMS distance of the places from a line along the travel by the step counts as they are, mm; of a turn
            that of its angles, degrees.
        sorted_error: the same, with the step counts sorted by place.
        unit: of both.
        axis: the name of the axis.
    """

    names: tuple[str, ...]
    by_place: tuple[str, ...]
    error: float
    sorted_error: float
    unit: str
    axis: str

    @property
    def statement(self) -> tuple[str, str]:
        """What is the case, and what to do."""
        what = (
            f"The photographs on the {self.axis} do not fit their step counts: the board was "
            f"{self.error:.2g}{self.unit} RMS away from where they say, and {self.sorted_error:.2g}{self.unit} "
            f"{correction(self.names, self.by_place)}"
        )
        return what, (
            "This happens if the names of photographs sort in another order than they were taken: correct images or "
            "steps under "
            f"[{self.axis}] in session.toml."
        )


def stage_orders(observations: Observations, rig: Rig) -> tuple[StageOrder, ...]:
    """The sequences on stage and turntable that were mixed up; of the rig its camera is used, and how its axes move."""
    found = []
    middle = observations.board.points().mean(axis=0)
    for sequence in observations.sequences:
        axis = rig.axis(sequence.axis)
        if not isinstance(axis, Line | Rotary) or len(sequence.views) < _FEWEST:
            continue
        with float64():
            blocks = view_blocks(replace(observations, views=sequence.views, sequences=()))
            poses = np.array(first_poses(as_float64(rig.camera), blocks))[: len(sequence.views)]
        stood = Pose.from_vector(poses)
        if isinstance(axis, Rotary):
            rate = axis.direction() * np.radians(axis.amount(1.0)[0])
            order, unit = turned_out_of_order(sequence.steps, stood.matrix(), rate), "°"
        else:
            order, unit = out_of_order(sequence.steps, stood.apply(middle)), " mm"
        if order is not None:
            by_step = np.argsort(sequence.steps, kind="stable")
            names = [view.name for view in sequence.views]
            by_place = tuple(names[i] for i in order[0])
            found.append(
                StageOrder(tuple(names[i] for i in by_step), by_place, *order[1:], unit=unit, axis=sequence.axis)
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
    return (order, before, after) if after < NEARER * before else None


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
