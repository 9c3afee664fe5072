"""Eight views of a figure, 45° apart, joined into one surface.

The figure is turned by hand on the platform of the simulated rig of 2003: by 45° and up to 5° more or less, and shifted
by up to 3 mm. It is scanned every millimetre with the true rig: the stripe drawn with a noise of 0.03 px where an
ideal camera sees it, and in the long form from rendered photographs too. The angles that the registration is told are
wrong by up to 10°.

- `pose_off`, `turn_off`: the largest error of the eight poses, at the figure's middle. Photographs have an error that
  is none of the registration's: where every scan is shifted alike in its own frame by d, the pose of one turned by R is
  off by d − R d. `common_shift` is that d, and `pose_off_beside_it` what is left.
- `chained`: the same of seven pairs registered one by one by our own residual and weights, and chained.
- `joint_over_…`: the root mean square error of all poses, at a distance of 20 mm from the middle, rotation and
  translation together, over 6 draws of the noise (2 in the short form), over that of seven pairs chained: registered by
  point-to-plane ICP and by GICP (both of small_gicp, started from the truth, with the best of three reaches), and by
  our own residual and weights.
- `closure`: how far the points of the first view are apart, RMS, after the whole loop: 7 poses and the pair of the last
  and the first.
- `predicted`: mean of errorᵀ covariance⁻¹ error for each of the 42 numbers, over the same draws: 1 if σ is honest.
- `merged_over_single`: RMS over the vertices of error · √N over the RMS error of the single scans' points next to the
  vertex, N the scans there; without the 2 % largest of both, which lie on edges of the figure.
- `covered`: part of the points of all scans, none of a scan's rim, that lie within half a millimetre of the mesh.
"""

import tempfile
import time
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import small_gicp
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks.metric import Metric
from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan
from jaxscan.geometry import Pose
from jaxscan.geometry.closest import ClosestOnTriangles
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.rig import Rig
from jaxscan.simulation import Scene, distance, rig_2003
from jaxscan.simulation.drawn import drawn_scan, noisy_scan
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.shapes import figure
from jaxscan.surface.coarse_register import coarse_register
from jaxscan.surface.merged import Merged, merge, merge_closed
from jaxscan.surface.register import Registration, moved_apart, register
from jaxscan.surface.side import Side, side_of_image

VIEWS: Final = 8
_STEPS = np.arange(0, 74_000, 1000)
_STRIPE_PX: Final = 0.03
_ARM_MM: Final = 20.0
_COVERED_MM: Final = 0.5
_EDGES: Final = 98.0


def measure(quick: bool) -> list[Metric]:
    """Drawn, and in the long form photographed."""
    rig = rig_2003.simulated_rig(0)
    scenes, truth = turned(rig)
    drawn = [drawn_scan(rig, scene, {"stage": _STEPS}, _STRIPE_PX, k) for k, scene in enumerate(scenes)]
    metrics = joined("merge.drawn", sides_of(scan.image for scan in drawn), truth, scenes[0])
    off, chained, predicted = [], {how: [] for how in CHAINS}, []
    for seed in range(2 if quick else 6):
        noisy = [
            noisy_scan(rig, scan.position, {"stage": _STEPS}, _STRIPE_PX, 8 * seed + k) for k, scan in enumerate(drawn)
        ]
        sides = sides_of(noisy)
        found = register(sides, truth)
        off.append(errors(found.poses, truth, found.centre))
        for how, pair in CHAINS.items():
            chained[how].append(errors(chain(sides, truth, pair), truth, found.centre))
        vector = off[-1][1:].ravel()
        predicted.append(vector @ np.linalg.solve(found.covariance, vector) / len(vector))
    joint = _at_arm(np.concatenate(off))
    alone = {how: _at_arm(np.concatenate(each)) for how, each in chained.items()}
    point_to_plane, gicp = (min(v for how, v in alone.items() if how.startswith(name)) for name in ("PLANE", "GICP"))
    metrics += [
        Metric("merge.drawn.joint_over_icp", joint / point_to_plane, "", "lower", 0.5, slack=0.2),
        Metric("merge.drawn.joint_over_gicp", joint / gicp),
        Metric("merge.drawn.joint_over_chained", joint / alone[OWN], "", "lower", slack=0.2),
        Metric("merge.drawn.predicted", float(np.mean(predicted)), "", "lower", slack=0.3),
    ]
    if not quick:
        images = [photographed(rig, scene, k) for k, scene in enumerate(scenes)]
        metrics += joined("merge.photographed", sides_of(images), truth, scenes[0])
    return metrics


