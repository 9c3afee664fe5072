"""What the photographs cover: tilts and distances of the boards, the image, the sheet of light, the stage's travel.

The numbers behind every sentence that says why something is not known better, and what photograph would help.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Float, Int

from jaxscan.calibration.observations import Observations
from jaxscan.calibration.on_board import stripe_points_in_space
from jaxscan.geometry import Pose
from jaxscan.rig import Rig

# The image is looked at in so many columns and rows of cells.
CELLS = (8, 6)


@dataclass(frozen=True)
class StripeCoverage:
    """Where the stripes of one laser lie on the boards.

    Attributes:
        laser: its name, "" for the only one.
        views: how many views show it on the board.
        points: how many stripe points lie on boards.
        depths_mm: from the nearest to the farthest of them, along the optical axis.
        across_mm: how far the stripes are spread across their own direction, within the sheet.
    """

    laser: str
    views: int
    points: int
    depths_mm: tuple[float, float]
    across_mm: float


@dataclass(frozen=True)
class Coverage:
    """What the photographs cover.

    Attributes:
        tilts_deg: angle of each view's board normal with the optical axis.
        normals: each view's board normal in the camera frame.
        tilt_spread_deg: the largest angle between the normals of two boards.
        distances_mm: from the camera's centre to the middle of each view's board.
        corners_in_cells: corners of the views in each cell of the image.
        image_share: share of the cells that hold a corner.
        reach: how far the outermost corner is from the image's centre, as a share of the half diagonal.
        stripes: laser by laser.
        stage_images: photographs of the board on the stage.
        stage_travel_mm: between the first and the last of them; None where the rig has no stage.
        turntable_images: photographs of the board on the turntable.
        turn_deg: from the first to the last of them; None where the rig has no turntable.
    """

    tilts_deg: Float[np.ndarray, "views"]
    normals: Float[np.ndarray, "views 3"]
    tilt_spread_deg: float
    distances_mm: Float[np.ndarray, "views"]
    corners_in_cells: Int[np.ndarray, "cell_rows cell_columns"]
    image_share: float
    reach: float
    stripes: tuple[StripeCoverage, ...]
    stage_images: int
    stage_travel_mm: float | None
    turntable_images: int
    turn_deg: float | None


def measure_coverage(observations: Observations, rig: Rig, poses: Float[Array, "blocks 6"]) -> Coverage:
    """What the views, stripes and stage photographs of a rig cover; inside a `float64` block.

    Args:
        observations: the photographs; those stripe points that do not lie on the board are NaN.
        rig: camera, lasers and stage, JAX float64 leaves; a laser that is not known yet is left out of it.
        poses: of the views' boards, in the order of the views; there may be more.
    """
    # NumPy's: many small arrays, for each of which JAX would compile anew.
    boards = Pose.from_vector(np.asarray(poses)[: len(observations.views)])
    normals = boards.matrix()[..., 2]
    middles = boards.apply(observations.board.points().mean(axis=0))
    corners = np.concatenate([view.corners[view.used()] for view in observations.views])
    size = np.asarray(observations.image_size)
    cell = np.floor((corners + 0.5) / size * CELLS).astype(int).clip(0, np.array(CELLS) - 1)
    counts = np.zeros(CELLS[::-1], int)
    np.add.at(counts, (cell[:, 1], cell[:, 0]), 1)
    along = [stage for stage in observations.stages if stage.turns is None]
    turns = [(stage.views, stage.turns) for stage in observations.stages if stage.turns is not None]
    travel = turn = None
    if rig.stage is not None and along:
        per_step = float(np.linalg.norm(np.stack(rig.stage.per_step)))
        travel = per_step * max(float(np.ptp(stage.steps)) for stage in along)
    if rig.turntable is not None and turns:
        per_turn = float(np.linalg.norm(np.stack(rig.turntable.per_step)))
        turn = float(np.degrees(per_turn * max(float(np.ptp(counts)) for _, counts in turns)))
    return Coverage(
        tilts_deg=np.degrees(np.arccos(np.abs(normals[:, 2]).clip(0, 1))),
        normals=normals,
        tilt_spread_deg=float(np.degrees(np.arccos((normals @ normals.T).clip(-1, 1))).max()),
        distances_mm=np.linalg.norm(middles, axis=1),
        corners_in_cells=counts,
        image_share=float((counts > 0).mean()),
        reach=float(np.linalg.norm(corners - (size - 1) / 2, axis=1).max() / np.linalg.norm(size / 2)),
        stripes=tuple(_stripes(observations, rig, poses, i) for i in range(len(rig.lasers))),
        stage_images=sum(len(stage.views) for stage in along),
        stage_travel_mm=travel,
        turntable_images=sum(len(views) for views, _ in turns),
        turn_deg=turn,
    )


def _stripes(observations: Observations, rig: Rig, poses: Float[Array, "blocks 6"], laser: int) -> StripeCoverage:
    X, view = stripe_points_in_space(observations, rig.camera, poses, laser)
    if not len(X):
        return StripeCoverage(rig.lasers[laser].name, 0, 0, (np.nan, np.nan), 0.0)
    # Stripes run along the sheet's intersection with boards that face the camera: across the line of sight.
    omega = np.stack(rig.lasers[laser].plane)
    along = np.cross(omega, [0.0, 0.0, 1.0])
    across = np.cross(omega, along)
    spread = X @ (across / np.linalg.norm(across))
    return StripeCoverage(
        laser=rig.lasers[laser].name,
        views=len(np.unique(view)),
        points=len(X),
        depths_mm=(float(X[:, 2].min()), float(X[:, 2].max())),
        across_mm=float(np.ptp(spread)),
    )
