"""What the photographs cover: tilts and distances of the boards, the image, the sheet of light, the way of each axis.

The numbers behind every sentence that says why something is not known better, and what photograph would help.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.observations import Observations
from jaxscan.calibration.on_board import stripe_points_in_space
from jaxscan.geometry import Pose
from jaxscan.rig import Rig
from jaxscan.rig.light import sheet_axes, stood

# The image is divided into this number of columns and rows of cells.
CELLS = (8, 6)


@dataclass(frozen=True)
class StripeCoverage:
    """Where the stripes of one laser lie on the boards.

    Attributes:
        laser: its name, "" for the only one.
        views: how many views show it on the board.
        points: how many stripe points lie on boards.
        depths_mm: from the nearest to the farthest of them, along the optical axis; of a fisheye, from the camera.
        across_mm: how far the stripes are spread across their own direction, within the sheet.
        along_mm: and along it.
    """

    laser: str
    views: int
    points: int
    depths_mm: tuple[float, float]
    across_mm: float
    along_mm: float


@dataclass(frozen=True)
class AxisCoverage:
    """How far one axis moved the board.

    Attributes:
        photographs: of the board along it.
        way: from the first to the last of its longest sequence; None where its motion is not known yet.
        unit: of the way, mm or degrees.
    """

    photographs: int
    way: float | None
    unit: str


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
        axes: of each axis along which the board was photographed.
    """

    tilts_deg: Float[np.ndarray, "views"]
    normals: Float[np.ndarray, "views 3"]
    tilt_spread_deg: float
    distances_mm: Float[np.ndarray, "views"]
    corners_in_cells: Int[np.ndarray, "cell_rows cell_columns"]
    image_share: float
    reach: float
    stripes: tuple[StripeCoverage, ...]
    axes: dict[str, AxisCoverage]


def measure_coverage(observations: Observations, rig: Rig, poses: Pose[np.ndarray]) -> Coverage:
    """What the views, of which there may be none, the stripes and the photographs along the axes of a rig cover.

    Args:
        observations: the photographs; those stripe points that do not lie on the board are NaN.
        rig: camera, lights and motion; a light that is not known yet is left out of it.
        poses: T_cam_board of each photograph, the views' first.
    """
    n = len(observations.views)
    boards = Pose(poses.rotation[:n], poses.translation[:n])
    normals = boards.matrix()[..., 2]
    middles = boards.apply(observations.board.points().mean(axis=0))
    corners = np.concatenate([np.zeros((0, 2)), *(view.corners[view.used()] for view in observations.views)])
    size = np.asarray(observations.image_size)
    cell = np.floor((corners + 0.5) / size * CELLS).astype(int).clip(0, np.array(CELLS) - 1)
    counts = np.zeros(CELLS[::-1], int)
    np.add.at(counts, (cell[:, 1], cell[:, 0]), 1)
    axes: dict[str, AxisCoverage] = {}
    for sequence in observations.sequences:
        before = axes.get(sequence.axis, AxisCoverage(0, None, ""))
        way, unit = before.way, before.unit
        if sequence.axis in rig.axes():
            own, unit = rig.axis(sequence.axis).amount(float(np.ptp(sequence.steps)))
            way = max(own, way or 0.0)
        axes[sequence.axis] = AxisCoverage(before.photographs + len(sequence.views), way, unit)
    return Coverage(
        tilts_deg=np.degrees(np.arccos(np.abs(normals[:, 2]).clip(0, 1))),
        normals=normals,
        tilt_spread_deg=float(np.degrees(np.arccos((normals @ normals.T).clip(-1, 1))).max(initial=0.0)),
        distances_mm=np.linalg.norm(middles, axis=1),
        corners_in_cells=counts,
        image_share=float((counts > 0).mean()),
        reach=float(np.linalg.norm(corners - (size - 1) / 2, axis=1).max(initial=0.0) / np.linalg.norm(size / 2)),
        stripes=tuple(_stripes(observations, rig, poses, i) for i in range(len(rig.lights))),
        axes=axes,
    )


def _stripes(observations: Observations, rig: Rig, poses: Pose[np.ndarray], laser: int) -> StripeCoverage:
    X, view, positions = stripe_points_in_space(observations, rig.camera, poses, laser)
    light, ranges = rig.lights[laser], rig.camera.chart.range_of(X)
    if not len(X):
        return StripeCoverage(light.name, 0, 0, (np.nan, np.nan), 0.0, 0.0)
    light = stood(light, float(np.median(positions)))
    return StripeCoverage(
        laser=light.name,
        views=len(np.unique(view)),
        points=len(X),
        depths_mm=(float(ranges.min()), float(ranges.max())),
        across_mm=float(np.ptp(X @ sheet_axes(light)[1])),
        along_mm=float(np.ptp(X @ sheet_axes(light)[0])),
    )
