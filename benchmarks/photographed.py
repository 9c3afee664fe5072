"""Boards that bend, sheets that curve and stages that are no lines, photographed: points, and the chosen model.

The other suites of such faults draw corners and stripes by the numbers. Here the simulated rig of 2003 photographs a
session with speckle and noise, the board on a cylinder 30° askew, which is no term of the model, and the detectors find
corners and stripes. Each session is calibrated with the model that is chosen, and with the plain one. The error is that
of points that the rig makes of exact pixels, all over the image and at five places of the stage, where the true ones
are 260 to 400 mm away; RMS, over the error of the sessions of the same seeds without a fault.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from benchmarks.drawn_sheets import triangulated
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, calibrate, calibrate_by_evidence
from jaxscan.calibration.model import Model
from jaxscan.calibration.observe import observe
from jaxscan.files.axes import STAGE
from jaxscan.files.session import read_session
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_session

# Sessions of each fault, and of those whose errors differ more from one to the next; in the short form.
_SEEDS, _MORE_SEEDS, _SEEDS_QUICK = 4, 12, 1
# Photographs 2 mm apart determine a wave of 4 mm or more: one of 3.2 mm has the same places as a longer one.
_SCREW_STEPS = 5000.0
# Depths that count, mm; motor steps of the stage's photographs, and at how many places of them points are compared.
_NEAREST, _FARTHEST, _PLACES = 260.0, 400.0, 5
_TRAVEL = rig_2003.STEPS_APART * (rig_2003.STAGE_VIEWS - 1)
# Of each fault: what is done to the rig and its session, what has to be chosen for it, and the goal.
_FAULTS: dict[str, tuple[dict[str, Any], Callable[[Model], bool], float, int]] = {
    "nothing": (
        {},
        lambda m: m.board_shape == "flat" and m.lights == ("plane",) and not m.motion,
        1.03,
        _MORE_SEEDS,
    ),
    "board_0.05": ({"bend_mm": 0.05}, lambda m: m.board_shape != "flat", 1.2, _SEEDS),
    "board_0.3": ({"bend_mm": 0.3}, lambda m: m.board_shape != "flat", 1.2, _SEEDS),
    "sheet_0.05": ({"bow_mm": 0.05}, lambda m: m.lights == ("bowed",), 1.1, _SEEDS),
    "sheet_0.3": ({"bow_mm": 0.3}, lambda m: m.lights == ("bowed",), 1.1, _SEEDS),
    "guide_0.1": ({"guide_mm": 0.1}, lambda m: m.motion == {"stage": "guide"}, 1.15, _MORE_SEEDS),
    "screw_0.05": ({"screw_mm": 0.05}, lambda m: m.motion == {"stage": "screw"}, 1.15, _MORE_SEEDS),
}


def measure(quick: bool) -> list[Metric]:
    """Four or twelve seeds of each fault, or one."""
    metrics, flat = [], np.zeros(0)
    for name, (fault, right, goal, seeds) in _FAULTS.items():
        chosen, plain, named = [], [], 0
        for seed in range(_SEEDS_QUICK if quick else seeds):
            errors, plain_errors, model = _calibrated(seed, **fault)
            chosen.append(errors)
            plain.append(plain_errors)
            named += right(model)
            if not right(model):
                print(f"  {name} {seed}: {model}", flush=True)
        flat = np.array(plain) if name == "nothing" else flat
        stem, count = f"photographed.{name}", len(chosen)
        (over, error), (plainly, _) = (_over(np.array(x), flat[:count]) for x in (chosen, plain))
        metrics.append(Metric(f"{stem}.over_nothing", over, "", "lower", goal, slack=0.1))
        metrics.append(Metric(f"{stem}.error_of_it", error))
        metrics.append(Metric(f"{stem}.plain_over_nothing", plainly))
        metrics.append(Metric(f"{stem}.right", named / count, "", "higher", 0.95, slack=0.05))
        print(f"  {name}: {over:.3f} ± {error:.3f}, taken as plain {plainly:.3g}; right {named} of {count}", flush=True)
        # Every model is compiled again, and the number of memory maps of a process is limited.
        jax.clear_caches()
    return [*metrics, Metric("photographed.nothing.points_mm", float(np.sqrt(np.mean(flat**2))), "mm")]


def _over(errors: Float[np.ndarray, "sessions"], flat: Float[np.ndarray, "sessions"]) -> tuple[float, float]:
    """The quotient of two RMS errors, and its own standard error, by leaving out one session after another."""

    def quotient(some: Bool[np.ndarray, "sessions"]) -> float:
        return float(np.sqrt(np.mean(errors[some] ** 2) / np.mean(flat[some] ** 2)))

    n = len(errors)
    without = [quotient(np.arange(n) != i) for i in range(n)] if n > 1 else [np.nan]
    return quotient(np.ones(n, bool)), float(np.sqrt((n - 1) * np.var(without)))


def _calibrated(
    seed: int, bend_mm: float = 0.0, bow_mm: float = 0.0, guide_mm: float = 0.0, screw_mm: float = 0.0
) -> tuple[float, float, Model]:
    """The points' error with the model that is chosen and with the plain one, mm, and that model."""
    rig = rig_2003.simulated_rig(seed, 1, bow_mm)
    rig = rig_2003.with_stage(rig, guide_mm=guide_mm, screw_mm=screw_mm, screw_steps=_SCREW_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        truth = simulate_session(Path(folder) / "session", seed, rig=rig, bend_mm=bend_mm)
        observations = observe(read_session(Path(folder) / "session"))

    true = _points(truth.rig)
    near = (true[0, :, 2] > _NEAREST) & (true[0, :, 2] < _FARTHEST)

    def error(found: Calibration) -> float:
        return float(np.sqrt(((_points(found.rig) - true)[:, near] ** 2).sum(axis=-1).mean()))

    found = calibrate_by_evidence(observations, Model())
    assert found.choice is not None
    return error(found), error(calibrate(observations)), found.choice.model


def _points(rig: Rig) -> Float[np.ndarray, "places pixels 3"]:
    """Where the rays of pixels meet the sheet, in the object frame, at places of the stage."""
    columns, rows = rig.camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(5.0, columns, 21), np.arange(5.0, rows, 21)), axis=-1).reshape(-1, 2)
    seen = triangulated(rig, pixels)
    poses = (rig.pose({STAGE: float(step)}).inverse() for step in np.linspace(0, _TRAVEL, _PLACES))
    return np.stack([np.asarray(pose.apply(seen)) for pose in poses])
