"""Faults for which there is no term: whether the rig lies within 3 of its σ, which admit what residuals show.

Sessions of the simulated rig of 2003, drawn with normal noise: boards that are bent like an S, solved as flat and as
boards that bend; boards with a corner bent up; a pattern whose columns are 0.2 % longer than its rows; a lens whose
focal length drifts by 0.2 % from the first photograph to the last, and back. What is true of a rig that drifts is taken
to be that of its first photograph, and that of the middle. And clean sessions, whose σ must stay as they are.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import jax
import numpy as np
from jaxtyping import Float

from benchmarks.board_shape import HALF, seen_by
from benchmarks.changes import refocused
from benchmarks.drawn import Noise, exact_session, exact_views, project, redrawn
from benchmarks.drawn_bent import clean_session
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003

_SEEDS, _FEW, _CLEAN, _CLEAN_QUICK = 20, 3, 100, 10
_DRIFT: Final = 2e-3
_STRETCH: Final = 2e-3
_UNTIL_CLEARED: Final = 20

_HEIGHTS: Final[dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]] = {
    "like_an_s": lambda s, t: 0.3 / 0.77 * (s**3 - s),
    "corner_bent_up": lambda s, t: 0.3 * np.maximum(0, s + t - 1) ** 2,
}


def measure(quick: bool) -> list[Metric]:
    """All faults, twenty sessions each and a hundred clean ones, or three and ten."""
    seeds = range(_FEW if quick else _SEEDS)
    metrics = []
    for name, height in _HEIGHTS.items():
        for shape in ("flat", "bend"):
            drawn = [_bent(seed, height) for seed in seeds]
            found = [(rig, calibrate(seen, board_shape=shape)) for rig, seen in drawn]
            metrics += _honest(f"{name}_as_{shape}", found)
    drawn = [stretched(seed) for seed in seeds]
    metrics += _honest("stretched_0.2_%", [(rig, calibrate(seen)) for rig, seen in drawn])
    for sign, name in ((1, "drift_up"), (-1, "drift_down")):
        sessions = [drifting(seed, sign * _DRIFT) for seed in seeds]
        calibrations = [calibrate(session) for _, _, session in sessions]
        for i, moment in enumerate(("first", "middle")):
            rigs = [each[:2][i] for each in sessions]
            metrics += _honest(f"{name}.{moment}", list(zip(rigs, calibrations, strict=True)))
        named = sum(found.drift is not None and found.drift.kind == "focus" for found in calibrations)
        metrics.append(Metric(f"left_over.{name}.named", named / len(calibrations), "", "higher", 0.95, slack=0.05))
    count, wider = _CLEAN_QUICK if quick else _CLEAN, 0
    for seed in range(count):
        found = calibrate(clean_session(seed))
        wider += found.off_grid is not None or found.drift is not None
        # Every size of board is compiled again, and the number of memory maps of a process is limited.
        if seed % _UNTIL_CLEARED == 0:
            jax.clear_caches()
    return [*metrics, Metric(f"left_over.widened_of_{count}_clean", wider, "", "lower", 1.0)]


def _honest(name: str, found: list[tuple[Rig, Calibration]]) -> list[Metric]:
    """The share of the rig's numbers within 3 σ, with the σ of noise alone too, and RMS errors in σ."""
    z, alone = [], []
    for rig, calibration in found:
        true, own = (np.array([float(leaf) for leaf in jax.tree.leaves(each)]) for each in (rig, calibration.rig))
        sigma = np.sqrt(np.diagonal(calibration.covariance.of_leaves(calibration.rig)))
        wider = np.array(list(calibration.widened_by().values()))
        z.append((own - true) / sigma)
        alone.append(z[-1] * wider)
    stem = f"left_over.{name}"
    metrics = [
        Metric(f"{stem}.within_3_sigma", _within(z), "", "higher", 0.95, slack=0.02),
        Metric(f"{stem}.within_3_of_noise_alone", _within(alone)),
        Metric(f"{stem}.z_rms", float(np.sqrt(np.mean(np.square(z))))),
    ]
    print("  " + ", ".join(f"{m.name} {m.value:.3f}" for m in metrics), flush=True)
    return metrics


def _within(z: list[Float[np.ndarray, "numbers"]]) -> float:
    return float(np.mean(np.abs(z) < 3))


def _bent(seed: int, height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[Rig, Observations]:
    return seen_by(seed, lambda _: lambda x, y: height(x / HALF[0] - 1, y / HALF[1] - 1))


def stretched(seed: int) -> tuple[Rig, Observations]:
    """Seen of a board whose columns are farther apart than the calibration is told."""

    def longer(points: np.ndarray) -> np.ndarray:
        return points * [1 + _STRETCH, 1.0, 1.0]

    rig, exact = exact_session(seed)
    poses = rig_2003.board_poses(rig, seed)
    points = longer(rig_2003.BOARD.points())
    seen = [project(rig.camera, points @ R.T + t) for R, t in zip(poses.matrix(), poses.translation, strict=True)]
    views = tuple(replace(view, corners=corners) for view, corners in zip(exact.views, seen, strict=True))
    (sequence,) = exact.sequences
    first, moved = rig_2003.stage_pose(rig, seed).apply(points), rig_2003.stage_travel(rig, sequence.steps)
    along = tuple(
        replace(view, corners=project(rig.camera, first + by)) for view, by in zip(sequence.views, moved, strict=True)
    )
    exact = replace(exact, views=views, sequences=(replace(sequence, views=along),))
    return rig, redrawn(exact, Noise(), np.random.default_rng([2019, seed]))


def drifting(seed: int, by: float) -> tuple[Rig, Rig, Observations]:
    """A lens whose focal length grows by a share from the first photograph to the last: both moments, and the session.

    Args:
        seed: of the rig and the noise.
        by: the share.
    """
    random = np.random.default_rng([seed, 56])
    rig, exact = exact_session(seed)
    n, (sequence,) = len(exact.views), exact.sequences
    last = n + len(sequence.views) - 1

    def at(i: float) -> Rig:
        return refocused(rig, by * i / last)

    poses = rig_2003.board_poses(rig, seed)
    views = tuple(
        replace(
            exact_views(at(i), type(poses)(poses.rotation[i : i + 1], poses.translation[i : i + 1]))[0], name=f"{i}"
        )
        for i in range(n)
    )
    first = rig_2003.stage_pose(rig, seed).apply(rig_2003.BOARD.points())
    moved = rig_2003.stage_travel(rig, sequence.steps)
    along = tuple(
        View(view.name, project(at(n + i).camera, first + by_stage))
        for i, (view, by_stage) in enumerate(zip(sequence.views, moved, strict=True))
    )
    session = replace(exact, views=views, sequences=(replace(sequence, views=along),))
    return as_numpy(rig), as_numpy(at(last / 2)), redrawn(session, Noise(), random)


def _only(poses: Pose, i: int) -> Pose:
    return Pose(poses.rotation[i : i + 1], poses.translation[i : i + 1])
