"""Real photographs and reference problems with published answers; nothing to do where JAXSCAN_DATA is not set."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float

from benchmarks.calibration_rs import calibration_rs
from benchmarks.metric import Metric
from benchmarks.sub_pix import with_sub_pix
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.calibration.observe import observe
from jaxscan.calibration.on_board import stripe_points_in_space
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.geometry import Pose
from jaxscan.images import Board
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.rig import Camera
from jaxscan.rig.light import distance

# Of the photographs opencv-left, by OpenCV's tutorial.
_TUTORIAL = {"focal_u": 532.795, "focal_v": 532.919, "principal_u": 342.458, "principal_v": 233.901}
# Where the board of the etna photographs is taken to reach, mm of its own frame.
_ETNA_REGION = np.array([[-20.0, 80.0], [-15.0, 65.0]])


def measure(quick: bool) -> list[Metric]:
    """Every real data set that is there."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        print("  JAXSCAN_DATA is not set: nothing measured")
        return []
    data = Path(folder)
    if quick:
        return etna(data, ["etna-2"]) + opencv_left(data) + pyramid(data)
    return etna(data, ["etna-2", "etna-3"]) + opencv_left(data) + pyramid(data) + figueroa(data) + calibration_rs(data)


def corners_only(observations: Observations) -> Observations:
    """The same without stripes and stage."""
    views = tuple(replace(view, stripes=()) for view in observations.views)
    return replace(observations, views=views, sequences=(), lasers=())


def opencv_rms(observations: Observations, flags: int) -> tuple[float, np.ndarray]:
    """OpenCV's minimum on the same corners: RMS distance and camera matrix."""
    rms, K, *_ = cv2.calibrateCamera(
        [observations.board.points().astype(np.float32)] * len(observations.views),
        [view.corners.astype(np.float32)[:, None] for view in observations.views],
        observations.image_size,
        None,  # pyright: ignore[reportArgumentType]
        None,  # pyright: ignore[reportArgumentType]
        flags=flags,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-15),
    )
    return rms, K


def in_float32(observations: Observations) -> Observations:
    """Corners as OpenCV takes them, rounded and of equal weight, without those views in which some were not found."""
    views = tuple(
        replace(view, corners=view.corners.astype(np.float32).astype(np.float64), weights=None)
        for view in observations.views
        if np.isfinite(view.corners).all()
    )
    return replace(observations, views=views)


def etna(data: Path, names: list[str]) -> list[Metric]:
    """Board and saturated stripe in the same photographs, two sessions of one rig."""
    limits_mm = {"etna-2": 0.10, "etna-3": 0.30}
    metrics, rigs = [], []
    for name in names:
        session = read_session(data / name)
        observations = observe(session)
        alone = in_float32(corners_only(observations))
        least = calibrate(alone, lens="radial2", plain=True)
        rms, _ = opencv_rms(alone, cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3)
        joint = calibrate(observations, lens="radial2")
        rigs.append(joint)
        joint_rms, least_rms = _same_corners(joint, observations)
        distance, kept, in_region = _stripe_distance(joint, observations)
        metrics += [
            Metric(f"real.{name}.corners_alone_rms", least.corner_rms_px, "px", "lower", slack=0.01),
            Metric(
                f"real.{name}.corners_alone_over_opencv_minus_1",
                abs(least.corner_rms_px / rms - 1),
                "",
                "lower",
                1e-6,
                floor=1e-6,
            ),
            Metric(f"real.{name}.joint_over_corners_alone", joint_rms / least_rms, "", "lower", 1.02, slack=0.01),
            Metric(f"real.{name}.stripe_rms", distance, "mm", "lower", limits_mm[name]),
            Metric(f"real.{name}.stripe_points_kept", kept / in_region, "", "higher", 0.90, slack=0.02),
            Metric(f"real.{name}.focal_u", float(joint.rig.camera.focal[0]), "px"),
            Metric(f"real.{name}.focal_u_sigma", joint.covariance.sigma("camera.focal.0") or 0.0, "px"),
        ]
    return metrics + (_difference(*rigs) if len(rigs) == 2 else [])


