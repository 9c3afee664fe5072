"""Play of a stage: points of the rigs that come of it over a true line's, what is named, z-scores, and cost.

The sessions of `stages`, with the board at 16 places on the way there and 15 on the way back, at uneven steps. Points
are judged by both directions, half of them by rising steps and half by falling ones.
"""

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np
from jaxtyping import Float

from benchmarks.metric import Metric
from benchmarks.stages import TRAVEL, line_stage, rms, session
from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.simulation.drawn_stage import DrawnStage

_SEEDS, _FEW, _GOAL = 16, 3, 1.15
# A z-score of a few sessions says little.
_FOR_Z = 128
_THERE, _BACK = 16, 15
_KIND = "linear_with_play"
_PLAYS = (0.05, 0.2)
_WAY = np.array([0.0, 0.8, 0.6])

_Beside = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def measure(quick: bool) -> list[Metric]:
    """All cases, with sixteen seeds; or with three."""
    seeds = range(_FEW if quick else _SEEDS)
    true = line_stage()
    lines, as_line_s = _solved([_there_and_back(seed, true) for seed in seeds])
    base = rms(lines, [true] * len(seeds))
    clean, with_play_s = _solved([_there_and_back(seed, true) for seed in seeds], _KIND)
    metrics = [
        Metric("play.line.error_mm", base, "mm"),
        Metric("play.line.named", _named(lines), "", "lower", 0),
        _over("line_with_play", rms(clean, [true] * len(seeds)) / base),
        Metric("play.line_with_play.z_rms", _z_rms(clean, 0.0)),
        Metric("play.line_with_play.time_over_a_line", with_play_s / as_line_s),
    ]
    for play_mm in _PLAYS:
        metrics += _judged(f"{play_mm:g}_mm", play_mm, seeds, base)
    many = range(_FEW if quick else _FOR_Z)
    found, _ = _solved([_there_and_back(seed, line_stage(play_mm=_PLAYS[0])) for seed in many], _KIND)
    metrics.append(Metric("play.z_rms", _z_rms(found, _PLAYS[0]), "", "shown", 1.0))
    metrics += _judged("first_from_the_other_side", 0.2, seeds, base, first=-1)
    metrics += _judged("three_passes", 0.05, seeds, base, steps=_three_passes)
    metrics += _judged("wobble_of_0.02_mm", 0.05, seeds, None, beside=_wobble(0.02))
    return metrics + _false_names(seeds)


def _judged(
    name: str,
    play_mm: float,
    seeds: Sequence[int],
    base: float | None,
    *,
    first: int = 1,
    beside: _Beside | None = None,
    steps: Callable[[int], np.ndarray] | None = None,
) -> list[Metric]:
    stage = line_stage(play_mm=play_mm)
    sessions = [
        session(seed, stage, False, beside=beside, steps=_places(seed) if steps is None else steps(seed), first=first)
        for seed in seeds
    ]
    as_line, found = (_solved(sessions, kind)[0] for kind in (None, _KIND))
    right = [[shape.kind for shape in each.stage_shapes] == [_KIND] for each in as_line]
    others = sum(bool(each.sheet_curves or each.change or (each.flatness and each.flatness.bent)) for each in as_line)
    told = [shape for each in as_line for shape in each.stage_shapes]
    z = [(shape.play_mm - play_mm) / shape.play_sigma_mm for shape in told]
    metrics = [
        Metric(f"play.{name}.named", sum(right) / len(right), "", "higher" if base else "shown", 1.0),
        Metric(f"play.{name}.named_z_rms", float(np.sqrt(np.mean(np.square(z)))) if z else np.nan),
        Metric(f"play.{name}.other_things_named", others, "", "lower", 0),
        Metric(f"play.{name}.still_named", _named(found), "", "lower", 0),
    ]
    if base is not None:
        metrics.insert(0, _over(name, rms(found, [stage] * len(seeds)) / base))
        taken = rms(as_line, [stage] * len(seeds)) / base
        metrics.insert(0, Metric(f"play.{name}.taken_as_a_line_over_a_line", taken))
    said = ", ".join(f"{each.name.removeprefix(f'play.{name}.')} {each.value:.4g}" for each in metrics)
    print(f"  {name}: {said}", flush=True)
    return metrics


