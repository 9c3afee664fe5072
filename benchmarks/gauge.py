"""A light plane 1° wrong, put right by a step block: how another block, not used for that, reads before and after.

The rig of a seed is calibrated from drawn observations, its light plane is then turned by 1° about a random axis, a
block of 1.48, 3.68, 8.94 and 14.00 mm is scanned, photograph by photograph, with the true rig, and the rig is refined.
A second block is scanned and read with the rig as it was calibrated, with the turned one and with the refined one:
the mean height of each face over the plane of the floor.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.drawn import Noise, exact_session, redrawn
from benchmarks.metric import Metric
from jaxscan.calibration import calibrate
from jaxscan.calibration.gauge import GaugeScan, refine_by_gauge
from jaxscan.calibration.gauge_shapes import Steps
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan, read_scan
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.rig import LightPlane, Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.shapes import stair

HEIGHTS = (1.48, 3.68, 8.94, 14.00)
# Other heights, rising the same way, within what the gauge covered; and a taller block, falling the other way, which is
# read where the gauge was not: at the left the gauge had been 1.48 mm high, and now 17 are asked for.
OTHERS = {"other_block": (2.6, 5.1, 7.3, 12.0), "taller_and_reversed": (17.0, 11.5, 6.2, 3.1)}
_TURN = np.radians(1.0)
# What is read keeps this far from the edges of a face, mm.
_INSET = 2.0
_WIDTH, _DEPTH = 120.0, 50.0


@dataclass(frozen=True)
class Reading:
    """A scan of a block, and which of its points lie on which face by the true rig; the last is the floor."""

    scan: Scan
    on: tuple[np.ndarray, ...]


def measure(quick: bool) -> list[Metric]:
    """Some seeds, or the first."""
    errors: dict[tuple[str, str], list[float]] = {}
    rms = []
    for seed in range(1 if quick else 5):
        rig, exact = exact_session(seed)
        calibrated = calibrate(redrawn(exact, Noise(), np.random.default_rng(seed))).rig_file()
        turned = replace(calibrated, rig=pushed(calibrated.rig, np.random.default_rng([1, seed])))
        with tempfile.TemporaryDirectory() as folder:
            simulate_scan(Path(folder) / "gauge", rig, rig_2003.scan_scene(rig, stair(37.0, HEIGHTS)), seed)
            image = reconstruct(turned, read_scan(Path(folder) / "gauge"))
            fit = refine_by_gauge(turned, GaugeScan(image.pixels, image.steps), Steps((0.0, *HEIGHTS)))
            rms.append(fit.rms_after_mm)
            for i, (name, block) in enumerate(OTHERS.items()):
                reading = read_block(Path(folder) / name, rig, block, 30.0, 100 * (i + 1) + seed)
                for which, content in (("calibrated", calibrated), ("turned", turned), ("refined", fit.rig_file())):
                    worst = float(np.abs(heights(content, reading) - block).max())
                    errors.setdefault((name, which), []).append(worst)
        print(
            f"  seed {seed}: largest error of a height: "
            + "; ".join(f"{name} {which} {of[-1]:.4f}" for (name, which), of in errors.items()),
            flush=True,
        )
    metrics = [
        Metric(f"gauge.{name}.{which}.largest_error", float(np.median(of)), "mm")
        for (name, which), of in errors.items()
        if (name, which) != ("other_block", "refined")
    ]
    refined = errors["other_block", "refined"]
    return [
        *metrics,
        Metric("gauge.other_block.refined.largest_error", float(np.median(refined)), "mm", "lower", 0.03, 0.1),
        Metric("gauge.other_block.refined.largest_error.worst_seed", max(refined), "mm", "lower", 0.03, 0.1),
        Metric("gauge.refined.rms_on_the_gauge", float(np.median(rms)), "mm", "lower", slack=0.05),
    ]


def pushed(rig: Rig, random: np.random.Generator) -> Rig:
    """The rig with its light plane turned by 1° about a random axis."""
    omega = np.array([float(c) for c in rig.lasers[0].plane])
    aside = np.cross(omega, random.normal(size=3))
    aside *= np.linalg.norm(omega) / np.linalg.norm(aside)
    with float64():
        return replace(rig, lasers=(as_numpy(LightPlane.create(np.cos(_TURN) * omega + np.sin(_TURN) * aside)),))


def read_block(folder: Path, rig: Rig, block: Sequence[float], y: float, seed: int) -> Reading:
    """Photograph a block; by the true points, which frame and column is well within which face."""
    truth = simulate_scan(folder, rig, rig_2003.scan_scene(rig, stair(y, block)), seed)
    R, origin = rig_2003.platform(rig)
    at = (truth.points - origin) @ R
    width = _WIDTH / len(block)
    on = []
    with np.errstate(invalid="ignore"):
        for i, height in enumerate(block):
            middle = -_WIDTH / 2 + (i + 0.5) * width
            inside = np.abs(at[..., 0] - middle) < width / 2 - _INSET
            inside &= np.abs(at[..., 1] - y) < _DEPTH / 2 - _INSET
            on.append(inside & (np.abs(at[..., 2] - height) < 1e-3))
        on.append((np.abs(at[..., 2]) < 1e-3) & (np.abs(at[..., 1] - y) > _DEPTH / 2 + _INSET))
    return Reading(read_scan(folder), tuple(on))


def heights(content: RigFile, block: Reading) -> Float[np.ndarray, "faces"]:
    """The mean height of each face over the plane of the floor, by a rig, mm."""
    image = reconstruct(RigFile(content.rig), block.scan)
    *faces, floor = (image.points[on & image.valid].astype(np.float64) for on in block.on)
    centre = floor.mean(axis=0)
    normal = np.linalg.svd(floor - centre, full_matrices=False)[2][2]
    normal *= -np.sign(normal @ centre)
    return np.array([((face - centre) @ normal).mean() for face in faces])
