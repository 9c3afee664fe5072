"""How far reconstructed points are from the truth of a simulation, and how complete they are."""

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.simulation.distance import distance
from jaxscan.simulation.scene import Scene

# A pair further apart than this (mm), and than this number of medians, is not of one surface point: a column at a depth
# edge that saw the other side.
_SAME_POINT_MM, _MEDIANS = 2.0, 3.0


@dataclass(frozen=True)
class PairErrors:
    """Errors of the points of an organised cloud against the true ones of the same frames and columns.

    Attributes:
        to_true_point: RMS distance from the true point of the same frame and column, of those within 2 mm of it or, in
            a cloud that is off as a whole, within three times the median.
        to_true_point_after_fit: the same after that motion.
        far_points: points further than that from the true point of their frame and column.
        completeness: share of the frame-columns in which an ideal camera sees the sheet that have a point.
    """

    to_true_point: float
    to_true_point_after_fit: float
    far_points: int
    completeness: float

    def as_dict(self) -> dict[str, float]:
        """The figures by name."""
        return asdict(self)


@dataclass(frozen=True)
class CloudErrors(PairErrors):
    """The same, and how far the points are from the true surface, mm.

    Attributes:
        absolute: RMS distance of all points from the nearest true surface.
        absolute_after_fit: the same after the rigid motion that fits the points to the true ones best.
    """

    absolute: float
    absolute_after_fit: float


def pair_errors(
    true_points: Float[np.ndarray, "frames columns 3"],
    points: Float[np.ndarray, "frames columns 3"],
    valid: Bool[np.ndarray, "frames columns"],
) -> PairErrors:
    """Compare an organised cloud with its true points.

    Args:
        true_points: of each frame and column, NaN where an ideal camera sees none (mm).
        points: the reconstruction (mm).
        valid: where it has a point.

    Raises:
        InputError: no point is near its true one.
    """
    return _pairs(true_points, points, valid)[0]


def cloud_errors(
    scene: Scene,
    true_points: Float[np.ndarray, "frames columns 3"],
    points: Float[np.ndarray, "frames columns 3"],
    valid: Bool[np.ndarray, "frames columns"],
) -> CloudErrors:
    """Compare an organised cloud with the scene that was scanned.

    Args:
        scene: the scene at motor step 0, in the camera frame.
        true_points: of each frame and column, NaN where an ideal camera sees none (mm).
        points: the reconstruction (mm).
        valid: where it has a point.
    """
    pairs, motion = _pairs(true_points, points, valid)
    points = np.asarray(points[valid], np.float64)
    return CloudErrors(
        **asdict(pairs),
        absolute=_rms(distance(scene, points)),
        absolute_after_fit=_rms(distance(scene, motion.apply(points))),
    )


def _pairs(
    true_points: Float[np.ndarray, "frames columns 3"],
    points: Float[np.ndarray, "frames columns 3"],
    valid: Bool[np.ndarray, "frames columns"],
) -> tuple[PairErrors, Pose]:
    """As `pair_errors`, and the rigid motion that fits the points to the true ones best."""
    points = np.where(valid[..., None], np.asarray(points, np.float64), np.nan)
    near = near_its_true_point(points, true_points)
    if not near.any():
        raise InputError("no point is near the true one of its frame and column: give the truth of this very scan")
    seen = np.all(np.isfinite(true_points), axis=-1)
    pairs = int((valid & seen).sum())
    motion = rigid_fit(points[near], true_points[near])
    errors = PairErrors(
        to_true_point=_rms(np.linalg.norm(points[near] - true_points[near], axis=1)),
        to_true_point_after_fit=_rms(np.linalg.norm(motion.apply(points[near]) - true_points[near], axis=1)),
        far_points=pairs - int(near.sum()),
        completeness=float(pairs / seen.sum()),
    )
    return errors, motion


def near_its_true_point(
    points: Float[np.ndarray, "frames columns 3"], true_points: Float[np.ndarray, "frames columns 3"]
) -> Bool[np.ndarray, "frames columns"]:
    """Which points are of the same surface point as the true one of their frame and column.

    Args:
        points: NaN for none, mm.
        true_points: NaN for none, mm.
    """
    gap = np.linalg.norm(points - true_points, axis=-1)
    pair = np.isfinite(gap)
    limit = max(_SAME_POINT_MM, _MEDIANS * float(np.median(gap[pair]))) if pair.any() else 0.0
    with np.errstate(invalid="ignore"):
        return gap < limit


def rigid_fit(points: Float[np.ndarray, "points 3"], to: Float[np.ndarray, "points 3"]) -> Pose:
    """The rigid motion that carries points to others with the least sum of squares (Kabsch 1976)."""
    a, b = points.mean(axis=0), to.mean(axis=0)
    U, _, Vt = np.linalg.svd((to - b).T @ (points - a))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Pose.from_matrix(R, b - R @ a)


def _rms(values: Float[np.ndarray, "values"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
