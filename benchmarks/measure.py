"""Dimensions of drawn parts: coverage of their 95 % intervals, bias, false accepts, exact fits, a million points.

Each drawing is a scan of its own by a rig of its own: the rig is drawn from the covariance of a calibration (or, in
`measure.solved`, found anew from a session of its own), and the stripe has noise, half of it alike in neighbouring
frames and columns. In the second kind of drawing the noise is a hundredth, so that the rig's part alone is left.
"""

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.measured_parts import SCENES, Scene, blocks_and_balls, drawn_rig, scan, solved_rig
from benchmarks.metric import Metric
from jaxscan.files.part_file import FITTED, Feature
from jaxscan.files.rig_file import RigFile
from jaxscan.measurement.fit import fit_shape
from jaxscan.measurement.measure import MeasuredDimension
from jaxscan.measurement.measure import measure as measure_part
from jaxscan.measurement.scanned import scanned_image, scanned_points
from jaxscan.measurement.shapes import Ball, Cone, Cylinder, Plane, across
from jaxscan.measurement.verdict import verdict

_DRAWINGS, _FEW, _SOLVED = 2000, 12, 40
# Where noise is a hundredth only the rig is left.
_QUIET = 0.01
_OVER = 1.05
_FORMS = ("flatness", "roundness", "straightness")
_BIAS = {
    "ball radius 5": 0.01,
    "ball radius 12": 0.01,
    "ball radius 25": 0.01,
    "cylinder radius": 0.01,
    "step": 0.005,
    "plane distance": 0.005,
}


def measure(quick: bool) -> list[Metric]:
    """All features, two thousand drawings of each scene; or twelve."""
    count = _FEW if quick else _DRAWINGS
    metrics = []
    for name, share in (("noise", 1.0), ("rig", _QUIET)):
        drawn = drawings(count if share == 1.0 else count // 4, drawn_rig, share)
        metrics += _coverage(name, drawn, quick)
        if share == 1.0:
            metrics += _bias(drawn)
            metrics.append(Metric("measure.false_accepts", 100 * false_accepts(drawn), "%", "lower", 2.5, floor=0.5))
    if not quick:
        solved = drawings(_SOLVED, lambda random: solved_rig(int(random.integers(1 << 30))), _QUIET)
        metrics += _coverage("solved", solved, True)
    metrics.append(Metric("measure.exact_digits", exact_digits(), "", "higher", 11.0, floor=1.0))
    return [*metrics, *_million()]


Drawn = dict[str, list[tuple[MeasuredDimension, float]]]


def drawings(count: int, rig: Callable[[np.random.Generator], RigFile], share: float) -> Drawn:
    """Each dimension as it was measured, with the truth, for `count` drawings of every scene."""
    found: Drawn = defaultdict(list)
    for which, make in enumerate(SCENES):
        scene = make()
        for seed in range(count):
            random = np.random.default_rng([77, which, seed])
            own = rig(random)
            image = scan(scene, own, random, share)
            for each in measure_part(scanned_image(image, own, scene.part), scene.part).dimensions:
                found[each.dimension.name].append((each, scene.truth[each.dimension.name]))
    return found


def _coverage(name: str, drawn: Drawn, shown: bool) -> list[Metric]:
    metrics, of_all = [], []
    for dimension, each in drawn.items():
        assert all(one.interval is not None for one, _ in each), each[0][0].problem
        inside = [_holds(one, truth) for one, truth in each]
        part = 100 * float(np.mean(inside))
        key = f"measure.coverage.{name}.{dimension.replace(' ', '_')}"
        metrics.append(Metric(key, part, "%"))
        if each[0][0].dimension.kind not in _FORMS:
            of_all.append(part)
    low, high = min(of_all), max(of_all)
    if shown:
        return [Metric(f"measure.coverage.{name}.mean", float(np.mean(of_all)), "%"), *metrics]
    return [
        Metric(f"measure.coverage.{name}.least", low, "%", "higher", 93.0, floor=1.5),
        Metric(f"measure.coverage.{name}.most", high, "%", "lower", 97.0, floor=1.5),
        *metrics,
    ]


def _holds(one: MeasuredDimension, truth: float) -> bool:
    assert one.interval is not None
    return one.interval[0] <= truth <= one.interval[1]


def _bias(drawn: Drawn) -> list[Metric]:
    """The mean error, whatever its sign, in mm."""
    metrics = []
    for name, goal in _BIAS.items():
        off = [one.value - truth for one, truth in drawn[name] if one.value is not None]
        key = f"measure.bias.{name.replace(' ', '_')}"
        metrics.append(Metric(key, abs(float(np.mean(off))), "mm", "lower", goal, target_suffices=True))
        metrics.append(Metric(f"{key}_sigma", float(np.std(off) / np.sqrt(len(off))), "mm"))
    return metrics


def false_accepts(drawn: Drawn) -> float:
    """The largest share, over the dimensions, of parts off by 1.05 tolerances that pass.

    The tolerance is twice the dimension's usual uncertainty on either side, and parts are off to either side.
    """
    worst = 0.0
    for each in drawn.values():
        one, truth = each[0]
        if one.dimension.kind in _FORMS:
            continue
        tolerance = 2 * float(np.median([m.uncertainty for m, _ in each if m.uncertainty is not None]))
        accepted = []
        for way in (1.0, -1.0):
            limits = truth - way * _OVER * tolerance - tolerance, truth - way * _OVER * tolerance + tolerance
            accepted += [verdict(m.interval, limits) == "conforming" for m, _ in each]
        worst = max(worst, float(np.mean(accepted)))
    return worst


def exact_digits() -> float:
    """Digits of fits to data whose least-squares answers are known without rounding: the worst number.

    Points lie in pairs off the shape, as far outside as inside along one normal, in rings, so that the shape itself is
    the solution of least squares by symmetry. What is left is the rounding of the coordinates in float64.
    """
    random = np.random.default_rng(5)
    axis = random.normal(size=3)
    axis /= np.linalg.norm(axis)
    u, v = across(axis)
    centre = np.array([12.0, -7.0, 333.0])
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(-10.0, 10.0, 21))
    turn, height = turn.ravel(), height.ravel()
    out = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v
    ball = np.sin(height / 7)[:, None] * axis + np.cos(height / 7)[:, None] * out
    half = np.radians(20.0)
    surfaces = {
        "plane": (turn[:, None] * u + height[:, None] * v, np.broadcast_to(axis, out.shape)),
        "ball": (9.0 * ball, ball),
        "cylinder": (9.0 * out + height[:, None] * axis, out),
        "cone": (
            (9.0 + height * np.tan(half))[:, None] * out + height[:, None] * axis,
            np.cos(half) * out - np.sin(half) * axis,
        ),
    }
    digits = []
    for kind, (x, n) in surfaces.items():
        points = centre + np.concatenate([x + 0.05 * n, x - 0.05 * n])
        shape = fit_shape(scanned_points(points), kind, np.arange(len(points))).shape
        if isinstance(shape, Plane):
            off = [np.linalg.norm(np.cross(shape.axis, axis)), abs(np.mean(x, axis=0) @ axis) / 333]
        elif isinstance(shape, Ball):
            off = [abs(shape.radius / 9 - 1), *abs(shape.point - centre) / 333]
        elif isinstance(shape, Cylinder):
            off = [abs(shape.radius / 9 - 1), np.linalg.norm(np.cross(shape.axis, axis))]
        else:
            assert isinstance(shape, Cone)
            off = [abs(shape.half_angle / half - 1), np.linalg.norm(np.cross(shape.axis, axis))]
        digits.append(-np.log10(max(*map(float, off), 1e-16)))
    return min(digits)


