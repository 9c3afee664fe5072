"""What calibration is given: where corners and stripe were seen, photograph by photograph.

Plain arrays that anyone can fill in; `observe` fills them in from the photographs of a session.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import InputError
from jaxscan.images import Board


@dataclass(frozen=True)
class StripePoints:
    """Where a stripe was seen in one photograph of the board.

    Attributes:
        pixels: (u, v) of each stripe point; NaN for one that is missing.
        columns: True where the stripe was found column by column (v is measured), False for row by row (u is).
        laser: which of the observations' lasers.
        half_width_px: how far the stripe's light reaches to either side; within it the board must have one colour.
    """

    pixels: Float[np.ndarray, "points 2"]
    columns: bool = True
    laser: int = 0
    half_width_px: float = 3.0


@dataclass(frozen=True)
class View:
    """One photograph of the board.

    Attributes:
        name: how messages call it, usually the file's name.
        corners: pixel of each board point, in the order of `Board.points`; NaN for one that was not found.
        weights: relative weight (1 / σ) of each corner, or None for equal ones; 0 leaves a corner out.
        stripes: the stripes seen on the board in this pose.
    """

    name: str
    corners: Float[np.ndarray, "corners 2"]
    weights: Float[np.ndarray, "corners"] | None = None
    stripes: tuple[StripePoints, ...] = ()

    def used(self) -> Bool[np.ndarray, "corners"]:
        """Which corners take part."""
        seen = np.all(np.isfinite(self.corners), axis=1)
        return seen if self.weights is None else seen & (self.weights > 0)


@dataclass(frozen=True)
class StageSequence:
    """Photographs of one board fixed on the stage, along its travel.

    Attributes:
        steps: motor step count of each photograph.
        views: the photographs, all with the corners in the same order, without stripes.
    """

    steps: Float[np.ndarray, "images"]
    views: tuple[View, ...]


@dataclass(frozen=True)
class Observations:
    """All that the joint solve is given.

    Attributes:
        image_size: columns and rows of every photograph.
        board: the board, for the millimetres of its points.
        views: the board held in many poses.
        stages: stage sequences.
        lasers: the names of the lasers, "" for the only one.
        left_out: what was looked for and not found, in words.
        notes: what a reader should know of the photographs: ambiguities, guesses.
    """

    image_size: tuple[int, int]
    board: Board
    views: tuple[View, ...]
    stages: tuple[StageSequence, ...] = ()
    lasers: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        count = len(self.board.points())
        for view in (*self.views, *(view for stage in self.stages for view in stage.views)):
            if view.corners.shape != (count, 2):
                raise InputError(
                    f"{view.name}: corners has the shape {view.corners.shape}, the board's {count} points need another"
                )
            if view.weights is not None and view.weights.shape != (count,):
                raise InputError(f"{view.name}: weights has the shape {view.weights.shape}, not ({count},)")
            for stripe in view.stripes:
                if not 0 <= stripe.laser < len(self.lasers):
                    raise InputError(f"{view.name}: a stripe names laser {stripe.laser} of {len(self.lasers)}")
        for stage in self.stages:
            for view in stage.views:
                if view.stripes:
                    raise InputError(
                        f"{view.name}: a stage photograph has stripes, which are compared with boards held still: give "
                        "this photograph as a view as well, with its stripes, and leave them out of the stage sequence"
                    )
            if len(stage.steps) != len(stage.views):
                raise InputError(f"{len(stage.steps)} step counts for {len(stage.views)} stage photographs")
