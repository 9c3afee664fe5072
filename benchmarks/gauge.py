"""A step block puts a light plane right, alone or with the boards: how other blocks, not used for that, then read.

The rig of a seed is calibrated from drawn observations, and a block of 1.48, 3.68, 8.94 and 14.00 mm is scanned,
photograph by photograph, with the true rig, in one place and turned half around. Two other blocks are read: the mean
height of each face over the plane of the floor, the largest error. By

- `boards`: the rig as it was calibrated;
- `boards_and_block`: boards and both scans in one solve;
- `pushed`: the rig with its light plane turned by 1° about a random axis;
- `pushed.block`: that rig refined by one scan, by its covariance;
- `pushed.block_twice`: by both scans;
- `pushed.boards_and_block_twice`: both scans and the photographs of the boards but for their stripes in one solve.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from benchmarks.drawn import Noise, exact_session, redrawn
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, calibrate
from jaxscan.calibration.gauge import refine_by_gauge
from jaxscan.calibration.gauge_points import Gauge, GaugeScan, on_object, stripe_points
from jaxscan.calibration.gauge_shapes import Steps
from jaxscan.files.scan import read_scan
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.rig import LightPlane, Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import ScanTruth, simulate_scan
from jaxscan.simulation.render import plane_of
from jaxscan.simulation.shapes import stair

HEIGHTS = (1.48, 3.68, 8.94, 14.00)
BLOCK = Steps((0.0, *HEIGHTS))
# Other heights, rising the same way, within what the first scan covered; and a taller block, falling the other way,
# which is read where that was not: at the left the gauge had been 1.48 mm high, and now 17 are asked for.
OTHERS = {"other_block": (2.6, 5.1, 7.3, 12.0), "taller_and_reversed": (17.0, 11.5, 6.2, 3.1)}
_TURN = np.radians(1.0)
# What is read keeps this far from the edges of a face, mm.
_INSET = 2.0
_WIDTH, _DEPTH = 120.0, 50.0
# What is to read the other blocks within 0.03 mm; the others are shown beside.
_GOALS = ("boards_and_block", "pushed.block", "pushed.block_twice", "pushed.boards_and_block_twice")


@dataclass(frozen=True)
class Reading:
    """A scan of a block, and which of its points lie on which face by the true rig; the last is the floor."""

    scan: GaugeScan
    on: tuple[np.ndarray, ...]


def measure(quick: bool) -> list[Metric]:
    """Some seeds, or the first."""
    errors: dict[tuple[str, str], list[float]] = {}
    for seed in range(1 if quick else 5):
        rig, exact = exact_session(seed)
        calibration = calibrate(redrawn(exact, Noise(), np.random.default_rng(seed)))
        with tempfile.TemporaryDirectory() as folder:
            gauges = [
                Gauge(photograph(Path(folder) / str(i), rig, 37.0, heights, 10 * i + seed)[0], BLOCK)
                for i, heights in enumerate((HEIGHTS, HEIGHTS[::-1]))
            ]
            others = {
                name: read_block(Path(folder) / name, rig, block, 30.0, 100 * (i + 1) + seed)
                for i, (name, block) in enumerate(OTHERS.items())
            }
        for by, refined in rigs(calibration, gauges, np.random.default_rng([1, seed])).items():
            for name, reading in others.items():
                worst = float(np.abs(heights(refined, reading) - OTHERS[name]).max())
                errors.setdefault((name, by), []).append(worst)
        for name in OTHERS:
            found = "; ".join(f"{by} {of[-1]:.4f}" for (which, by), of in errors.items() if which == name)
            print(f"  seed {seed}: {name}: {found}", flush=True)
    metrics = []
    for (name, by), of in errors.items():
        stem = f"gauge.{name}.{by}"
        median, worst = float(np.median(of)), max(of)
        if by in _GOALS:
            metrics.append(Metric(f"{stem}.median", median, "mm", "lower", 0.03, 0.1))
            metrics.append(Metric(f"{stem}.worst_seed", worst, "mm", "lower", 0.03, 0.1))
        else:
            metrics += [Metric(f"{stem}.median", median, "mm"), Metric(f"{stem}.worst_seed", worst, "mm")]
    return metrics


def rigs(calibration: Calibration, gauges: Sequence[Gauge], random: np.random.Generator) -> dict[str, Rig]:
    """The rigs by which the other blocks are read."""
    rig = pushed(calibration.rig, random)
    turned = replace(
        calibration,
        rig=rig,
        adjustment=eqx.tree_at(lambda a: a.start.rig.lights, calibration.adjustment, rig.lights),
    )
    fits = {
        "boards_and_block": refine_by_gauge(calibration, gauges, trust=("laser", "stage")),
        "pushed.block": refine_by_gauge(turned.rig_file(), gauges[:1]),
        "pushed.block_twice": refine_by_gauge(turned.rig_file(), gauges),
        "pushed.boards_and_block_twice": refine_by_gauge(turned, gauges),
    }
    return {"boards": calibration.rig, "pushed": rig, **{by: fit.rig for by, fit in fits.items()}}


def pushed(rig: Rig, random: np.random.Generator) -> Rig:
    """The rig with its light plane turned by 1° about a random axis."""
    omega = plane_of(rig.lights[0])
    aside = np.cross(omega, random.normal(size=3))
    aside *= np.linalg.norm(omega) / np.linalg.norm(aside)
    with float64():
        return replace(rig, lights=(as_numpy(LightPlane.create(np.cos(_TURN) * omega + np.sin(_TURN) * aside)),))


def photograph(folder: Path, rig: Rig, y: float, block: Sequence[float], seed: int) -> tuple[GaugeScan, ScanTruth]:
    """Scan a block with the true rig: where the stripe is found, and the truth."""
    truth = simulate_scan(folder, rig, rig_2003.scan_scene(rig, stair(y, block)), seed)
    image = reconstruct(rig, read_scan(folder))
    return GaugeScan(image.pixels, image.positions), truth


def read_block(folder: Path, rig: Rig, block: Sequence[float], y: float, seed: int) -> Reading:
    """Photograph a block."""
    scan, truth = photograph(folder, rig, y, block, seed)
    return Reading(scan, faces(truth.points, rig, block, y))


def faces(
    points: Float[np.ndarray, "frames columns 3"],
    rig: Rig,
    block: Sequence[float],
    y: float,
    x: float = 0.0,
    whole_width: float = _WIDTH,
) -> tuple[Bool[np.ndarray, "frames columns"], ...]:
    """Which frame and column is well within which face of a block, and which on the floor, by the true points."""
    R, origin = rig_2003.platform(rig)
    at = (points - origin) @ R - [x, 0.0, 0.0]
    width = whole_width / len(block)
    on = []
    with np.errstate(invalid="ignore"):
        for i, height in enumerate(block):
            middle = -whole_width / 2 + (i + 0.5) * width
            inside = np.abs(at[..., 0] - middle) < width / 2 - _INSET
            inside &= np.abs(at[..., 1] - y) < _DEPTH / 2 - _INSET
            on.append(inside & (np.abs(at[..., 2] - height) < 1e-3))
        on.append((np.abs(at[..., 2]) < 1e-3) & (np.abs(at[..., 1] - y) > _DEPTH / 2 + _INSET))
    return tuple(on)


def heights(rig: Rig, block: Reading) -> Float[np.ndarray, "faces"]:
    """The mean height of each face over the plane of the floor, by a rig, mm."""
    seen = block.scan.pixels
    with float64():
        rig = as_float64(rig)
        points, _ = on_object(rig, stripe_points([Gauge(block.scan, BLOCK)], rig))
    points = np.asarray(points)[0, : seen.size].reshape(*seen.shape, 3)
    *faces, floor = (points[on & np.isfinite(points).all(axis=-1)] for on in block.on)
    centre = floor.mean(axis=0)
    normal = np.linalg.svd(floor - centre, full_matrices=False)[2][2]
    normal *= -np.sign(normal @ centre)
    return np.array([((face - centre) @ normal).mean() for face in faces])