def _same_corners(joint: Calibration, observations: Observations) -> tuple[float, float]:
    """RMS distance of the corners that the joint solve kept: in the joint solve, and by corners alone."""
    by_name = {fit.name: fit.corner_kept for fit in joint.fits}
    views = tuple(
        replace(view, corners=np.where(by_name[view.name][:, None], view.corners, np.nan))
        for view in corners_only(observations).views
    )
    alone = calibrate(replace(corners_only(observations), views=views), lens="radial2", plain=True)
    return joint.corner_rms_px, alone.corner_rms_px


def _stripe_distance(joint: Calibration, observations: Observations) -> tuple[float, int, int]:
    """RMS distance (mm) of kept stripe points to the light plane; how many are kept, how many seen in the region."""
    with float64():
        camera = as_float64(joint.rig.camera)
        poses = np.asarray(as_float64(joint.system.boards).as_vector())
        kept_views, kept_in_region, region = [], 0, 0
        for view, fit, pose in zip(observations.views, joint.fits, poses, strict=True):
            R, t = cv2.Rodrigues(pose[:3])[0], pose[3:]
            seen, kept = (
                _in_space(observations, view, pixels, camera, pose)
                for pixels in (view.stripes[0].pixels, fit.stripe_pixels[fit.stripe_kept])
            )
            region += int(_in_region((seen - t) @ R).sum())
            kept_in_region += int(_in_region((kept - t) @ R).sum())
            kept_views.append(kept)
    X = np.concatenate(kept_views)
    return float(np.sqrt((distance(joint.rig.lights[0], X) ** 2).mean())), kept_in_region, region


