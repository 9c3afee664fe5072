"""A turntable calibrated from photographs of the board that lies on it, and scans posed by it alone.

The simulated rig of 2003 with a turntable of 3200 steps on its stage: 11 boards, 31 photographs along the stage and 16
on the turntable, 22.5° apart.

- `axis_off`, `turn_off`, `place_off`: root mean square errors of the axis's direction, of the angle over a full turn,
  and of the axis's place at the middle of the table, over draws of the corners with a noise of 0.05 px and of the
  stripe with 0.1 px; beside each, as `…_sigma`, what was predicted, of axis and place in the direction in which that is
  largest. In the long form also from photographs.
- `predicted`: mean of errorᵀ covariance⁻¹ error over the 5 numbers that a turntable has: 1 if σ is honest; and how far
  that is from 1 in bands that hold 99.9 % of all runs.
- `start_off`, `start_turn_off`: the largest error of the poses that the turntable of the first draw gives to eight
  scans of a figure, 45° apart, at the figure's middle; `pose_off`, `pose_turn_off`: the same once they are registered.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from benchmarks import merge
from benchmarks.drawn import Noise, exact_session, exact_turn, redrawn
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, calibrate
from jaxscan.calibration.observe import observe
from jaxscan.files.session import read_session
from jaxscan.rig import Rig, Rotary
from jaxscan.rig.turn_summary import turn_summary
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.folders import simulate_session
from jaxscan.simulation.shapes import figure
from jaxscan.surface.register import register
from jaxscan.surface.side import side_of_image
from jaxscan.surface.turntable import turntable_of, turntable_poses

_NOISE: Final = Noise(corner=0.05, stripe=0.1)
# What 99.9 % of all means of a normal error stay within, in its σ.
_BAND: Final = 3.29
_FREEDOM: Final = 5
_STEPS = np.arange(0, 74_000, 1000)
_STRIPE_PX: Final = 0.03
_TURNS: Final = [400.0 * k for k in range(merge.VIEWS)]


def measure(quick: bool) -> list[Metric]:
    """Drawn, used, and in the long form photographed."""
    rigs, draws = (2, 2) if quick else (8, 5)
    found: list[tuple[Rig, Calibration]] = []
    for seed in range(rigs):
        plain, exact = exact_session(seed)
        rig = rig_2003.with_turntable(plain, seed)
        exact = replace(exact, sequences=(*exact.sequences, exact_turn(rig, seed)))
        random = np.random.default_rng([2003, seed])
        found += [(rig, calibrate(redrawn(exact, _NOISE, random))) for _ in range(draws)]
    metrics = against_truth("turntable.drawn", found)
    rig, calibration = found[0]
    metrics += used(rig, calibration)
    if not quick:
        metrics += against_truth("turntable.photographed", [photographed(seed) for seed in range(4)])
    return metrics


def photographed(seed: int) -> tuple[Rig, Calibration]:
    """A session rendered, its boards found, and calibrated."""
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(seed), seed)
    with tempfile.TemporaryDirectory() as folder:
        simulate_session(Path(folder), seed, rig=rig)
        return rig, calibrate(observe(read_session(folder)))


def against_truth(stem: str, found: list[tuple[Rig, Calibration]]) -> list[Metric]:
    """Errors of each against its rig, and against what was predicted."""
    off, sigmas, squares = [], [], []
    for rig, calibration in found:
        table, true_table = turntable_of(calibration.rig), turntable_of(rig)
        R, origin = rig_2003.platform(rig)
        middle = origin + R @ np.array([0.0, rig_2003.OBJECT_Y, 0.0])
        own, true = numbers(table), numbers(true_table)
        told = turn_summary(table, calibration.covariance, middle)
        truth = turn_summary(true_table, None, middle)
        axis = np.array(told.axis_direction)
        tilt = np.degrees(np.linalg.norm(np.cross(axis, truth.axis_direction)))
        place = np.array(truth.through_mm) - told.through_mm
        turn = (told.degrees_per_step - truth.degrees_per_step) * truth.steps_per_turn
        turn_sigma = (told.degrees_per_step_sigma or 0.0) * truth.steps_per_turn
        off.append([tilt, turn, np.linalg.norm(place - (place @ axis) * axis)])
        sigmas.append([told.axis_sigma_deg, turn_sigma, told.through_sigma_mm])
        squares.append(normalised_square(calibration, own - true))
    rms, predicted = (np.sqrt((np.array(each) ** 2).mean(axis=0)) for each in (off, sigmas))
    mean, band = float(np.mean(squares)), _BAND * np.sqrt(2 / (_FREEDOM * len(found)))
    metrics = []
    for name, unit, value, sigma in zip(("axis", "turn", "place"), ("°", "°", "mm"), rms, predicted, strict=True):
        metrics += [
            Metric(f"{stem}.{name}_off", float(value), unit, "lower", slack=0.2),
            Metric(f"{stem}.{name}_sigma", float(sigma), unit),
        ]
    return [
        *metrics,
        Metric(f"{stem}.predicted", mean),
        Metric(f"{stem}.its_distance_from_1_in_bands_of_99.9_%", abs(mean - 1) / band, "", "lower", 1.0, floor=1.0),
    ]


def normalised_square(calibration: Calibration, error: Float[np.ndarray, "6"]) -> float:
    """errorᵀ covariance⁻¹ error of the turntable's six numbers, whose covariance has rank 5, for each of the 5."""
    at = [i for i, name in enumerate(calibration.covariance.names) if name.startswith("motion.turntable.")]
    matrix = calibration.covariance.matrix[np.ix_(at, at)]
    scale = np.sqrt(np.diagonal(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    along = vectors[:, 1:].T @ (error / scale)
    return float((along**2 / values[1:]).mean())


def numbers(turntable: Rotary) -> Float[np.ndarray, "6"]:
    """Its rotation vector of one step, then its centre."""
    return np.array([float(x) for x in (*turntable.per_step, *turntable.centre)])


def used(rig: Rig, calibration: Calibration) -> list[Metric]:
    """Eight scans posed by the turntable, then registered from there."""
    truth = turntable_poses(turntable_of(rig), _TURNS)
    sides = []
    for k, steps in enumerate(_TURNS):
        scene = rig_2003.scan_scene(rig, rig_2003.turned_on(rig, figure(rig_2003.OBJECT_Y), steps))
        sides.append(side_of_image(f"view {k}", drawn_scan(rig, scene, {"stage": _STEPS}, _STRIPE_PX, k).image))
    starts = turntable_poses(turntable_of(calibration.rig), _TURNS)
    found = register(sides, starts)
    metrics = []
    for name, poses, goal in (("start", starts, 0.5), ("pose", found.poses, 0.05)):
        off = merge.errors(poses, truth, found.centre)
        turned, moved = (float(np.linalg.norm(part, axis=1).max()) for part in (off[:, :3], off[:, 3:]))
        metrics += [
            Metric(f"turntable.used.{name}_off", moved, "mm", "lower", goal, floor=0.003),
            Metric(f"turntable.used.{name}_turn_off", float(np.degrees(turned)), "°", "lower", goal, floor=0.005),
        ]
    return metrics
