"""Stages that are no lines: points of the rigs that come of them over a true line's, what is named, and cost.

Sessions of the rig of 2003 as a detector would have seen them with errors of 0.03 px for corners and of 0.1 px for
stripes, without photographs: 12 views, and the board at 31 places over 60 mm of the stage. The stages are drawn by
formulas of their own: a carriage on the arc of a circle, which turns as it follows it or does not, and a screw of 3200
steps, 3.2 mm, a turn. A rig is judged by what it makes of the sheet's points, seen without error, over those 60 mm, in
the object frame: so what is left is the rig's own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from benchmarks.metric import Metric
from jaxscan.calibration import BoardSequence, Calibration, Observations, StripePoints, View, calibrate
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.rig import Rig, run_of, runs
from jaxscan.rig.board_shape import middle_and_half
from jaxscan.rig.play import FAR
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn_stage import DrawnStage
from jaxscan.simulation.render import plane_of

_CORNER_PX, _STRIPE_PX, _VIEWS, _PLACES, TRAVEL = 0.03, 0.1, 12, 31, 60000
_SEEDS, _FEW = 16, 3
_GOAL = 1.15
# Depths of the scanned points, mm, and how far to either side they lie, in x / z.
_DEPTHS, _ASIDE = (310.0, 380.0), 0.4


@dataclass(frozen=True)
class _Case:
    """A stage, and what it is to be solved as.

    Attributes:
        kind: of its motion.
        stage: arguments of `DrawnStage.create`.
        even: whether its photographs stand at equal distances.
        goal: of its points over a line's.
        period: of its screw, where it is given.
    """

    kind: str
    stage: dict[str, float | bool]
    even: bool = False
    goal: float | None = _GOAL
    period: float | None = None


_GUIDE, _SCREW = {"sag_mm": 0.1}, {"wave_mm": 0.05}
_CASES = {
    "screw": _Case("screw", _SCREW),
    "guide": _Case("guide", _GUIDE),
    "guide_even": _Case("guide", _GUIDE, even=True),
    "guide_that_does_not_turn": _Case("guide", {**_GUIDE, "turning": False}),
    "both": _Case("screw_on_guide", {**_GUIDE, **_SCREW}),
    "screw_half": _Case("screw", {"wave_mm": 0.025}),
    "guide_half": _Case("guide", {"sag_mm": 0.05}),
    "both_half": _Case("screw_on_guide", {"sag_mm": 0.05, "wave_mm": 0.025}),
    "screw_even": _Case("screw", _SCREW, even=True, goal=None),
    "screw_even_period_given": _Case("screw", _SCREW, even=True, period=3200.0),
}


def measure(quick: bool) -> list[Metric]:
    """All stages, with sixteen seeds; or with three."""
    seeds = range(_FEW if quick else _SEEDS)
    true = line_stage()
    lines = {even: [calibrate(session(seed, true, even)) for seed in seeds] for even in (False, True)}
    base = {even: rms(found, [true] * len(seeds)) for even, found in lines.items()}
    metrics = [
        Metric("stages.line.error_mm", base[False], "mm"),
        Metric("stages.line.named", _named(lines[False]) + _named(lines[True]), "", "lower", 0),
    ]
    for kind in ("guide", "screw", "screw_on_guide"):
        found = [calibrate(session(seed, true, False), motion={"stage": kind}) for seed in seeds]
        metrics.append(_over(f"line_as_{kind}", rms(found, [true] * len(seeds)) / base[False], _GOAL))
    for name, case in _CASES.items():
        metrics += _judged(name, case, seeds, base[case.even])
    return metrics + _false_names(seeds)


def _judged(name: str, case: _Case, seeds: Sequence[int], base: float) -> list[Metric]:
    stages = [line_stage(phase=float(seed), **case.stage) for seed in seeds]
    sessions = [session(seed, stage, case.even) for seed, stage in zip(seeds, stages, strict=True)]
    as_line = [calibrate(session) for session in sessions]
    periods = None if case.period is None else {"stage": case.period}
    found = [calibrate(session, motion={"stage": case.kind}, periods=periods) for session in sessions]
    right = sum([shape.kind for shape in each.stage_shapes] == [case.kind] for each in as_line)
    others = sum(bool(each.sheet_curves or each.change or (each.flatness and each.flatness.bent)) for each in as_line)
    metrics = [
        Metric(f"stages.{name}.taken_as_a_line_over_a_line", rms(as_line, stages) / base),
        _over(name, rms(found, stages) / base, case.goal),
        Metric(f"stages.{name}.named", right / len(sessions), "", "higher" if case.goal else "shown", 1.0),
        Metric(f"stages.{name}.other_things_named", others, "", "lower", 0),
        Metric(f"stages.{name}.still_named", _named(found), "", "lower", 0),
    ]
    print(f"  {name}: {', '.join(f'{m.value:.4g}' for m in metrics)}", flush=True)
    print(f"  {[shape.statements for shape in as_line[0].stage_shapes]}", flush=True)
    return metrics


def _false_names(seeds: Sequence[int]) -> list[Metric]:
    """Sessions whose stage is a line: how often one is named all the same."""
    true = line_stage()

    def pushed(steps: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return np.where(steps > 0.6 * TRAVEL, 0.1, 0.0)[:, None] * np.array([0.6, 0.0, 0.8])

    def wobble(size: float) -> Callable[[np.ndarray, np.random.Generator], np.ndarray]:
        return lambda steps, random: size * random.normal(size=(len(steps), 3))

    cases: dict[str, dict] = {
        "board_bent_by_0.1_mm": {"board": _bent(0.1)},
        "board_bent_by_0.3_mm": {"board": _bent(0.3)},
        "board_bent_by_1_mm": {"board": _bent(1.0)},
        "wobble_of_0.01_mm": {"beside": wobble(0.01)},
        "wobble_of_0.05_mm": {"beside": wobble(0.05)},
        "pushed_by_0.1_mm": {"beside": pushed},
        "lens_with_k2_of_0.3": {"k2": 0.3},
        "sheet_bowed_by_0.3_mm": {"sheet_mm": 0.3},
    }
    metrics = []
    for name, how in cases.items():
        found = [calibrate(session(seed, true, False, **how)) for seed in seeds]
        metrics.append(Metric(f"stages.{name}.named", _named(found), "", "lower", 0))
        print(f"  {name}: {_named(found)} named", flush=True)
    return metrics


def _over(name: str, value: float, goal: float | None) -> Metric:
    return Metric(f"stages.{name}.over_a_line", value, "", "lower" if goal else "shown", goal, slack=0.05)


def _named(found: Sequence[Calibration]) -> int:
    return sum(bool(each.stage_shapes) for each in found)


def line_stage(**how: float | bool) -> DrawnStage:
    """The stage of 2003, changed as `DrawnStage.create` says."""
    step = rig_2003.stage_travel(rig_2003.simulated_rig(0), np.ones(1))[0]
    return DrawnStage.create(step, over_mm=1e-3 * TRAVEL, **how)  # type: ignore[arg-type]


def _bent(mm: float) -> Float[np.ndarray, "corners 3"]:
    """The points of a bent board: the highest is `mm` above the lowest."""
    points = rig_2003.BOARD.points()
    middle, half = middle_and_half(points)
    s, t = ((points[:, :2] - middle) / half).T
    return points + mm * (1 - 0.7 * s**2 - 0.3 * t**2)[:, None] * np.array([0.0, 0.0, 1.0])


def steps_of(seed: int, even: bool) -> Float[np.ndarray, "places"]:
    if even:
        return np.linspace(0.0, TRAVEL, _PLACES)
    random = np.random.default_rng([21, seed])
    inner = random.choice(np.arange(1, TRAVEL), _PLACES - 2, replace=False)
    return np.concatenate([[0.0], np.sort(inner), [TRAVEL]]).astype(float)


def session(
    seed: int,
    stage: DrawnStage,
    even: bool,
    *,
    board: Float[np.ndarray, "corners 3"] | None = None,
    beside: Callable[[np.ndarray, np.random.Generator], np.ndarray] | None = None,
    k2: float = 0.0,
    sheet_mm: float = 0.0,
    steps: Float[np.ndarray, "places"] | None = None,
    first: int = 1,
) -> Observations:
    """Views, and the board on a stage.

    Args:
        seed: of the noise, the poses and the places.
        stage: that moves the board.
        even: whether its photographs stand at equal distances.
        board: its points as they are; None for a flat one.
        beside: where it stood beside the stage's path, mm, for these steps.
        k2: of a lens that is not followed.
        sheet_mm: how far the sheet is bowed.
        steps: of the photographs, in their order, in place of one pass.
        first: whether the first was approached as the second, 1, or from the other side, −1.
    """
    rig, random = rig_2003.simulated_rig(0, bow_mm=sheet_mm), np.random.default_rng([22, seed])
    points = rig_2003.BOARD.points() if board is None else board

    def seen(X: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 2"]:
        square = ((X[:, :2] / X[:, 2:]) ** 2).sum(axis=1)
        k1 = float(rig.camera.lens.radial[0])  # type: ignore[attr-defined]
        further = 1 + k2 * square**2 / (1 + k1 * square)
        pixels = project_points(rig.camera, X).pixels
        centre = np.array([float(x) for x in rig.camera.principal])
        return centre + further[:, None] * (pixels - centre) + _CORNER_PX * random.normal(size=(len(X), 2))

    views = []
    poses = rig_2003.board_poses(rig_2003.simulated_rig(0), seed, _VIEWS)
    for i, (R, t) in enumerate(zip(poses.matrix(), poses.translation, strict=True)):
        stripe = StripePoints(_stripe(rig, R, t, random), half_width_px=1e-6)
        views.append(View(f"view-{i:02d}", seen(points @ R.T + t), stripes=(stripe,)))
    steps = steps_of(seed, even) if steps is None else steps
    run = runs(steps)
    run[0] *= first
    stood = stage.pose({"stage": steps, run_of("stage"): run}) @ rig_2003.stage_pose(rig_2003.simulated_rig(0), seed)
    aside = beside(steps, random) if beside else np.zeros((len(steps), 3))
    moved = [
        View(f"stage-{i:02d}", seen(points @ R.T + t))
        for i, (R, t) in enumerate(zip(stood.matrix(), stood.translation + aside, strict=True))
    ]
    sequence = BoardSequence({"stage": steps}, tuple(moved))
    return Observations(rig.camera.image_size, rig_2003.BOARD, tuple(views), (sequence,), ("",))


def _stripe(
    rig: Rig, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"], random: np.random.Generator
) -> Float[np.ndarray, "columns 2"]:
    """Where the sheet on a flat board is seen, column by column; NaN where it is not."""
    board, (width, height) = rig_2003.BOARD, rig.camera.image_size
    furthest = board.points().max(axis=0)[:2] + board.pitch_mm
    x, y = np.linspace(-board.pitch_mm, furthest[0], 2000), np.zeros(2000)
    for _ in range(20):
        X = x[:, None] * R[:, 0] + y[:, None] * R[:, 1] + t
        level = rig.lights[0].level(X)
        y = y - level / (rig.lights[0].gradient(X) @ R[:, 1])
    X = (x[:, None] * R[:, 0] + y[:, None] * R[:, 1] + t)[(y > -board.pitch_mm) & (y < furthest[1])]
    seen = project_points(rig.camera, X).pixels
    order, columns = np.argsort(seen[:, 0]), np.arange(float(width))
    rows = np.interp(columns, seen[order, 0], seen[order, 1], left=np.nan, right=np.nan)
    rows = np.where((rows < 0) | (rows > height - 1), np.nan, rows) + _STRIPE_PX * random.normal(size=width)
    return np.stack([columns, rows], axis=1)


def rms(found: Sequence[Calibration], stages: Sequence[DrawnStage]) -> float:
    """Errors of the points that rigs make of the sheet over the travel, in the object frame, mm.

    Half of them by rising steps, half by falling ones, as far as that matters.
    """
    true, random = rig_2003.simulated_rig(0), np.random.default_rng(83)
    omega = plane_of(true.lights[0])
    n = np.repeat(np.arange(0.0, TRAVEL + 1, 250.0), 20)
    aside, z = random.uniform(-_ASIDE, _ASIDE, len(n)), random.uniform(*_DEPTHS, len(n))
    X = np.stack([aside * z, (1 - omega[0] * aside * z - omega[2] * z) / omega[1], z], axis=1)
    pixels, squares = project_points(true.camera, X).pixels, []
    q = {"stage": n, run_of("stage"): np.where(np.arange(len(n)) % 2, FAR, -FAR)}
    for each, stage in zip(found, stages, strict=True):
        rays = pixel_rays(each.rig.camera, pixels)
        points = rays / np.asarray(each.rig.lights[0].inverse_depth(rays))[:, None]
        mine = _at_0(as_numpy(each.rig.pose(q)), points)
        squares.append(((mine - _at_0(stage.pose(q), X)) ** 2).sum(axis=1).mean())
    return float(np.sqrt(np.mean(squares)))


def _at_0(moved: Pose[np.ndarray], points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
    """Each point of the camera frame in the object frame."""
    return moved.inverse().apply(points[:, None])[:, 0]