def turned(rig: Rig) -> tuple[list[Scene], list[Pose]]:
    """What each view saw, and T_first_side of each."""
    R, origin = rig_2003.platform(rig)
    random = np.random.default_rng(5)
    middle = np.array([0.0, rig_2003.OBJECT_Y, 0.0])
    scenes, truth = [], []
    for k in range(VIEWS):
        degrees = 45.0 * k + (random.uniform(-5, 5) if k else 0.0)
        shift = np.array([*random.uniform(-3, 3, 2), 0.0]) if k else np.zeros(3)
        turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        t = middle - turn @ middle + shift
        bodies = rig_2003.turned(figure(rig_2003.OBJECT_Y), degrees)
        scenes.append(rig_2003.scan_scene(rig, [body.moved(np.eye(3), shift) for body in bodies]))
        T = R @ turn.T @ R.T
        truth.append(Pose.from_matrix(T, origin - T @ origin - R @ turn.T @ t))
    return scenes, truth


def sides_of(images: Iterable[RangeImage]) -> list[Side]:
    """What stands on the floor."""
    return [side_of_image(f"view {k}", image) for k, image in enumerate(images)]


# Two sides and a start, to T_first_second.
Pair = Callable[[Side, Side, Pose], Pose]


def own_pair(a: Side, b: Side, start: Pose) -> Pose:
    """Registration by our own residual and weights."""
    return register((a, b), (Pose.identity(), start)).poses[1]


def peers_pair(kind: str, reach_mm: float) -> Pair:
    """Registration by small_gicp."""

    def pair(a: Side, b: Side, start: Pose) -> Pose:
        clouds = [small_gicp.PointCloud(side.points) for side in (a, b)]
        for cloud in clouds:
            small_gicp.estimate_normals_covariances(cloud)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = start.matrix(), start.translation
        found = small_gicp.align(
            *clouds,
            init_T_target_source=T,
            registration_type=kind,
            max_correspondence_distance=reach_mm,
            max_iterations=200,
            rotation_epsilon=1e-6,
            translation_epsilon=1e-6,
        ).T_target_source
        return Pose.from_matrix(found[:3, :3], found[:3, 3])

    return pair


OWN: Final = "our own"
CHAINS: Final[dict[str, Pair]] = {OWN: own_pair} | {
    f"{kind} {reach:g}": peers_pair(kind, reach) for kind in ("PLANE_ICP", "GICP") for reach in (0.5, 1.0, 2.0)
}


def chain(sides: list[Side], truth: list[Pose], pair: Pair = own_pair) -> list[Pose]:
    """Poses from pairs alone, one after the other from the true starts."""
    poses = [Pose.identity()]
    for a, b in pairwise(range(VIEWS)):
        poses.append(poses[-1] @ pair(sides[a], sides[b], truth[a].inverse() @ truth[b]))
    return poses


def photographed(rig: Rig, scene: Scene, seed: int) -> RangeImage:
    """Rendered, and reconstructed with the true rig."""
    with tempfile.TemporaryDirectory() as folder:
        apart = int(_STEPS[1] - _STEPS[0])
        simulate_scan(Path(folder), rig, scene, seed, frames=len(_STEPS), steps_apart=apart)
        return reconstruct(rig, read_scan(Path(folder)))


def joined(stem: str, sides: list[Side], truth: list[Pose], scene: Scene) -> list[Metric]:
    """Registered from wrong angles and from none, chained, merged."""
    told = [45.0 * k + wrong for k, wrong in enumerate(np.random.default_rng(0).uniform(-10, 10, VIEWS))]
    begin = time.perf_counter()
    found = register(sides, coarse_register(sides, told))
    seconds = time.perf_counter() - begin
    chained, last = chain(sides, truth), own_pair(sides[-1], sides[0], truth[-1].inverse())
    off, off_chained = errors(found.poses, truth, found.centre), errors(chained, truth, found.centre)
    shift, beside = common_shift(off, truth)
    metrics = [
        Metric(f"{stem}.pose_off", _largest(off[:, 3:]), "mm", "lower", 0.05, floor=0.003),
        Metric(f"{stem}.turn_off", float(np.degrees(_largest(off[:, :3]))), "°", "lower", 0.05, floor=0.005),
        Metric(f"{stem}.common_shift", float(np.linalg.norm(shift)), "mm"),
        Metric(f"{stem}.pose_off_beside_it", _largest(beside), "mm"),
        Metric(f"{stem}.closure", moved_apart(sides[0], found.poses[-1] @ last, Pose.identity()), "mm", "lower", 0.05),
        Metric(f"{stem}.chained.closure", moved_apart(sides[0], chained[-1] @ last, Pose.identity()), "mm"),
        Metric(f"{stem}.chained.pose_off", _largest(off_chained[:, 3:]), "mm"),
        Metric(f"{stem}.chained.turn_off", float(np.degrees(_largest(off_chained[:, :3]))), "°"),
        Metric(f"{stem}.residual_in_sigma", float(np.sqrt(found.variance))),
        Metric(f"{stem}.pairs", float(len(found.pairs))),
        Metric(f"{stem}.register_seconds", seconds, "s"),
    ]
    return metrics + by_features(stem, sides, found) + surface(stem, sides, found, truth, scene)


