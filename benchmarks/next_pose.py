"""Three photographs where the report would have the board held, against three more like those that there are.

Sessions of the simulated rig of 2003, drawn: five views, or all eleven, and the stage. Each is calibrated, three poses
are suggested, and the session is solved again with three views more: the suggested ones; the same held by hand, 10 mm
and 5° beside in every direction; and three poses drawn as the session's own are. What is compared is how far exact
pixels of the true rig are triangulated wrong, RMS over fresh drawings of all noise, and the σ that each solve predicts.
"""

import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from benchmarks.drawn import Noise, exact_session, exact_views, redrawn
from benchmarks.metric import Metric
from benchmarks.simulated import rig_errors
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.geometry import Pose
from jaxscan.reconstruction.next_best_views import next_best_views, wanted
from jaxscan.reconstruction.working_volume import WorkingVolume, working_volume
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003

_SESSIONS, _SESSIONS_QUICK = 20, 2
_ADDED, _DRAWINGS = 3, 5
NOISE = Noise()
_DEPTHS = (310.0, 380.0)
# How far a hand is beside what was suggested, in every direction.
_BESIDE_MM, _BESIDE_DEG = 10.0, 5.0


@dataclass(frozen=True)
class Compared:
    """One session. For each kind of views that are added, and for none: error of points (mm RMS) and median σ (mm).

    Attributes:
        errors: actual, over the drawings.
        sigmas: predicted by the calibrations, RMS over the drawings.
        predicted: σ that was predicted for the suggested views before they were taken.
        seconds: that the suggestion took.
    """

    errors: dict[str, float]
    sigmas: dict[str, float]
    predicted: float
    seconds: float


def measure(quick: bool) -> list[Metric]:
    """Sessions of few views and of many."""
    sessions, metrics = _SESSIONS_QUICK if quick else _SESSIONS, []
    for views in (5, rig_2003.BOARD_VIEWS):
        each = [compare(seed, views) for seed in tqdm(range(sessions), desc=f"  {views} views", file=sys.stderr)]
        metrics += _metrics(f"next_pose.{views}_views", each)
    return metrics


def _metrics(name: str, each: list[Compared]) -> list[Metric]:
    def against_random(of: str, kind: str) -> Float[np.ndarray, "sessions"]:
        return np.array([getattr(e, of)[kind] / getattr(e, of)["random"] for e in each])

    errors = {kind: float(np.median([e.errors[kind] for e in each])) for kind in each[0].errors}
    better = float((against_random("errors", "suggested") < 1).mean())
    predicted = np.array([e.predicted / e.sigmas["suggested"] for e in each])
    return [
        *(Metric(f"{name}.error.{kind}", error, "mm") for kind, error in errors.items()),
        *(
            Metric(
                f"{name}.{of.removesuffix('s')}.{kind}_over_random",
                float(np.median(against_random(of, kind))),
                "",
                "lower",
                1.0,
                slack=0.1,
            )
            for of in ("errors", "sigmas")
            for kind in ("suggested", "held_by_hand")
        ),
        Metric(f"{name}.error.sessions_in_which_suggested_is_better", better),
        Metric(f"{name}.sigma.predicted_over_found", float(np.median(predicted))),
        Metric(f"{name}.seconds_later", float(np.median([e.seconds for e in each[1:]])), "s"),
    ]


def compare(seed: int, views: int) -> Compared:
    """Suggest from one drawing of a session; solve further drawings with each kind of views."""
    truth, exact = exact_session(seed)
    exact = replace(exact, views=exact.views[:views])
    random = np.random.default_rng([2003, seed, views])
    begin = calibrate(redrawn(exact, NOISE, random))
    clock = time.monotonic()
    planned = next_best_views(begin, _volumes(begin), count=_ADDED)
    seconds = time.monotonic() - clock
    like_these = rig_2003.board_poses(truth, 1000 + seed, _DRAWINGS * _ADDED)
    solved: dict[str, list[Calibration]] = {"none": [], "suggested": [], "held_by_hand": [], "random": []}
    for i in range(_DRAWINGS):
        some = slice(_ADDED * i, _ADDED * (i + 1))
        added = {
            "suggested": _stack([pose.pose for pose in planned.poses]),
            "held_by_hand": _stack([_beside(truth, pose.pose, random) for pose in planned.poses]),
            "random": Pose(like_these.rotation[some], like_these.translation[some]),
        }
        solved["none"].append(calibrate(redrawn(exact, NOISE, random)))
        for kind, poses in added.items():
            solved[kind].append(calibrate(redrawn(_with(exact, exact_views(truth, poses)), NOISE, random)))
    return Compared(
        errors={kind: _rms([rig_errors(c.rig, truth).points for c in each]) for kind, each in solved.items()},
        sigmas={kind: _rms([_median_sigma(c) for c in each]) for kind, each in solved.items()},
        predicted=planned.medians[-1],
        seconds=seconds,
    )


def _with(exact: Observations, views: tuple[View, ...]) -> Observations:
    named = [replace(view, name=f"added-{i}") for i, view in enumerate(views)]
    return replace(exact, views=(*exact.views, *named))


def _beside(rig: Rig, pose: Pose, random: np.random.Generator) -> Pose:
    """The board in about that pose, and wholly in the image."""
    middle = rig_2003.BOARD.points().mean(axis=0)
    while True:
        aside = random.normal(scale=np.radians(_BESIDE_DEG), size=3)
        beside = Pose.about(aside, pose.apply(middle), random.normal(scale=_BESIDE_MM, size=3)) @ pose
        if rig_2003.in_view(rig.camera, beside.matrix(), beside.translation[None]):
            return beside


def _stack(poses: list[Pose]) -> Pose:
    return Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))


def _volumes(calibration: Calibration) -> tuple[WorkingVolume, ...]:
    sigma = calibration.stripe_sigma_px or 0.0
    volume = working_volume(calibration.rig, "", calibration.covariance, sigma, True, _DEPTHS)
    return () if volume is None else (volume,)


def _median_sigma(calibration: Calibration) -> float:
    aim = wanted(calibration, _volumes(calibration))
    return aim.median(calibration.covariance.of_leaves(calibration.rig))


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
