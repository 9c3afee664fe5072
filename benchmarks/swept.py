"""A light that sweeps: points in σ, lights that a mirror turns off its axis, and scans of photographs.

The sessions are drawn: eight boards, a stripe at each of seven positions, noise of 0.06 px (stripes) and 0.02 px
(corners). The scans are photographs of a figure with speckle of contrast 0.2, by the simulated rig with a sweep and by
the same rig with its stage: the same boards, light and sensor.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.drawn import Noise, project, redrawn
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, Observations, StripePoints, View, calibrate
from jaxscan.calibration.observe import observe
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.files.session_sweeps import AXIS
from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.reconstruction.point_sigma import ray_jacobian, sigma_of
from jaxscan.rig import LightPlane, Rig, SweptSheet
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import ScanTruth, simulate_scan, simulate_session
from jaxscan.simulation.shapes import figure
from jaxscan.simulation.swept import MIDDLE, STRIPES, SWEEP, in_the_middle, simulate_swept_session, sweep_of, with_sweep

_SEEDS, _FEW = 12, 4
_SCANS, _ONE = 4, 1
_VIEWS: Final = 8
_FAR_MM: Final = 2.0
# How far the light goes to either side of its middle, degrees.
_SWEEPS: Final = {"short": 2.0, "usual": 6.0, "long": 15.0}
# How far a mirror's surface is off its axis, mm, and the angle of incidence in the middle, degrees.
_OFF_AXIS_MM, _INCIDENCE = 3.0, 45.0


def measure(quick: bool) -> list[Metric]:
    """Sessions of twelve seeds and scans of four; or of a few."""
    seeds, metrics = range(_FEW if quick else _SEEDS), []
    for name, degrees in _SWEEPS.items():
        metrics += _in_sigma(name, degrees, seeds)
    metrics.append(_mirror(range(2 if quick else 8)))
    return metrics + _scans(range(_ONE if quick else _SCANS))


def _in_sigma(name: str, degrees: float, seeds: range) -> list[Metric]:
    """Errors of points that the rig makes of true pixels, over the sweep, in the σ that it gives them."""
    squares, errors = [], []
    for seed in seeds:
        rig = _wider(with_sweep(rig_2003.simulated_rig(seed), seed), degrees)
        result = calibrate(redrawn(_session(rig, seed), Noise(), np.random.default_rng([73, seed])), light="swept")
        off, sigma = _points_off(result, rig)
        squares.append(np.mean((off / sigma) ** 2))
        errors.append(np.mean(off**2))
    z, rms = (float(np.sqrt(np.mean(each))) for each in (squares, errors))
    print(f"  {name}: points {1e3 * rms:.1f} um, {z:.3f} sigma", flush=True)
    return [
        Metric(f"swept.{name}.z_off_1", abs(z - 1), "", "lower", 0.25, floor=0.15),
        Metric(f"swept.{name}.points_mm", rms, "mm", "lower", floor=0.002),
    ]


def _points_off(result: Calibration, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """How far points are off along their rays, and what the rig says of it, mm: of pixels that see middle depths."""
    random, light = np.random.default_rng(0), rig.lights[0]
    assert isinstance(light, SweptSheet)
    X = [_on(light.at(np.float64(n)), random) for n in sweep_of(STRIPES)]
    steps = np.repeat(sweep_of(STRIPES).astype(float), [len(each) for each in X])
    pixels = project(rig.camera, np.concatenate(X))
    inside = ((pixels > 0) & (pixels < np.array(rig.camera.image_size) - 1)).all(axis=1)
    pixels, true, q = pixels[inside], np.concatenate(X)[inside], {AXIS: steps[inside]}
    sigma, _ = sigma_of(result.rig, result.covariance, 0.0, *ray_jacobian(result.rig, "", pixels, q, columns=True))
    with float64():
        found = np.asarray(as_float64(result.rig).triangulate(jnp.asarray(pixels), q))
    return ((found - true) * true).sum(axis=1) / np.linalg.norm(true, axis=1), sigma


def _wider(rig: Rig, degrees: float) -> Rig:
    """The rig with a light that sweeps so far to either side in the usual steps."""
    light = rig.lights[0]
    assert isinstance(light, SweptSheet)
    by = degrees / light.amount(SWEEP / 2)[0]
    turn = tuple(np.asarray(by * float(leaf)) for leaf in light.per_step)
    a, b, c = turn
    return Rig(rig.camera, (SweptSheet(light.plane, (a, b, c), light.centre, light.middle),))


def _session(rig: Rig, seed: int) -> Observations:
    """What an ideal detector sees of the boards."""
    poses, views = rig_2003.board_poses(rig, seed, _VIEWS), []
    light = rig.lights[0]
    assert isinstance(light, SweptSheet)
    for i in range(_VIEWS):
        pose = Pose(np.asarray(poses.rotation[i], np.float64), np.asarray(poses.translation[i], np.float64))
        stripes = []
        for n in sweep_of(STRIPES).tolist():
            pixels = _on_board(rig, pose, np.array([float(leaf) for leaf in light.at(np.float64(n)).plane]))
            stripes.append(StripePoints(pixels, half_width_px=1e-6, position=float(n)))
        corners = project(rig.camera, pose.apply(rig_2003.BOARD.points()))
        views.append(View(f"{i:02d}", corners, stripes=tuple(stripes)))
    size = rig.camera.image_size
    return Observations(size, rig_2003.BOARD, tuple(views), lasers=("",), light_axes={"": AXIS})


def _on_board(rig: Rig, pose: Pose[np.ndarray], omega: np.ndarray) -> np.ndarray:
    """Where a plane crosses a board's pattern: the row in every fourth column, NaN for none."""
    R, t = pose.matrix(), pose.translation
    a, extent = omega @ R[:, :2], rig_2003.BOARD.points()[:, :2].max(axis=0)
    start, along = a * (1 - omega @ t) / (a @ a), np.array([-a[1], a[0]]) / np.hypot(*a)
    at = start + np.linspace(-300.0, 300.0, 6001)[:, None] * along
    at = at[((at >= 0) & (at <= extent)).all(axis=1)]
    columns = np.arange(0.0, rig.camera.image_size[0], 4.0)
    if len(at) < 4:
        return np.full((len(columns), 2), np.nan)
    u, v = project(rig.camera, at @ R[:, :2].T + t).T
    order = np.argsort(u)
    rows = CubicSpline(u[order], v[order], extrapolate=False)(columns)
    return np.stack([np.where(np.isfinite(rows), columns, np.nan), rows], axis=-1)