def _in_region(at: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    return np.all((at[:, :2] > _ETNA_REGION[:, 0]) & (at[:, :2] < _ETNA_REGION[:, 1]), axis=1)


def _in_space(
    observations: Observations, view: View, pixels: Float[np.ndarray, "points 2"], camera: Camera, pose: np.ndarray
) -> Float[np.ndarray, "points 3"]:
    """Stripe pixels of one view on its board, in the camera frame (mm)."""
    stripe = replace(view.stripes[0], pixels=pixels)
    one = replace(observations, views=(replace(view, stripes=(stripe,)),))
    return stripe_points_in_space(one, camera, Pose(pose[None, :3], pose[None, 3:]), 0)[0]


def _difference(a: Calibration, b: Calibration) -> list[Metric]:
    """How far two fits of one rig are apart, in units of their predicted standard deviations."""
    values = [np.array([float(x) for x in jax.tree.leaves(c.rig)]) for c in (a, b)]
    both = a.covariance.matrix + b.covariance.matrix
    difference = values[1] - values[0]
    each = np.abs(difference) / np.sqrt(np.diagonal(both))
    chi2 = float(difference @ np.linalg.solve(both, difference))
    return [
        Metric("real.etna.two_fits_median_difference_in_sigma", float(np.median(each)), "", "lower", 1.0, slack=0.1),
        Metric("real.etna.two_fits_largest_difference_in_sigma", float(each.max()), "", "lower", 3.0, slack=0.1),
        Metric("real.etna.two_fits_chi2_for_each_parameter", chi2 / len(difference), "", "lower", 3.0, slack=0.1),
    ]


def opencv_left(data: Path) -> list[Metric]:
    """OpenCV's sample photographs: its tutorial's answer from the corners that it rests on, and ours from our own."""
    folder = data / "opencv-left"
    session = read_session(folder)
    own = observe(session)
    theirs = with_sub_pix(own, folder)
    metrics = []
    for corners, observations in (("their_corners", theirs), ("own_corners", own)):
        result = calibrate(observations, lens=session.camera.lens, plain=corners != "own_corners")
        metrics.append(Metric(f"real.opencv_left.{corners}.rms", result.corner_rms_px, "px", "lower", slack=0.01))
        for name, published in _TUTORIAL.items():
            axis, i = name.split("_")
            pair = result.rig.camera.focal if axis == "focal" else result.rig.camera.principal
            off = abs(float(pair["uv".index(i)]) - published)
            sigma = result.covariance.sigma(f"camera.{axis}.{'uv'.index(i)}") or np.nan
            figure = f"real.opencv_left.{corners}.{name}_from_published"
            if corners == "their_corners":
                metrics.append(Metric(figure, off, "px", "lower", 0.5, floor=0.05))
            else:
                metrics += [Metric(figure, off, "px"), Metric(f"{figure}_in_sigma", off / sigma, "", "lower", 3.0)]
    return metrics


def figueroa(data: Path) -> list[Metric]:
    """186 views of a large board, mrcal's published optimum, from a start without distortion."""
    arrays = np.load(data / "mrcal-figueroa" / "boards.npz")
    seen = arrays["observations_board"].reshape(-1, 100, 3).astype(np.float64)
    size = (6016, 4016)
    weights = np.maximum(seen[..., 2], 0.0)
    views = tuple(View(f"{i}", x[:, :2], w) for i, (x, w) in enumerate(zip(seen, weights, strict=True)))
    start = Camera.create(size, [2000.0, 2000.0], [(size[0] - 1) / 2, (size[1] - 1) / 2], "rational")
    result = calibrate(
        Observations(size, Board.checkerboard([10, 10], 77.0), views), start=start, board_shape="bulge", plain=True
    )
    errors = [(fit.corner_errors * w[:, None])[fit.corner_kept] for fit, w in zip(result.fits, weights, strict=True)]
    weighted = np.concatenate(errors)
    rms = float(np.sqrt((weighted**2).mean()))
    found = np.array([float(x) for x in (*result.rig.camera.focal, *result.rig.camera.principal)])
    off = np.abs(found - [2073.873, 2077.452, 3004.687, 1997.377])
    return [
        Metric("real.figueroa.weighted_rms", rms, "px", "lower", 0.551279, slack=1e-6),
        Metric("real.figueroa.focal_and_principal_from_published", float(off.max()), "px", "lower", 0.02, floor=0.001),
        Metric("real.figueroa.steps", result.steps),
    ]


def pyramid(data: Path) -> list[Metric]:
    """A printed pyramid, scanned with a rig put together from published figures."""
    image = reconstruct(read_rig(data / "stage-pyramid" / "rig.json"), read_scan(data / "stage-pyramid"))
    far = distance_from_planes(image)
    return [
        Metric("real.pyramid.frames_without_profile", float((~image.valid.any(axis=1)).sum()), "", "lower", 0),
        Metric("real.pyramid.points", float(image.valid.sum()), "", "higher", slack=0.02),
        Metric("real.pyramid.share_further_than_half_a_mm", float((far > 0.5).mean()), "", "lower", 0.01, floor=0.001),
        Metric("real.pyramid.median_distance_from_planes", float(np.median(far)), "mm", "lower"),
    ]


def distance_from_planes(image: RangeImage, count: int = 6) -> Float[np.ndarray, "points"]:
    """Distance of each valid point from the nearest of `count` planes, found one after the other by consensus."""
    points = image.points[image.valid].astype(np.float64)
    rng = np.random.default_rng(0)
    planes: list[tuple[np.ndarray, float]] = []
    left = points
    for _ in range(count):
        if len(left) < 100:
            break
        best, most = None, 0
        for _ in range(400):
            # Three points from one neighbourhood: a face has few of all points.
            near = left[np.argsort(((left - left[rng.integers(len(left))]) ** 2).sum(axis=1))[:600]]
            a, b, c = near[rng.choice(len(near), 3, replace=False)]
            normal = np.cross(b - a, c - a)
            length = np.linalg.norm(normal)
            if length < 1.0:
                continue
            agree = np.abs((left - a) @ (normal / length)) < 0.3
            if agree.sum() > most:
                best, most = agree, int(agree.sum())
        if best is None:
            break
        normal, centre = np.zeros(3), np.zeros(3)
        for _ in range(5):
            centre = left[best].mean(axis=0)
            normal = np.linalg.svd(left[best] - centre, full_matrices=False)[2][2]
            best = np.abs((left - centre) @ normal) < 0.5
        planes.append((normal, float(centre @ normal)))
        left = left[~best]
    return np.min([np.abs(points @ normal - offset) for normal, offset in planes], axis=0)
