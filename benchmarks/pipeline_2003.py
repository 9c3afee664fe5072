"""What the pipeline of 2003 is given, and what it returns.

Its steps are in `benchmarks/matlab/`; Octave runs them (`benchmarks.octave`), or NumPy (`benchmarks.transcription`).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration import Observations
from jaxscan.files.scan import Scan

# Responses, (R − G) + (R − B), from which on a pixel belongs to the stripe.
BOARD_THRESHOLD, SCAN_THRESHOLD = 300.0, 200.0


@dataclass(frozen=True)
class Quirks:
    """Switches: True is as it was in 2003, False as it should be. `matlab/scan2003.m` says what each one does."""

    pixels_from_one: bool = True
    index_from_one: bool = True
    whole_rows: bool = True
    board_sign: bool = True
    few_iterations: bool = True
    mean_line: bool = True
    mean_of_pairs: bool = True
    first_and_last: bool = True
    first_pick: bool = True
    bridged: bool = True
    loops: bool = True

    def as_dict(self) -> dict[str, bool]:
        """The switches by name."""
        return asdict(self)


@dataclass(frozen=True)
class Job:
    """Photographs, and the corners that were found in them.

    Attributes:
        image_size: columns and rows.
        board: where the corners are on the board, mm; its z axis points at the camera.
        corners: pixels (u, v) of every view; NaN where one was not found.
        stage_corners: the same of the board on the stage.
        board_photos: for each view, the photograph of board and stripe.
        scan_photos: of the scan.
        clicks: where a person clicked on the floor, x and y, mm.
        ply: where the mesh is written; None for none.
    """

    image_size: tuple[int, int]
    board: Float[np.ndarray, "corners 2"]
    corners: Float[np.ndarray, "views corners 2"]
    stage_corners: Float[np.ndarray, "images corners 2"]
    board_photos: tuple[Path, ...]
    scan_photos: tuple[Path, ...]
    clicks: Float[np.ndarray, "clicks 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    ply: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """What the pipeline found.

    Attributes:
        focal: px.
        principal: px.
        k1: of the lens.
        rotations: of T_cam_board, rotation vectors.
        translations: of T_cam_board, mm.
        planes: the boards' dual planes, 1/mm.
        lines: the stripes' line vectors.
        laser_plane: ω, 1/mm.
        stage_move: mm from one photograph to the next.
        board_stripes: view (from 1), column and row of each stripe point on a board, as the pipeline counts them.
        points: of the scan, mm, moved back by each photograph's index.
        frame: of each point, from 0.
        column: of each point, from 0.
        kept: which are not of the floor.
        faces: corners of the triangles, from 0, among the points kept.
        seconds: the time of each step.
    """

    focal: Float[np.ndarray, "2"]
    principal: Float[np.ndarray, "2"]
    k1: float
    rotations: Float[np.ndarray, "views 3"]
    translations: Float[np.ndarray, "views 3"]
    planes: Float[np.ndarray, "views 3"]
    lines: Float[np.ndarray, "views 3"]
    laser_plane: Float[np.ndarray, "3"]
    stage_move: Float[np.ndarray, "3"]
    board_stripes: Float[np.ndarray, "stripe_points 3"]
    points: Float[np.ndarray, "points 3"]
    frame: Int[np.ndarray, "points"]
    column: Int[np.ndarray, "points"]
    kept: Bool[np.ndarray, "points"]
    faces: Int[np.ndarray, "faces 3"]
    seconds: Mapping[str, float]

    def organised(self, frames: int, columns: int) -> Float[np.ndarray, "frames columns 3"]:
        """The points by frame and column, NaN where there is none."""
        grid = np.full((frames, columns, 3), np.nan)
        grid[self.frame, self.column] = self.points
        return grid


def job_of(observations: Observations, folder: Path, scan: Scan | None, **more: Any) -> Job:
    """The job of a session and a scan.

    Args:
        observations: of the session.
        folder: of the session: the photographs of the views hold board and stripe.
        scan: the scan, or None for none.
        more: other attributes of the job.
    """
    board = observations.board.points()[:, :2]
    # Counted from the last row upwards: then z = x × y points at the camera.
    board[:, 1] = board[:, 1].max() - board[:, 1]
    return Job(
        image_size=observations.image_size,
        board=board,
        corners=np.stack([view.corners for view in observations.views]),
        stage_corners=np.stack([view.corners for view in observations.sequences[0].views]),
        board_photos=tuple(folder / view.name for view in observations.views),
        scan_photos=() if scan is None else tuple(scan.frames),
        **more,
    )
