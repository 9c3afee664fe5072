"""The photographed part: its truth against its solids, and the peer that it is compared with."""

import numpy as np
import pytest

from benchmarks.parts import Compared, coverage, ratios
from benchmarks.peer_fits import peer_shapes
from benchmarks.photographed_part import part_of
from jaxscan.files.part_file import Dimension, Feature, Part
from jaxscan.files.region import Region
from jaxscan.measurement.measure import MeasuredDimension
from jaxscan.simulation import rig_2003
from jaxscan.simulation.profile import true_profile

RIG = rig_2003.simulated_rig(3)
TRUTH = {
    "step height": 6.0,
    "ball radius": 12.0,
    "small ball radius": 6.0,
    "cylinder radius": 9.0,
    "cylinder height": 5.0,
    "cone angle": 100.0,
    "circle radius": 15.0 - 4.0 * np.tan(np.radians(50.0)),
    "groove width": 10.0,
    "groove to ball": 66.0,
    "roof angle": 90.0,
    "ridge height": 2.0 + 9.0 * np.sqrt(2.0),
    "line height": 6.0,
}


def test_the_true_shapes_are_those_of_the_solids() -> None:
    """In some frames the true points lie on each of them to float32's digits."""
    part = part_of(RIG)
    scene = rig_2003.scan_scene(RIG, part.bodies)
    points = np.concatenate([true_profile(RIG, scene, {"stage": n}, laser=0).points for n in range(15000, 65000, 5000)])
    points = points[np.isfinite(points).all(axis=1)]
    regions = {feature.name: feature.region for feature in part.part.features}
    for name, shape in part.true.items():
        region = regions[name]
        if region is not None:
            inside = points[region.holds(points)]
            off = np.abs(shape.distances(inside))
            assert (off < 2e-3).mean() > 0.5, name


def test_truths_are_the_nominal_ones() -> None:
    part = part_of(RIG)
    for dimension in part.part.dimensions:
        if dimension.name in TRUTH:
            assert part.truth(dimension, part.true) == pytest.approx(TRUTH[dimension.name], abs=1e-9)
    dome = next(each for each in part.part.dimensions if each.kind == "volume")
    # A cap by slices of circles.
    heights = (np.arange(70000) + 0.5) * 1e-4
    assert part.truth(dome, {}) == pytest.approx(np.sum(np.pi * (16.0**2 - (9.0 + heights) ** 2)) * 1e-4, rel=1e-8)


def test_the_peer_finds_what_is_there() -> None:
    random = np.random.default_rng(1)
    x = random.normal(size=(600, 3))
    ball = (
        np.array([1.0, 2.0, 300.0]) + 7 * x / np.linalg.norm(x, axis=1)[:, None] + 0.02 * random.normal(size=(600, 3))
    )
    floor = np.column_stack([random.uniform(-9, 9, (400, 2)), 310 + 0.02 * random.normal(size=400)])
    features = (
        Feature("ball", "ball", Region((1.0, 2.0, 302.0), None, 12.0)),
        Feature("floor", "plane", Region((0.0, 0.0, 310.0), None, 12.0), grow=True),
    )
    part = Part(None, "two", features, ())  # type: ignore[arg-type]  # no file is read
    shapes = peer_shapes(np.concatenate([ball, floor]), part, 0.1, np.zeros(3))
    assert shapes.value(Dimension("r", "radius", ("ball",))) == pytest.approx(7.0, abs=0.01)
    assert shapes.value(Dimension("d", "distance", ("floor", "ball"))) == pytest.approx(10.0, abs=0.01)
    np.testing.assert_allclose(shapes.fitted["floor"].axis, [0, 0, -1], atol=1e-3)


def test_figures_of_known_errors() -> None:
    dimension = Dimension("ball radius", "radius", ("ball",))
    found = {
        "ball radius": [
            Compared(MeasuredDimension(dimension, 1.0, uncertainty=2.0, interval=(-1.0, 3.0), sigma=1.0), off, 2 * off)
            for off in (1.0, 3.0)
        ]
    }
    figures = {metric.name: metric.value for metric in (*coverage(found), *ratios("drawn", found))}
    assert figures["parts.coverage"] == 50.0
    assert figures["parts.ball_radius.mean_error"] == 2.0
    assert figures["parts.ball_radius.in_sigma"] == pytest.approx(np.sqrt(5.0))
    assert figures["parts.drawn.over_peer"] == 0.5
