"""The simulated rig of 2003: photographs in, rigs and clouds out, compared with the truth.

For each seed a session is rendered, calibrated jointly and sequentially on the same corners and stripes, and the rig is
compared with the true one; for the first twenty a cup is scanned and reconstructed with the joint rig.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from benchmarks.metric import Metric
from benchmarks.sequential import sequential
from jaxscan.calibration import Calibration, calibrate
from jaxscan.calibration.observe import observe
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.rig import Rig
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.accuracy import CloudErrors, cloud_errors
from jaxscan.simulation.folders import simulate_scan, simulate_session
from jaxscan.simulation.shapes import cup

_SESSIONS, _SCANS = 30, 20
# Pixels whose rays meet the sheet between these depths (mm) are what a rig is judged by.
_NEAREST, _FARTHEST = 260.0, 400.0


@dataclass(frozen=True)
class RigErrors:
    """RMS errors of a rig over the working volume, mm.

    Of triangulated exact pixels; of these by its camera and the true sheet; by its sheet and the true camera; of the
    travel of a scan.
    """

    points: float
    camera: float
    plane: float
    stage: float


def measure(quick: bool) -> list[Metric]:
    """All seeds, or the first."""
    sessions, scans = (1, 1) if quick else (_SESSIONS, _SCANS)
    in_sigma, clouds, joint_errors, sequential_errors = [], [], [], []
    for seed in range(sessions):
        with tempfile.TemporaryDirectory() as folder:
            truth = simulate_session(Path(folder) / "session", seed)
            observations = observe(read_session(Path(folder) / "session"))
            joint = calibrate(observations)
            joint_errors.append(rig_errors(joint.rig, truth.rig))
            sequential_errors.append(rig_errors(sequential(observations), truth.rig))
            if seed < scans:
                in_sigma.append(errors_in_sigma(joint, truth.rig))
                clouds.append(scan_errors(Path(folder) / "scan", truth.rig, joint, seed))
        print(
            f"  seed {seed}: corners σ {joint.corner_sigma_px:.4f} px, stripe σ {joint.stripe_sigma_px:.4f} px, "
            f"τ {joint.stripe_correlation:.2f}, points of a rig {joint_errors[-1].points:.4f} mm "
            f"(sequential {sequential_errors[-1].points:.4f})"
            + (f", cloud {clouds[-1].absolute:.4f} mm" if seed < scans else ""),
            flush=True,
        )
    return (
        coverage(np.stack(in_sigma))
        + cloud_metrics(clouds)
        + [
            metric
            for part in ("points", "plane", "stage")
            for metric in _joint_metrics(
                part,
                np.array([getattr(e, part) for e in joint_errors]),
                np.array([getattr(e, part) for e in sequential_errors]),
            )
        ]
    )


def errors_in_sigma(calibration: Calibration, truth: Rig) -> Float[np.ndarray, "parameters"]:
    """Each parameter's error in units of its own predicted standard deviation."""
    values, true = (np.array([float(x) for x in jax.tree.leaves(rig)]) for rig in (calibration.rig, truth))
    assert list(calibration.covariance.names) == parameter_names(truth)
    return (values - true) / np.sqrt(np.diagonal(calibration.covariance.matrix))


def rig_errors(rig: Rig, truth: Rig) -> RigErrors:
    """How far exact pixels of the true rig are triangulated wrong by another one."""
    u, v = np.meshgrid(np.linspace(20, 620, 25), np.linspace(10, 470, 24))
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1)
    with float64():
        there, true, other_plane, other_camera = (
            np.asarray(_points(as_float64(rig), as_float64(truth), jnp.asarray(pixels), which)) for which in range(4)
        )
    depth = true[:, 2]
    near = (depth > _NEAREST) & (depth < _FARTHEST)
    travel = rig_2003.STEPS_APART * (rig_2003.SCAN_FRAMES - 1)
    moved = [rig_2003.stage_travel(r, np.array([float(travel)]))[0] for r in (rig, truth)]
    return RigErrors(
        points=_rms(there[near] - true[near]),
        camera=_rms(other_camera[near] - true[near]),
        plane=_rms(other_plane[near] - true[near]),
        stage=float(np.linalg.norm(moved[0] - moved[1])),
    )


@jax.jit
def _points(rig: Rig, truth: Rig, pixels: Float[jax.Array, "pixels 2"], which: int) -> Float[jax.Array, "pixels 3"]:
    """Middle-of-travel points by the rig (0), the truth (1), and the truth with the rig's sheet (2) or camera (3)."""
    steps = jnp.asarray(rig_2003.STEPS_APART * (rig_2003.SCAN_FRAMES - 1) / 2)

    def each(pixel: Float[jax.Array, "2"]) -> Float[jax.Array, "3"]:
        mixed = replace(truth, lights=rig.lights), replace(truth, camera=rig.camera)
        return jnp.stack([r.triangulate(pixel, {"stage": steps}) for r in (rig, truth, *mixed)])[which]

    return jax.vmap(each)(pixels)


def scan_errors(folder: Path, truth: Rig, calibration: Calibration, seed: int) -> CloudErrors:
    """Scan the cup with the true rig, reconstruct it with the calibrated one."""
    scene = rig_2003.scan_scene(truth, cup(rig_2003.OBJECT_Y))
    scan = simulate_scan(folder, truth, scene, seed)
    image = reconstruct(calibration.rig_file(), read_scan(folder))
    return cloud_errors(scene, scan.points, image.points, image.valid)


def coverage(in_sigma: Float[np.ndarray, "seeds parameters"]) -> list[Metric]:
    """How many errors are within 1 and 3 of their own predicted σ."""
    within = [float((np.abs(in_sigma) <= n).mean()) for n in (1, 3)]
    return [
        Metric("simulated.within_3_sigma", within[1], "", "higher", 0.98, floor=0.02),
        Metric("simulated.within_1_sigma", within[0], "", "higher", 0.58, floor=0.05),
        Metric("simulated.within_1_sigma_not_too_many", within[0], "", "lower", 0.78, floor=0.05),
        Metric("simulated.rms_error_in_sigma", float(np.sqrt((in_sigma**2).mean()))),
    ]


def cloud_metrics(clouds: list[CloudErrors]) -> list[Metric]:
    """Medians over the seeds."""
    goals = {"absolute": 0.16, "completeness": 0.95}
    return [
        Metric(
            f"simulated.cloud.{name}",
            float(np.median([getattr(errors, name) for errors in clouds])),
            "" if name in ("completeness", "far_points") else "mm",
            "shown" if name == "far_points" else "higher" if name == "completeness" else "lower",
            goals.get(name),
        )
        for name in CloudErrors.__dataclass_fields__
    ]


def _joint_metrics(part: str, joint: Float[np.ndarray, "n"], apart: Float[np.ndarray, "n"]) -> list[Metric]:
    goal = 0.8 if part == "points" else 1.0
    return [
        Metric(f"simulated.{part}.joint", float(np.median(joint)), "mm", "lower", slack=0.1),
        Metric(f"simulated.{part}.sequential", float(np.median(apart)), "mm"),
        Metric(
            f"simulated.{part}.joint_over_sequential",
            float(np.median(joint) / np.median(apart)),
            "",
            "lower",
            goal,
            slack=0.1,
        ),
        Metric(f"simulated.{part}.joint_over_sequential_pairwise", float(np.median(joint / apart))),
    ]


def _rms(difference: Float[np.ndarray, "points 3"]) -> float:
    return float(np.sqrt(np.nanmean((difference**2).sum(axis=1))))
