"""Sensors that are tilted against their lens: points of the rigs that come of them over an upright one's, σ, and cost.

Sessions of the rig of 2003 as a detector would have seen them with errors of 0.03 px for corners and of 0.1 px for
stripes, without photographs; pixels are OpenCV's, of 14 coefficients. A rig is judged by points of stripes, with the
same errors, on boards that it has not seen.

Of a pinhole a tilt can be told from the other numbers but for one direction, along which the camera's frame turns and
nothing else changes; only the lens's errors say where the axis is. So points are compared as they are, and with the
rotation about the camera's centre taken out that fits them best to the true ones: the shape of what is scanned.
"""

from dataclasses import dataclass, replace
from typing import Final

import jax
import numpy as np
from jaxtyping import Float

from benchmarks.drawn_bent import projected_by_opencv
from benchmarks.metric import Metric
from benchmarks.throughput import kernel_beside_the_plain
from jaxscan.calibration import Calibration, Observations, StripePoints, View, calibrate
from jaxscan.rig import Rig
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.render import plane_of

_CORNER_PX: Final = 0.03
_STRIPE_PX: Final = 0.1
_VIEWS: Final = 12
_SEEDS, _FEW = 24, 3
# Beside the longest stripe of a board, mm; and places along it.
_BEYOND, _ALONG = 1.5, 2000


@dataclass(frozen=True)
class _Found:
    """What came of one session.

    Attributes:
        squares: mean squared error of points on other boards, as they are and as turned, mm².
        z: of all numbers.
    """

    squares: tuple[float, float]
    z: Float[np.ndarray, "numbers"]


def measure(quick: bool) -> list[Metric]:
    """Twenty-four sessions of each tilt, or three."""
    seeds = range(_FEW if quick else _SEEDS)
    flat = [_session(seed, 0.0) for seed in seeds]
    upright = [_judged(rig, calibrate(seen), seed) for seed, (rig, seen) in zip(seeds, flat, strict=True)]
    base, shape = _rms(upright)
    metrics = [Metric("sensors.agreement_px", _agreement(), "px", "lower", 1e-9, floor=1e-9)]
    metrics += [Metric("sensors.upright.error_mm", base, "mm"), Metric("sensors.upright.shape_mm", shape, "mm")]
    metrics.append(_z("upright", upright))
    for degrees in (0.0, 3.0, 10.0):
        drawn = [_session(seed, degrees) for seed in seeds]
        found = [
            _judged(rig, calibrate(seen, tilted=True), seed) for seed, (rig, seen) in zip(seeds, drawn, strict=True)
        ]
        name = f"{degrees:.0f}_deg"
        metrics += [
            Metric(f"sensors.{name}.points_over_upright", _rms(found)[0] / base, "", "lower", slack=0.05),
            Metric(f"sensors.{name}.shape_over_upright", _rms(found)[1] / shape, "", "lower", 1.15, slack=0.05),
            _z(name, found),
        ]
        if degrees:
            as_upright = [_judged(rig, calibrate(seen), seed) for seed, (rig, seen) in zip(seeds, drawn, strict=True)]
            metrics.append(Metric(f"sensors.{name}.taken_as_upright", _rms(as_upright)[1] / shape))
        print(f"  {name}: {', '.join(f'{m.value:.4g}' for m in metrics[-4:])}", flush=True)
    return metrics + kernel_beside_the_plain("sensors.kernel", "an upright one's", 0.7, quick, tilt=(0.12, -0.12))


def _rms(found: list[_Found]) -> tuple[float, float]:
    as_they_are, turned = np.sqrt(np.mean([each.squares for each in found], axis=0))
    return float(as_they_are), float(turned)


def _z(name: str, found: list[_Found]) -> Metric:
    """RMS of all numbers' errors in their σ."""
    z = np.stack([each.z for each in found])
    print(f"  {name}: z by number {np.round(np.sqrt((z**2).mean(axis=0)), 2)}", flush=True)
    return Metric(f"sensors.{name}.z_rms", float(np.sqrt((z**2).mean())), "", "lower", 1.1, slack=0.05)


def _rig(seed: int, degrees: float) -> Rig:
    """The rig of a seed, its sensor tilted by so much about an axis that the seed draws."""
    rig = rig_2003.simulated_rig(seed)
    if not degrees:
        return rig
    about = np.random.default_rng([19, seed]).uniform(0, 2 * np.pi)
    tilt = np.radians(degrees) * np.array([np.cos(about), np.sin(about)])
    return replace(rig, camera=replace(rig.camera, tilt=tuple(tilt)))


