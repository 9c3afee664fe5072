"""Dimensions of drawn parts: coverage of their 95 % intervals, bias, false accepts, exact fits, a million points.

Each drawing is a scan of its own by a rig of its own. The rig's error is drawn from the covariance of a calibration:
that is the linearised form of a session of its own, which would take a second each. That it is as good is measured:
`measure.solved` calibrates sessions of their own, and `measure.solved.chi2` is what their rigs are off by in units of
their covariances, 1 where these are right. The stripe has noise, half of it alike in neighbouring frames and columns.
In the second kind of drawing the noise is a hundredth, so that the rig's part alone is left.

JAXSCAN_DRAWINGS is how many drawings there are; 2000 without. Every coverage comes with the interval that this
number of drawings leaves open (C. J. Clopper and E. S. Pearson, 1934).
"""

import os
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from scipy.stats import beta

from benchmarks.measured_parts import (
    SCENES,
    Scene,
    blocks_and_balls,
    calibrated,
    drawn_rig,
    looked_at,
    scan,
    solved_rig,
)
from benchmarks.metric import Metric
from jaxscan.files.part_file import FITTED, Feature
from jaxscan.files.rig_file import RigFile
from jaxscan.measurement.fit import finish, settle
from jaxscan.measurement.form import scaled
from jaxscan.measurement.measure import MeasuredDimension
from jaxscan.measurement.measure import measure as measure_part
from jaxscan.measurement.scanned import scanned_image, scanned_points
from jaxscan.measurement.shapes import Ball, Cone, Cylinder, Plane, across
from jaxscan.measurement.verdict import verdict