def _on(plane: LightPlane, random: np.random.Generator) -> np.ndarray:
    """Points of a plane in the working volume, camera frame, mm."""
    a, b, c = (float(leaf) for leaf in plane.plane)
    X = random.uniform([-60.0, 0.0, 300.0], [60.0, 0.0, 400.0], (200, 3))
    X[:, 1] = (1 - a * X[:, 0] - c * X[:, 2]) / b
    return X


def _mirror(seeds: range) -> Metric:
    """The sheet's error by the model alone: no noise, a mirror whose surface is off the axis that it turns about."""
    worst = 0.0
    for seed in seeds:
        true = with_sweep(rig_2003.simulated_rig(seed), seed).lights[0]
        assert isinstance(true, SweptSheet)
        random, steps, points = np.random.default_rng(seed), sweep_of(STRIPES), []
        for n in steps:
            points.append(_on(_by_mirror(true, float(n)), random))
        view = np.zeros(sum(map(len, points)), int)
        at = np.repeat(steps.astype(float), [len(each) for each in points])
        fitted = SweptSheet.fitted(np.concatenate(points), view, "", at, AXIS)
        for n, X in zip(steps, points, strict=True):
            plane = fitted.at(np.float64(n))
            worst = max(worst, float(np.abs(plane.level(X) / np.linalg.norm(plane.gradient(X), axis=1)).max()))
    print(f"  mirror {_OFF_AXIS_MM:g} mm off its axis: {1e3 * worst:.2f} um at most", flush=True)
    return Metric("swept.mirror_off_axis.sheet_mm", worst, "mm", "lower", 0.005, floor=0.001)


