"""Sensors that are tilted against their lens: points of the rigs that come of them over an upright one's, σ, and cost.

Sessions of the rig of 2003 as a detector would have seen them with errors of 0.03 px for corners and of 0.1 px for
stripes, without photographs; pixels are OpenCV's, of 14 coefficients. A rig is judged by points of stripes, with the
same errors, on boards that it has not seen.

Of a pinhole a tilt can be told from the other numbers but for one direction, along which the camera's frame turns and
nothing else changes; only the lens's errors say where the axis is. So points are compared as they are, and with the
rotation about the camera's centre taken out that fits them best to the true ones: the shape of what is scanned. Besides
a camera that is tilted and looks at a sheet that is bowed, a circular cone.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import jax
import numpy as np
from jaxtyping import Float

from benchmarks.drawn_bent import projected_by_opencv
from benchmarks.drawn_sheets import Level, cone, plane, triangulated, unseen, view
from benchmarks.metric import Metric
from benchmarks.throughput import kernel_beside_the_plain
from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.rig import LightPlane, Rig
from jaxscan.rig.projection import project_points
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003

_VIEWS: Final = 12
_SEEDS, _FEW = 24, 3


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
    upright = _solved([_session(seed, 0.0) for seed in seeds])
    base, shape = _rms(upright)
    metrics = [Metric("sensors.agreement_px", _agreement(), "px", "lower", 1e-9, floor=1e-9)]
    metrics += [Metric("sensors.upright.error_mm", base, "mm"), Metric("sensors.upright.shape_mm", shape, "mm")]
    metrics.append(_z("upright", upright))
    for degrees, bow_mm in ((0.0, 0.0), (3.0, 0.0), (10.0, 0.0), (10.0, 0.2)):
        drawn = [_session(seed, degrees, bow_mm) for seed in seeds]
        found = _solved(drawn, tilted=True, light="bowed" if bow_mm else LightPlane.kind)
        name = f"{degrees:.0f}_deg" + (f"_bowed_{bow_mm:g}" if bow_mm else "")
        metrics += [
            Metric(f"sensors.{name}.points_over_upright", _rms(found)[0] / base, "", "lower", slack=0.05),
            Metric(f"sensors.{name}.shape_over_upright", _rms(found)[1] / shape, "", "lower", 1.15, slack=0.05),
            _z(name, found),
        ]
        if degrees:
            taken_as = "upright_and_flat" if bow_mm else "upright"
            metrics.append(Metric(f"sensors.{name}.taken_as_{taken_as}", _rms(_solved(drawn))[1] / shape))
        print(f"  {name}: {', '.join(f'{m.value:.4g}' for m in metrics[-4:])}", flush=True)
    return metrics + kernel_beside_the_plain("sensors.kernel", "an upright one's", 0.7, quick, tilt=(0.12, -0.12))


def _solved(drawn: list[tuple[Rig, Level, Observations]], **asked: Any) -> list[_Found]:
    """What comes of sessions, the first of seed 0, calibrated as asked."""
    return [_judged(seed, rig, level, calibrate(seen, **asked)) for seed, (rig, level, seen) in enumerate(drawn)]


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


def _session(seed: int, degrees: float, bow_mm: float = 0.0) -> tuple[Rig, Level, Observations]:
    rig, random = _rig(seed, degrees), np.random.default_rng([18, seed])
    level = cone(rig, bow_mm) if bow_mm else plane(rig)
    poses = rig_2003.board_poses(rig, seed, _VIEWS)
    views = tuple(
        view(f"{i:02d}", rig, R, np.asarray(t), level, random)
        for i, (R, t) in enumerate(zip(poses.matrix(), poses.translation, strict=True))
    )
    return rig, level, Observations(rig.camera.image_size, rig_2003.BOARD, views, (), ("",))


def _judged(seed: int, rig: Rig, level: Level, found: Calibration) -> _Found:
    """Against the true rig; of a sheet that is not flat no numbers are known to be the true ones."""
    pixels, truth = unseen(rig, seed, 2 * _VIEWS, level)
    points = triangulated(found.rig, pixels)
    U, _, Vt = np.linalg.svd(points.T @ truth)
    turned = points @ (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt)
    as_they_are, shape = (float(((X - truth) ** 2).sum(axis=1).mean()) for X in (points, turned))
    true = {**_values(rig), **({} if rig.camera.tilt else {"camera.tilt.0": 0.0, "camera.tilt.1": 0.0})}
    own = _values(found.rig)
    flat = all(light.kind == LightPlane.kind for light in found.rig.lights)
    names = [name for name in found.covariance.names if name.startswith(("camera", "lights") if flat else "camera")]
    return _Found(
        (as_they_are, shape), np.array([(own[n] - true[n]) / (found.covariance.sigma(n) or np.nan) for n in names])
    )


def _values(rig: Rig) -> dict[str, float]:
    return dict(zip(parameter_names(rig), map(float, jax.tree.leaves(rig)), strict=True))