def _agreement() -> float:
    """The largest distance from OpenCV's pixels, px."""
    worst = 0.0
    for seed in range(_FEW):
        rig = _rig(seed, 10.0)
        X = np.random.default_rng(seed).uniform([-100, -80, 300], [100, 80, 400], (1000, 3))
        worst = max(worst, float(np.abs(project_points(rig.camera, X).pixels - projected_by_opencv(rig, X)).max()))
    return worst


def _session(seed: int, degrees: float) -> tuple[Rig, Observations]:
    rig, random, views = _rig(seed, degrees), np.random.default_rng([18, seed]), []
    poses = rig_2003.board_poses(rig, seed, _VIEWS)
    for i, (R, t) in enumerate(zip(poses.matrix(), poses.translation, strict=True)):
        pixels, _ = _stripe(rig, R, np.asarray(t), random)
        corners = projected_by_opencv(rig, rig_2003.BOARD.points() @ R.T + t)
        corners = corners + _CORNER_PX * random.normal(size=corners.shape)
        views.append(View(f"{i:02d}", corners, stripes=(StripePoints(pixels, half_width_px=1e-6),)))
    return rig, Observations(rig.camera.image_size, rig_2003.BOARD, tuple(views), (), ("",))


def _stripe(
    rig: Rig, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"], random: np.random.Generator
) -> tuple[Float[np.ndarray, "columns 2"], Float[np.ndarray, "columns 3"]]:
    """Where the stripe on a board is seen, with errors, and the true points; NaN where it is not."""
    board, size, omega = rig_2003.BOARD, rig.camera.image_size, plane_of(rig.lights[0])
    low, high = (
        bound[:2] + sign * board.pitch_mm
        for bound, sign in ((board.points().min(axis=0), -1), (board.points().max(axis=0), 1))
    )
    # The line a · (x, y) = 1 − ω · t of the board.
    a = omega @ R[:, :2]
    along = np.array([-a[1], a[0]]) / np.hypot(*a)
    middle = (low + high) / 2
    start = middle + a * (1 - omega @ t - a @ middle) / (a @ a)
    s = np.linspace(-1, 1, _ALONG) * _BEYOND * np.hypot(*(high - low)) / 2
    xy = start + s[:, None] * along
    xy = xy[((xy > low) & (xy < high)).all(axis=1)]
    X = xy @ R[:, :2].T + t
    seen = projected_by_opencv(rig, X)
    order, columns = np.argsort(seen[:, 0]), np.arange(float(size[0]))
    rows, *truth = (
        np.interp(columns, seen[order, 0], part[order], left=np.nan, right=np.nan) for part in (seen[:, 1], *X.T)
    )
    rows = np.where((rows < 0) | (rows > size[1] - 1), np.nan, rows) + _STRIPE_PX * random.normal(size=size[0])
    return np.stack([columns, rows], axis=1), np.stack(truth, axis=1)


def _judged(rig: Rig, found: Calibration, seed: int) -> _Found:
    """Against the true rig."""
    random = np.random.default_rng(81)
    poses = rig_2003.board_poses(rig, 1000 + seed, 2 * _VIEWS)
    stripes = [_stripe(rig, R, np.asarray(t), random) for R, t in zip(poses.matrix(), poses.translation, strict=True)]
    pixels, truth = (np.concatenate(parts) for parts in zip(*stripes, strict=True))
    there = np.isfinite(pixels).all(axis=1)
    rays = pixel_rays(found.rig.camera, pixels[there])
    points = rays / found.rig.lights[0].inverse_depth(rays)[:, None]
    U, _, Vt = np.linalg.svd(points.T @ truth[there])
    turned = points @ (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt)
    as_they_are, shape = (float(((X - truth[there]) ** 2).sum(axis=1).mean()) for X in (points, turned))
    true = {**_values(rig), **({} if rig.camera.tilt else {"camera.tilt.0": 0.0, "camera.tilt.1": 0.0})}
    own = _values(found.rig)
    names = [name for name in found.covariance.names if not name.startswith("motion")]
    return _Found(
        (as_they_are, shape), np.array([(own[n] - true[n]) / (found.covariance.sigma(n) or np.nan) for n in names])
    )


def _values(rig: Rig) -> dict[str, float]:
    return dict(zip(parameter_names(rig), map(float, jax.tree.leaves(rig)), strict=True))
