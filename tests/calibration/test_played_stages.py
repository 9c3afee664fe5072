"""Play of a stage: sought from photographs there and back, named where it was not, refused where nothing tells it."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import BoardSequence, View, calibrate
from jaxscan.calibration.choose import calibrate_by_evidence
from jaxscan.calibration.model import Model
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.geometry import Pose
from jaxscan.rig import Linear, Rotary, run_of, runs
from jaxscan.rig.play import RotaryWithPlay
from jaxscan.rig.summary import axis_summary, format_path
from tests.calibration import stages, synthetic

KIND = "linear_with_play"
THERE = np.concatenate([stages.uneven(0, 16), stages.uneven(5, 16)[::-1][1:]])


def session(seed, steps=THERE, run=None, *, play_mm=0.05, aside=None, of=None, **how):
    """A board on a stage with play, approached as the order of its steps says, unless the run says otherwise."""
    stage = stages.stage(play_mm=play_mm, **(of or {}))
    run = runs(steps) if run is None else run

    class Approached:
        def pose(self, q):
            return stage.pose({**q, run_of("stage"): run} if np.ndim(q["stage"]) else q)

    return stages.session(seed, Approached(), steps, aside=aside, **how)


def z_of(found, play_mm):
    true = play_mm / float(np.linalg.norm(synthetic.PER_STEP))
    return (float(found.rig.axis("stage").play[0]) - true) / found.covariance.sigma("motion.stage.play.0")


@pytest.mark.parametrize("play_mm", [0.05, pytest.param(0.2, marks=pytest.mark.long)])
def test_it_is_found_within_its_sigma_and_named(play_mm):
    seen = session(0, play_mm=play_mm)
    line, found = calibrate(seen), calibrate(seen, motion={"stage": KIND})
    assert abs(z_of(found, play_mm)) < 4
    assert found.corner_sigma_px == pytest.approx(0.03, rel=0.05)
    assert not found.warnings
    assert not found.stage_shapes
    (shape,) = line.stage_shapes
    assert (shape.taken, shape.kind) == ("linear", KIND)
    assert abs(shape.play_mm - play_mm) < 4 * shape.play_sigma_mm < 0.03
    assert "has a play of 0." in line.warnings[0]
    assert line.change is None
    assert not line.sheet_curves


@pytest.mark.long
def test_it_is_found_beside_a_bow_and_a_screw():
    seen = session(1, play_mm=0.1, of={"sag_mm": 0.1, "wave_mm": 0.05, "phase": 1.0})
    (shape,) = calibrate(seen).stage_shapes
    assert shape.kind == "screw_on_guide_with_play"
    found = calibrate(seen, motion={"stage": shape.kind})
    assert abs(z_of(found, 0.1)) < 4.5
    assert not found.stage_shapes


@pytest.mark.parametrize("side", [pytest.param(1, marks=pytest.mark.long), -1])
def test_the_first_photograph_may_have_been_approached_from_either_side(side):
    run = runs(THERE)
    run[0] *= side
    found = calibrate(session(2, run=run, play_mm=0.1), motion={"stage": KIND})
    assert abs(z_of(found, 0.1)) < 4
    said = [note for note in found.notes if "first photograph" in note]
    assert len(said) == (side < 0)
    assert all("approached by falling steps" in note for note in said)


@pytest.mark.long
def test_three_passes_that_begin_by_falling_steps():
    pass_ = np.linspace(0, stages.TRAVEL, 8)
    steps = np.concatenate([pass_[::-1], pass_[1:] - 900.0, pass_[::-1][1:]])
    seen = session(3, steps)
    (shape,) = calibrate(seen).stage_shapes
    assert shape.kind == KIND
    assert abs(z_of(calibrate(seen, motion={"stage": KIND}), 0.05)) < 4


def _drift(mm):
    return mm * np.linspace(-1, 1, len(THERE))[:, None] * np.array(synthetic.PER_STEP) / 1e-3


# How the board is off its line, or how it was photographed; and whether a quick run tries it.
NO_PLAY = {
    "there and back": ({}, True),
    "wobble": ({"aside": 0.02 * np.random.default_rng(1).normal(size=(31, 3))}, False),
    "large wobble": ({"aside": 0.05 * np.random.default_rng(2).normal(size=(31, 3))}, False),
    "drift": ({"aside": _drift(0.1)}, False),
    "pushed": ({"aside": np.where(np.arange(31) > 7, 0.1, 0.0)[:, None] * np.array([0.0, 0.8, 0.6])}, False),
    "pushed across at the turn": (
        {"aside": np.where(np.arange(31) > 15, 0.1, 0.0)[:, None] * np.array([0.9, 0.3, 0.3])},
        True,
    ),
    "screw": ({"of": {"wave_mm": 0.05}}, False),
    "one pass": ({"play_mm": 0.2, "steps": np.sort(THERE)}, True),
    "one pass back": ({"play_mm": 0.2, "steps": np.sort(THERE)[::-1]}, False),
}


@pytest.mark.parametrize(
    "how",
    [pytest.param(how, id=name, marks=[] if quick else [pytest.mark.long]) for name, (how, quick) in NO_PLAY.items()],
)
def test_it_is_not_named_where_there_is_none_or_nothing_tells_it(how):
    assert not any(shape.play_mm for shape in calibrate(session(4, **{"play_mm": 0.0, **how})).stage_shapes)


@pytest.mark.parametrize("steps", [np.sort(THERE), np.sort(THERE)[::-1], np.array([0.0, 30000.0, 0.0])])
def test_photographs_of_one_pass_are_refused(steps):
    with pytest.raises(InputError, match=r"linear_with_play.*stage-00.*rising steps.*there and back.*in the order"):
        calibrate(session(5, steps), motion={"stage": KIND})


def test_it_is_written_and_read_and_said(tmp_path):
    found = calibrate(session(6), motion={"stage": KIND})
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert jax.tree.leaves(back.rig) == jax.tree.leaves(found.rig)
    assert back.rig.axis("stage").kind == KIND
    assert "motion.stage.play.0" in back.covariance.names
    (summary,) = axis_summary(back.rig, back.covariance)
    assert summary["play_mm"] == pytest.approx(0.05, abs=0.005)
    assert any(line.startswith("farther on by 0.0") for line in format_path(summary))


def test_the_model_that_is_chosen_has_it_where_there_is_some():
    for play_mm, kind in ((0.05, KIND), (0.0, "linear")):
        found = calibrate_by_evidence(session(7, play_mm=play_mm), Model())
        assert found.rig.axis("stage").kind == kind
        assert bool(found.choice.added) == (play_mm > 0)


def test_x64_on_or_off_is_the_same():
    seen, values = session(8), []
    for on in (True, False):
        with jax.enable_x64(on):
            values.append(float(calibrate(seen, motion={"stage": KIND}).rig.axis("stage").play[0]))
    assert values[0] == values[1]


def _seen(known, pose, random, name):
    points = synthetic.BOARD.points()
    views = []
    for i, (R, t) in enumerate(zip(pose.matrix(), pose.translation, strict=True)):
        pixels = synthetic.project(points @ R.T + t)
        views.append(View(f"{name}-{i:02d}", pixels + 0.03 * random.normal(size=pixels.shape)))
    return tuple(views)


def test_a_turntable_has_it_too():
    known = synthetic.observations(9, n_stage=0, noise=synthetic.Noise(0.03))
    random, steps = np.random.default_rng(9), np.r_[0:400:25, 390:0:-25].astype(float)
    true = RotaryWithPlay.from_plain(Rotary.create([0.0, 0.0015, 0.0004], [0.0, 5.0, 340.0]), 4.0)
    board = Pose(np.array([0.1, -0.3, 0.05]), np.array([-24.0, -18.0, 345.0]))
    pose = true.pose({"turntable": steps, run_of("turntable"): runs(steps)}) @ board
    pose = Pose(np.asarray(pose.rotation), np.asarray(pose.translation))
    sequence = BoardSequence({"turntable": steps}, _seen(known, pose, random, "turn"), "turntable", "rotary")
    seen = replace(known, sequences=(sequence,))
    found = calibrate(seen, motion={"turntable": "rotary_with_play"})
    sigma = found.covariance.sigma("motion.turntable.play.0")
    assert abs(float(found.rig.axis("turntable").play[0]) - 4.0) < 4 * sigma < 1.0
    (summary,) = axis_summary(found.rig, found.covariance)
    assert summary["play_deg"] == pytest.approx(4.0 * summary["degrees_per_step"], rel=0.2)


GANTRY = {"x": np.array([1.1e-3, 2e-5, 0.0]), "y": np.array([-1e-5, 0.9e-3, 1e-4])}


def gantry():
    """Two lines, of which the first has a play of 60 steps."""
    known = synthetic.observations(10, n_stage=0, noise=synthetic.Noise(0.03))
    random, steps = np.random.default_rng(10), np.r_[0:30000:3000, 29000:0:-3000].astype(float)
    plays = {"x": 60.0, "y": 0.0}
    board = Pose(np.array([0.1, -0.2, 0.05]), np.array([-36.0, -30.0, 345.0]))
    sequences = []
    for axis, way in GANTRY.items():
        lag = np.sign(runs(steps)) * plays[axis] / 2
        stood = Pose(np.zeros((len(steps), 3)), (steps - lag)[:, None] * way) @ board
        sequences.append(BoardSequence({axis: steps}, _seen(known, stood, random, axis), axis, Linear.kind))
    return replace(known, sequences=tuple(sequences))


@pytest.mark.long
def test_a_gantrys_line_with_play_is_named():
    assert [(shape.axis, shape.kind) for shape in calibrate(gantry()).stage_shapes] == [("x", KIND)]


def test_a_gantry_of_two_lines_has_the_scale_and_the_play_of_each():
    found = calibrate(gantry(), motion={"x": KIND})
    for axis, way in GANTRY.items():
        for i in range(3):
            sigma = found.covariance.sigma(f"motion.{axis}.per_step.{i}")
            assert abs(float(found.rig.axis(axis).per_step[i]) - way[i]) < 4.5 * sigma, (axis, i)
    assert abs(float(found.rig.axis("x").play[0]) - 60.0) < 4.5 * found.covariance.sigma("motion.x.play.0")
    # Where both have moved, the object has gone both ways, each by its own scale.
    at = found.rig.pose({"x": np.float64(20000), "y": np.float64(10000)}).translation
    np.testing.assert_allclose(at, 20000 * GANTRY["x"] + 10000 * GANTRY["y"], atol=0.02)