def _million() -> list[Metric]:
    """A million points and ten features, from the range image in memory to dimensions with intervals; warm."""
    scene = blocks_and_balls()
    random = np.random.default_rng(3)
    own = drawn_rig(random)
    times = []
    image = scan(_finer(scene), own, random)
    part = replace(scene.part, features=_ten(scene))
    names = {feature.name for feature in part.features}
    part = replace(part, dimensions=tuple(one for one in part.dimensions if names.issuperset(one.of)))
    for _ in range(4):
        begin = time.perf_counter()
        found = measure_part(scanned_image(image, own, part), part)
        times.append(time.perf_counter() - begin)
        assert not found.problems
    return [
        Metric("measure.million.points", float(image.valid.sum())),
        Metric("measure.million.time", float(np.median(times[1:])), "s", "lower", 2.0, slack=1.0, target_suffices=True),
    ]


def _ten(scene: Scene) -> tuple[Feature, ...]:
    """Its five surfaces, each twice."""
    surfaces = [feature for feature in scene.part.features if feature.kind in FITTED]
    return (*surfaces, *(replace(feature, name=f"{feature.name} again") for feature in surfaces))


def _finer(scene: Scene) -> Scene:
    """With as many frames as it takes for a million points."""
    times = -(-1_000_000 // int(np.isfinite(scene.position).sum()))
    whole = np.arange(len(scene.steps), dtype=float)
    at = np.linspace(0, len(whole) - 1, times * len(whole) + times)
    low = np.minimum(at.astype(int), len(whole) - 2)
    t = (at - low)[:, None]
    position = (1 - t) * scene.position[low] + t * scene.position[low + 1]
    return replace(scene, position=position, steps=np.interp(at, whole, scene.steps))