def _by_mirror(light: SweptSheet, n: float) -> LightPlane:
    """The plane of a light that is turned by a mirror, whose surface is off the axis, at half the light's angle.

    Reflected in the mirror m · (x − c) = e the plane is moved by 2 e m over one whose mirror holds the axis.
    """
    plane, axis = light.at(np.float64(n)), light.direction()
    normal = np.array([float(leaf) for leaf in plane.plane])
    middle = np.array([float(leaf) for leaf in light.plane])
    half = float(np.radians(light.amount(1.0)[0])) * (n - MIDDLE) / 2
    face = vector_to_matrix((np.radians(_INCIDENCE) + half) * axis) @ (middle / np.linalg.norm(middle))
    distance = 1 / np.linalg.norm(normal) + 2 * _OFF_AXIS_MM * face @ normal / np.linalg.norm(normal)
    with float64():
        return as_numpy(LightPlane.create(normal / np.linalg.norm(normal) / distance))


def _scans(seeds: range) -> list[Metric]:
    """Scans of a figure by photographs: errors along the ray, how many lie within their σ, and over a stage's."""
    within, ratios, rms = [], [], []
    for seed in seeds:
        errors, sigma = _scan(seed, swept=True)
        within.append([np.mean(np.abs(errors) < k * sigma) for k in (1, 2, 3)])
        rms.append(np.sqrt(np.mean(errors**2)))
        other, of_stage = _scan(seed, swept=False)
        # Points of the two are not equally far away: each in the σ that a perfect rig would have.
        ratios.append(np.sqrt(np.mean((errors / sigma) ** 2)) / np.sqrt(np.mean((other / of_stage) ** 2)))
    goals = ((0.62, 0.93, 0.98), np.mean(within, axis=0))
    metrics = [
        Metric(f"swept.scan.within_{k}_sigma", float(share), "", "higher", goal, floor=0.02)
        for k, goal, share in zip((1, 2, 3), *goals, strict=True)
    ]
    metrics.append(Metric("swept.scan.along_the_ray_mm", float(np.sqrt(np.mean(np.square(rms)))), "mm"))
    metrics.append(Metric("swept.scan.z_over_a_stages", float(np.mean(ratios))))
    print("  scans: " + ", ".join(f"{m.name.split('.')[-1]} {m.value:.3g}" for m in metrics), flush=True)
    return metrics


def _scan(seed: int, *, swept: bool) -> tuple[np.ndarray, np.ndarray]:
    plain = rig_2003.simulated_rig(seed)
    rig, scene = with_sweep(plain, seed) if swept else plain, rig_2003.scan_scene(plain, figure(rig_2003.OBJECT_Y))
    with TemporaryDirectory() as name:
        folder = Path(name)
        if swept:
            simulate_swept_session(folder / "session", seed, rig)
            axes = {AXIS: sweep_of(rig_2003.SCAN_FRAMES).tolist()}
            truth = simulate_scan(folder / "scan", rig, in_the_middle(plain, scene), seed, axes=axes)
        else:
            simulate_session(folder / "session", seed, rig=rig)
            truth = simulate_scan(folder / "scan", rig, scene, seed)
        session = read_session(folder / "session")
        result = calibrate(observe(session), light=session.sheets or LightPlane.kind)
        image = reconstruct(result.rig_file(), read_scan(folder / "scan"))
    return _along_rays(image.points, image.cameras(), truth, image.sigma)


def _along_rays(
    points: np.ndarray, cameras: np.ndarray, truth: ScanTruth, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Errors along the rays, and their σ, of points that are not on another surface, mm."""
    rays = points - cameras[:, None]
    errors = ((points - truth.points) * rays / np.linalg.norm(rays, axis=-1, keepdims=True)).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        near = np.isfinite(errors) & (np.abs(errors) < _FAR_MM)
    return errors[near], sigma[near]