def by_features(stem: str, sides: list[Side], found: Registration) -> list[Metric]:
    """How far the poses that features lead to are from those that the angles led to."""
    try:
        again = register(sides, coarse_register(sides))
    except InputError as error:
        print(f"  {error}")
        return []
    apart = max(moved_apart(s, T, U) for s, T, U in zip(sides, found.poses, again.poses, strict=True))
    return [Metric(f"{stem}.features_apart_from_angles", apart, "mm", "lower", 0.01)]


def surface(stem: str, sides: list[Side], found: Registration, truth: list[Pose], scene: Scene) -> list[Metric]:
    """The merged surface against the truth, and against single scans in their true poses."""
    begin = time.perf_counter()
    merged = merge(sides, found.poses)
    seconds = time.perf_counter() - begin
    closed = merge_closed(sides, found.poses)
    single = [np.abs(distance(scene, T.apply(s.points))) for s, T in zip(sides, truth, strict=True)]
    points = np.concatenate([T.apply(s.points)[~s.rim] for s, T in zip(sides, found.poses, strict=True)])
    near, _ = ClosestOnTriangles(np.asarray(merged.mesh.triangles))(points)
    covered = np.linalg.norm(near - points, axis=1) < _COVERED_MM
    alone = single_noise(merged, sides, truth, single)
    error = np.abs(distance(scene, np.asarray(merged.mesh.vertices)))
    ratio = _rms(_trimmed(error * np.sqrt(merged.sides))) / _rms(_trimmed(alone))
    return [
        Metric(f"{stem}.merged_over_single", ratio, "", "lower", 1.2, floor=0.05),
        Metric(f"{stem}.merged_rms", _rms(_trimmed(error)), "mm", "lower", floor=0.002),
        Metric(f"{stem}.merged_rms_with_its_edges", _rms(error), "mm"),
        Metric(f"{stem}.single_rms", _rms(_trimmed(alone)), "mm"),
        Metric(f"{stem}.sides_in_the_mean", float(merged.sides.mean())),
        Metric(f"{stem}.covered", float(covered.mean()), "", "higher", 0.99, floor=0.003),
        Metric(f"{stem}.closed_is_watertight", float(closed.mesh.is_watertight), "", "higher", 1.0),
        Metric(f"{stem}.merge_seconds", seconds, "s"),
    ]


def single_noise(
    merged: Merged, sides: list[Side], truth: list[Pose], single: list[Float[np.ndarray, "points"]]
) -> Float[np.ndarray, "errors"]:
    """The errors of the single scans' points that are nearest to each vertex."""
    errors = []
    for side, T, error in zip(sides, truth, single, strict=True):
        away, index = KDTree(T.apply(side.points)).query(merged.mesh.vertices)
        errors.append(error[np.asarray(index)[away < side.spacing_mm]])
    return np.concatenate(errors)


def errors(
    poses: tuple[Pose, ...] | list[Pose], truth: list[Pose], centre: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "sides 6"]:
    """The small motion from each true pose to the one found: rotation (radians) about the centre, translation (mm)."""
    found = []
    for T, true in zip(poses, truth, strict=True):
        apart = T @ true.inverse()
        found.append(np.concatenate([apart.rotation, apart.apply(centre) - centre]))
    return np.stack(found)


def common_shift(
    off: Float[np.ndarray, "sides 6"], truth: list[Pose]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "sides 3"]]:
    """The shift of every scan in its own frame that explains most of the poses' errors, and what it leaves."""
    A = np.concatenate([np.eye(3) - T.matrix() for T in truth])
    shift = np.linalg.lstsq(A, off[:, 3:].ravel(), rcond=1e-6)[0]
    return shift, off[:, 3:] - (A @ shift).reshape(-1, 3)


def _at_arm(off: Float[np.ndarray, "sides 6"]) -> float:
    return float(np.sqrt(((_ARM_MM * off[:, :3]) ** 2 + off[:, 3:] ** 2).sum(axis=1).mean()))


def _largest(vectors: Float[np.ndarray, "sides 3"]) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def _trimmed(values: Float[np.ndarray, "values"]) -> Float[np.ndarray, "values"]:
    return values[values <= np.percentile(values, _EDGES)]


def _rms(values: Float[np.ndarray, "values"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