def _false_names(seeds: Sequence[int]) -> list[Metric]:
    """Sessions there and back whose stage has no play: how often one is named all the same."""

    def drift(steps: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return np.linspace(-0.05, 0.05, len(steps))[:, None] * _WAY

    def pushed(steps: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return np.where(np.arange(len(steps)) > 9, 0.1, 0.0)[:, None] * _WAY

    cases: dict[str, dict] = {
        "wobble_of_0.02_mm": {"beside": _wobble(0.02)},
        "wobble_of_0.05_mm": {"beside": _wobble(0.05)},
        "drift_of_0.1_mm": {"beside": drift},
        "pushed_by_0.1_mm": {"beside": pushed},
        "screw_of_0.05_mm": {"stage": {"wave_mm": 0.05}},
        "guide_of_0.1_mm": {"stage": {"sag_mm": 0.1}},
    }
    metrics = []
    for name, how in cases.items():
        stage = line_stage(**how.get("stage", {}))
        found = [calibrate(_there_and_back(seed, stage, how.get("beside"))) for seed in seeds]
        metrics.append(Metric(f"play.without.{name}.named", _named(found), "", "lower", 0))
        print(f"  without play, {name}: {_named(found)} named", flush=True)
    return metrics


def _there_and_back(seed: int, stage: DrawnStage, beside: _Beside | None = None) -> Observations:
    return session(seed, stage, False, beside=beside, steps=_places(seed))


def _places(seed: int) -> Float[np.ndarray, "places"]:
    random = np.random.default_rng([31, seed])
    ways = [np.sort(random.choice(np.arange(1, TRAVEL), count - 1, replace=False)) for count in (_THERE, _BACK)]
    return np.concatenate([[0.0], ways[0], [TRAVEL], ways[1][::-1]]).astype(float)


def _three_passes(seed: int) -> Float[np.ndarray, "places"]:
    random = np.random.default_rng([32, seed])
    ways = [np.sort(random.choice(np.arange(1, TRAVEL), 10, replace=False)) for _ in range(3)]
    return np.concatenate([[0.0], ways[0], ways[1][::-1], ways[2]]).astype(float)


def _wobble(size: float) -> _Beside:
    return lambda steps, random: size * random.normal(size=(len(steps), 3))


def _solved(sessions: Sequence[Observations], kind: str | None = None) -> tuple[list[Calibration], float]:
    """The calibrations, and the median of the seconds that one took once all is compiled."""
    motion, found, took = {} if kind is None else {"stage": kind}, [], []
    for each in sessions:
        start = perf_counter()
        found.append(calibrate(each, motion=motion))
        took.append(perf_counter() - start)
    return found, float(np.median(took[1:]))


def _z_rms(found: Sequence[Calibration], play_mm: float) -> float:
    """The RMS of errors of the play over their σ."""
    z = []
    for each in found:
        stage = each.rig.axis("stage")
        sigma = each.covariance.sigma("motion.stage.play.0")
        true = play_mm / line_stage().amount(1.0)[0]
        z.append((float(stage.play[0]) - true) / sigma)  # type: ignore[attr-defined]
    return float(np.sqrt(np.mean(np.square(z))))


def _over(name: str, value: float) -> Metric:
    return Metric(f"play.{name}.over_a_line", value, "", "lower", _GOAL, slack=0.05)


def _named(found: Sequence[Calibration]) -> int:
    """In how many a play is named that is not sought."""
    return sum(any(shape.play_mm for shape in each.stage_shapes) for each in found)