_DRAWINGS, _FEW, _SOLVED = 2000, 12, 40
# Measured as often for its time, the first of which compiles.
_ROUNDS = 8
# Where noise is a hundredth only the rig is left.
_QUIET = 0.01
_OVER = 1.05
# Within which coverage is to lie, per cent.
_COVERAGE = 93.0, 97.0
_FORMS = ("flatness", "roundness", "straightness")
_LENGTHS = ("distance", "angle")
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
    count = _FEW if quick else int(os.environ.get("JAXSCAN_DRAWINGS", _DRAWINGS))
    metrics = [Metric("measure.drawings", count)]
    for name, share in (("noise", 1.0), ("rig", _QUIET)):
        drawn = drawings(count if share == 1.0 else max(count // 4, 1), drawn_rig, share)
        metrics += _coverage(name, drawn, quick)
        if share == 1.0:
            metrics += _bias(drawn)
            accepted, of = false_accepts(drawn)
            metrics.append(Metric("measure.false_accepts", 100 * accepted / of, "%", "lower", 2.5, floor=0.5))
            metrics.append(Metric("measure.false_accepts_most", 100 * binomial(accepted, of)[1], "%"))
    if not quick:
        metrics += _solved()
    metrics.append(Metric("measure.exact_digits", exact_digits(), "", "higher", 11.0, floor=1.0))
    return [*metrics, *_million()]


def _solved() -> list[Metric]:
    """Sessions of their own, calibrated: whether their rigs are off by what the covariance says, and coverage."""
    rigs = [solved_rig(seed) for seed in range(1, _SOLVED + 1)]
    true = calibrated()
    assert true.covariance is not None
    theta = np.array(jax.tree.leaves(true.rig))
    chi2 = [_off(np.array(jax.tree.leaves(each.rig)) - theta, each) for each in rigs]
    given = iter(rigs * len(SCENES))
    drawn = drawings(_SOLVED, lambda _: next(given), _QUIET)
    return [
        Metric("measure.solved.chi2", float(np.mean(chi2))),
        Metric("measure.solved.chi2_sigma", float(np.std(chi2) / np.sqrt(len(chi2)))),
        *_coverage("solved", drawn, True),
    ]


def _off(off: np.ndarray, rig: RigFile) -> float:
    """The square of an error in units of a rig's covariance, for each number."""
    assert rig.covariance is not None
    values, vectors = np.linalg.eigh(scaled(rig.covariance.of_leaves(rig.rig))[0])
    along = vectors.T @ (off / scaled(rig.covariance.of_leaves(rig.rig))[1])
    return float((along**2 / values).mean())


def binomial(hits: int, of: int) -> tuple[float, float]:
    """The least and the largest share that this number of hits leaves open with 95 %."""
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    return low, float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0


Drawn = dict[str, list[tuple[MeasuredDimension, float]]]


def drawings(count: int, rig: Callable[[np.random.Generator], RigFile], share: float) -> Drawn:
    """Each dimension as it was measured, with the truth, for `count` drawings of every scene."""
    found: Drawn = defaultdict(list)
    for which, make in enumerate(SCENES):
        scene = looked_at(make())
        for seed in range(count):
            random = np.random.default_rng([77, which, seed])
            own = rig(random)
            image = scan(scene, own, random, share)
            for each in measure_part(scanned_image(image, own, scene.part), scene.part).dimensions:
                found[each.dimension.name].append((each, scene.truth[each.dimension.name]))
    return found


def _coverage(name: str, drawn: Drawn, shown: bool) -> list[Metric]:
    metrics, of_all, near_0, outside = [], [], [], 0
    for dimension, each in drawn.items():
        assert all(one.interval is not None for one, _ in each), each[0][0].problem
        hits = sum(_holds(one, truth) for one, truth in each)
        low, high = (100 * share for share in binomial(hits, len(each)))
        key = f"measure.coverage.{name}.{dimension.replace(' ', '_')}"
        part = 100 * hits / len(each)
        metrics += [Metric(key, part, "%"), Metric(f"{key}_low", low, "%"), Metric(f"{key}_high", high, "%")]
        if each[0][1] == 0 and each[0][0].dimension.kind in _LENGTHS:
            # Of two things in one place: errors make it larger alone.
            near_0.append(part)
        elif each[0][0].dimension.kind not in _FORMS:
            of_all.append(part)
            outside += high < _COVERAGE[0] or low > _COVERAGE[1]
    if shown:
        return [Metric(f"measure.coverage.{name}.mean", float(np.mean(of_all)), "%"), *metrics]
    least = Metric(f"measure.coverage.{name}.least", min(of_all), "%", "higher", _COVERAGE[0], floor=1.5)
    metrics.append(Metric(f"measure.coverage.{name}.near_0_least", min(near_0), "%", "higher", _COVERAGE[0], floor=1.5))
    if name == "rig":
        # With so little noise what is alike is found from what the rig leaves, and intervals are wide.
        return [least, Metric(f"measure.coverage.{name}.most", max(of_all), "%"), *metrics]
    return [
        least,
        Metric(f"measure.coverage.{name}.most", max(of_all), "%", "lower", _COVERAGE[1], floor=1.5),
        Metric(f"measure.coverage.{name}.surely_outside", outside, "", "lower", 0),
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


def false_accepts(drawn: Drawn) -> tuple[int, int]:
    """How many parts off by 1.05 tolerances pass, of how many: of the dimension where most do.

    The tolerance is twice the dimension's usual uncertainty on either side, and parts are off to either side.
    """
    worst = 0, 1
    for each in drawn.values():
        one, truth = each[0]
        if one.dimension.kind in _FORMS:
            continue
        tolerance = 2 * float(np.median([m.uncertainty for m, _ in each if m.uncertainty is not None]))
        accepted = 0
        for way in (1.0, -1.0):
            limits = truth - way * _OVER * tolerance - tolerance, truth - way * _OVER * tolerance + tolerance
            accepted += sum(verdict(m.interval, limits) == "conforming" for m, _ in each)
        worst = max(worst, (accepted, 2 * len(each)), key=lambda pair: pair[0] / pair[1])
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
        scanned = scanned_points(points)
        shape = finish(scanned, settle(scanned, kind, np.arange(len(points)))).shape
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
    times, processor = [], []
    image = scan(_finer(scene), own, random)
    part = replace(scene.part, features=_ten(scene))
    names = {feature.name for feature in part.features}
    part = replace(part, dimensions=tuple(one for one in part.dimensions if names.issuperset(one.of)))
    for _ in range(_ROUNDS):
        begin = time.perf_counter(), time.process_time()
        found = measure_part(scanned_image(image, own, part), part)
        times.append(time.perf_counter() - begin[0])
        processor.append(time.process_time() - begin[1])
        assert not found.problems
    return [
        Metric("measure.million.points", float(image.valid.sum())),
        # The least, which other programs hold up least (Python's `timeit`); and what it takes of a processor.
        Metric("measure.million.time", min(times[1:]), "s", "lower", 2.0, slack=1.0, target_suffices=True),
        Metric("measure.million.processor", float(np.median(processor[1:])), "s"),
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
